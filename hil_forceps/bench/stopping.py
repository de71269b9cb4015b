"""Clean stop on a signal: the loop checks a flag once a tick."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopFlag:
    """A flag that a signal handler sets; never cleared."""

    def __init__(self) -> None:
        self._set = False

    def set(self) -> None:
        """Ask for a clean stop."""
        self._set = True

    def is_set(self) -> bool:
        """Return whether a stop was requested."""
        return self._set


@contextmanager
def stopped_by_signals(flag: StopFlag) -> Iterator[None]:
    """Turn SIGINT, SIGTERM and SIGHUP into a clean stop while the block runs; ignored signals (nohup) stay ignored."""

    def handle(_number: int, _frame: FrameType | None) -> None:
        flag.set()

    before = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    taken = [number for number, handler in before.items() if handler is not signal.SIG_IGN]
    for number in taken:
        signal.signal(number, handle)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, before[number])
