"""What the user did wrong, in words meant for the user."""

from collections.abc import Sequence


class UserError(Exception):
    """Input that can't be used: one line per problem, each saying where, what and what to do about it."""

    problems: tuple[str, ...]

    def __init__(self, problems: str | Sequence[str]) -> None:
        each = (problems,) if isinstance(problems, str) else tuple(problems)
        self.problems = tuple(map(one_line, each))
        super().__init__(self.problems)

    def __str__(self) -> str:
        return "\n".join(self.problems)


def one_line(problem: str) -> str:
    """Escape what would break the line, or steer a terminal: problems quote files and libraries."""
    if problem.isprintable():
        return problem
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in problem)
