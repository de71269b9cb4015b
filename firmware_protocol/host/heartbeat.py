"""HOST_HEARTBEAT: the levels it carries, and edges that the drive can't miss."""

from typing import Final

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.messages import PROTOCOL_MAJOR, PROTOCOL_MINOR, Control, HostHeartbeat

LOW_HEARTBEATS: Final = 2  # with all controls low before one may rise: an edge must be seen from low, one may be lost
RESET_HEARTBEATS: Final = 3  # that carry FAULT_RESET, so that two may be lost

# Asked for at each poll.
_NONE: Final = int(Control.NONE)
_ENABLE: Final = int(Control.ENABLE)
_RESET: Final = int(Control.FAULT_RESET)


class HostHeartbeatSource:
    """Sends each period, and at once when a level changes. The sequence goes on across sessions."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._sequence = 0
        self.begin_session()

    def begin_session(self) -> None:
        """Start over with a drive that has seen nothing yet."""
        self.release()
        self._due_ns: int | None = None
        self._sent = _NONE
        self._low_heartbeats = 0

    def release(self) -> None:
        """Let every control fall, and forget a reset that was asked for."""
        self.enabling = False  # ENABLE is up
        self._reset_wanted = False
        self._reset_left = 0

    def raise_enable(self) -> None:
        """Lift ENABLE as soon as the drive has had time to see it low."""
        self.enabling = self.enabling or self._low_heartbeats >= LOW_HEARTBEATS

    def request_reset(self) -> None:
        """Pulse FAULT_RESET as soon as the drive has had time to see it low."""
        self._reset_wanted = True

    def poll(self, node: int, now_ns: int) -> Frame | None:
        """Return the heartbeat when it is due."""
        control = self._wanted()
        if self._due_ns is not None and control == self._sent and now_ns < self._due_ns:
            return None
        self._due_ns = now_ns + self._period_ns
        self._sent = control
        self._low_heartbeats = 0 if control else self._low_heartbeats + 1
        if control == _RESET:
            if self._reset_left == 0:
                self._reset_wanted = False
                self._reset_left = RESET_HEARTBEATS
            self._reset_left -= 1
        self._sequence = (self._sequence + 1) & 0xFF
        return codec.encode(HostHeartbeat(node, control, PROTOCOL_MAJOR, PROTOCOL_MINOR, self._sequence))

    def _wanted(self) -> int:
        if self.enabling:
            return _ENABLE
        if self._reset_left or (self._reset_wanted and self._low_heartbeats >= LOW_HEARTBEATS):
            return _RESET
        return _NONE
