"""What the user did wrong, in words meant for the user."""

from collections.abc import Sequence


class UserError(Exception):
    """Input that can't be used: one line per problem, each saying where, what and what to do about it."""

    problems: tuple[str, ...]

    def __init__(self, problems: str | Sequence[str]) -> None:
        self.problems = (problems,) if isinstance(problems, str) else tuple(problems)
        super().__init__(self.problems)

    def __str__(self) -> str:
        return "\n".join(self.problems)
