"""What the suite needs from outside: frames out, frames with times in, and a clock that can be waited for."""

from collections.abc import Sequence
from typing import Protocol

from firmware_protocol.frames import Frame


class Line(Protocol):
    """A part of `firmware_protocol.conformance.port.Port`: nothing raises for what the outside did."""

    @property
    def virtual_time(self) -> bool:
        """Tell whether time passes in `wait_until` only, and nothing is ever late."""

    def send(self, frame: Frame) -> bool:
        """Hand over one frame now; False when the line has no room for it."""

    def receive(self) -> Sequence[tuple[int, Frame]]:
        """Return what has arrived since the last call, each with its time in ns, oldest first."""

    def now_ns(self) -> int:
        """Return the time now."""

    def wait_until(self, time_ns: int) -> None:
        """Wait until then."""
