"""What a drive says of itself before it has torque: listened to, or asked by what moves, enables and changes nothing.

Pure. An inquiry sends nothing that feeds a watchdog but where its profile says so. Values are as the drive says them,
beside the rig's own; None: it wasn't said.
"""

from dataclasses import dataclass
from typing import Final, Protocol

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState

ASK_AGAIN_NS: Final = 100_000_000  # a question that nobody has answered
MAX_TRIES: Final = 3


@dataclass(slots=True)
class Said:
    """What one drive has said of itself. Angles, currents and torques are those of the motor pulley."""

    firmware: str | None = None  # version of firmware or protocol, in words
    misfit: str = ""  # why this version can't be driven from here, with the remedy; empty: nothing known against it
    state: DriveState | None = None
    fault: str | None = None  # in words; empty: none
    counts_per_rev: int | None = None  # of its encoder
    sample_period_s: float | None = None
    watchdog_s: float | None = None
    current_limit_A: float | None = None
    torque_constant_N_m_per_A: float | None = None
    position_range_rad: tuple[float, float] | None = None  # beyond which it takes no reference
    is_fd: bool | None = None


class Inquiry(Protocol):
    """One drive that is asked."""

    def poll(self, now_ns: int) -> list[Frame]:
        """Return the questions that are due; none of them moves, enables or changes anything."""

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take one frame from the line, whoever sent it; what isn't the drive's is dropped."""

    def said(self) -> Said | None:
        """Return what the drive has said; None as long as it wasn't heard."""

    def is_complete(self) -> bool:
        """Tell whether nothing more is to be expected."""


class Questions:
    """Questions with a name each, one at a time, again where no answer comes, and given up in the end."""

    def __init__(self, frames: dict[int, Frame]) -> None:
        self._left = dict(frames)
        self._asked_ns: int | None = None
        self._tries = 0

    @property
    def is_over(self) -> bool:
        """Whether all are answered or given up."""
        return not self._left

    def poll(self, now_ns: int) -> list[Frame]:
        """Return the question that is due, or due again."""
        if not self._left or (self._asked_ns is not None and now_ns - self._asked_ns < ASK_AGAIN_NS):
            return []
        if self._tries >= MAX_TRIES:
            self.answered(next(iter(self._left)))
            return self.poll(now_ns)
        self._asked_ns = now_ns
        self._tries += 1
        return [next(iter(self._left.values()))]

    def answered(self, name: int) -> None:
        """Go on behind the question of that name; nothing where it isn't the one that was asked."""
        if next(iter(self._left), None) == name:
            del self._left[name]
            self._asked_ns, self._tries = None, 0
