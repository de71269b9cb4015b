"""Whether a drive that answers once to each question answers more often: then two drives have its id. Pure."""

from typing import Final

MAX_EXCESS_ANSWERS: Final = 10  # over the questions; of two drives with one id each answers
MAX_EXCUSED_LOST_ANSWERS: Final = 64  # that are made up for: more, and lost answers would hide those that are too many


class AnswerCount:
    """Counts questions against answers."""

    def __init__(self) -> None:
        self._more = 0

    def ask(self) -> None:
        """Note a question."""
        self._more = max(self._more - 1, -MAX_EXCUSED_LOST_ANSWERS)

    def answer(self) -> None:
        """Note an answer, whole or not."""
        self._more += 1

    @property
    def is_too_high(self) -> bool:
        """Whether more was answered than one drive does."""
        return self._more >= MAX_EXCESS_ANSWERS
