"""Whether cyclic messages come more often than a drive was told to send them: then two drives have its id. Pure."""

from typing import Final

WINDOW_NS: Final = 50_000_000  # over which messages are counted, at least: a host that is late delays them by less
MIN_INTERVALS: Final = 4  # of one drive in a window, at least: two drives make twice as many
MAX_RATE_RATIO: Final = 1.5  # of what one drive sends: half way to two drives


class MessageRate:
    """Counts messages of one kind, window by window."""

    def __init__(self, period_ns: int) -> None:
        """`period_ns`: with which one drive sends them."""
        self._period_ns = period_ns
        self._window_ns = max(WINDOW_NS, MIN_INTERVALS * period_ns)
        self._begin_ns: int | None = None
        self._count = 0
        self.interval_ns: float | None = None  # mean of the last whole window; None before the first

    def receive(self, now_ns: int) -> None:
        """Note a message."""
        if self._begin_ns is None:
            self._begin_ns = now_ns
            return
        self._count += 1
        elapsed_ns = now_ns - self._begin_ns
        if elapsed_ns >= self._window_ns:
            self.interval_ns = elapsed_ns / self._count
            self._begin_ns, self._count = now_ns, 0

    @property
    def is_one_drive(self) -> bool | None:
        """Whether no more came than one drive sends; None before anything is known."""
        return None if self.interval_ns is None else self.interval_ns * MAX_RATE_RATIO > self._period_ns
