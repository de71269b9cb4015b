"""Which answer belongs to which request: a VESC sends the request's mask back, and knows none of its upper bits."""

from collections import deque
from typing import Final

from hil_forceps.drives.supervision.answer_count import AnswerCount

TAGS: Final = 256
MAX_PENDING_REQUESTS: Final = 64


class Requests:
    """Requests that wait for their answers; a path keeps their order, so what an answer overtakes is lost."""

    def __init__(self, counters: dict[str, int]) -> None:
        """`counters`: those of the profile, with `requests_sent`, `unanswered` and `unasked` among them."""
        self._counters = counters
        self._pending: deque[tuple[int, int]] = deque()
        self._tag = 0
        self._count = AnswerCount()

    @property
    def are_answered_too_often(self) -> bool:
        """Tell whether more answers end than one VESC gives."""
        return self._count.is_too_high

    def end(self) -> None:
        """Take note that an answer ended, whole or not."""
        self._count.answer()

    def ask(self, now_ns: int) -> int:
        """Return the tag of a request that goes out now."""
        self._tag = (self._tag + 1) % TAGS
        if len(self._pending) == MAX_PENDING_REQUESTS:
            self._pending.popleft()
            self._counters["unanswered"] += 1
        self._pending.append((self._tag, now_ns))
        self._counters["requests_sent"] += 1
        self._count.ask()
        return self._tag

    def answer(self, tag: int) -> int | None:
        """Return when the request of an answer went out; None, and counted, where none waits for it."""
        if all(pending != tag for pending, _ in self._pending):
            self._counters["unasked"] += 1
            return None
        while True:
            pending, asked_ns = self._pending.popleft()
            if pending == tag:
                return asked_ns
            self._counters["unanswered"] += 1
