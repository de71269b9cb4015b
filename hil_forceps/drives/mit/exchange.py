"""What was asked of a drive that only answers: one answer to a frame, and no name on it."""

from typing import Final

FLIGHT_NS: Final = 10_000_000  # for a frame to arrive and for what was on its way before to have come
MAX_FRAMES_IN_FLIGHT: Final = 4  # frames that may still be answered
# All that go out until silence ends a run, in an enabling too.
MAX_UNANSWERED_FRAMES: Final = 64


class Exchange:
    """Frames asked and answered, by the ticks in which they were sent."""

    def __init__(self) -> None:
        self.unasked = 0  # answers beyond the number of frames
        self._in_flight = 0
        self._asked_ns = 0  # the newest frame's tick
        self._unanswered_ns: int | None = None  # the first tick since the last answer
        self._exit_ns: int | None = None  # since when nothing but "exit" was sent
        self._unanswered = 0  # frames; those that were lost stay among them
        self._before_exit = 0  # answers that may be to what was sent before; below 0 none is any more

    def ask(self, frames: int, only_exit: bool, now_ns: int) -> None:
        """Note the frames of a tick."""
        if not frames:
            return
        self._in_flight = min(self._in_flight + frames, MAX_FRAMES_IN_FLIGHT)
        self._asked_ns = now_ns
        if self._unanswered_ns is None:
            self._unanswered_ns = now_ns
        if not only_exit:
            self._exit_ns = None
        elif self._exit_ns is None:
            self._exit_ns, self._before_exit = now_ns, self._unanswered
        self._unanswered = min(self._unanswered + frames, MAX_UNANSWERED_FRAMES)

    def take_answer(self) -> bool:
        """Note an answer; False, and counted, where no frame is left that it could be to."""
        if not self._in_flight:
            self.unasked += 1
            return False
        self._in_flight -= 1
        self._unanswered = max(self._unanswered - 1, 0)
        self._before_exit -= 1
        self._unanswered_ns = None
        return True

    def silent_ns(self, now_ns: int) -> int:
        """Return for how long frames have stayed without an answer."""
        return 0 if self._unanswered_ns is None else now_ns - self._unanswered_ns

    def is_to_exit(self, now_ns: int) -> bool:
        """Return whether the answer just taken can be to nothing but "exit", however long frames were held up."""
        return self._exit_ns is not None and now_ns - self._exit_ns >= FLIGHT_NS and self._before_exit < 0

    def stamp_ns(self, now_ns: int) -> int:
        """Return when the drive has measured what comes now: half way back to the tick that asked."""
        return (self._asked_ns + now_ns) // 2 if self._asked_ns < now_ns else now_ns
