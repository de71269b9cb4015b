"""An open link as the conformance suite wants it."""

from collections.abc import Sequence

from firmware_protocol.conformance.port import Capability
from firmware_protocol.frames import Frame
from hil_forceps.bridge.links.adapters import Connection
from hil_forceps.bridge.links.can_link import PythonCanLink
from hil_forceps.bridge.links.serial_link import SerialLink
from hil_forceps.bridge.ports import SendResult


class LinkPort:
    """A `firmware_protocol.conformance.port.Port` over a connection; `fd` says that its bus carries CAN FD frames."""

    def __init__(self, connection: Connection, fd: bool) -> None:
        self._link = connection.link
        self.virtual_time = connection.virtual_time
        self.now_ns = connection.clock.now_ns
        self.wait_until = connection.clock.sleep_until_ns
        self.capabilities = Capability.FD if fd else Capability.NONE
        if isinstance(self._link, SerialLink):
            self.capabilities = Capability.SERIAL | Capability.FD  # framing carries both formats on any line
            if self._link.is_stream:
                self.capabilities |= Capability.STREAM
        elif isinstance(self._link, PythonCanLink):
            self.capabilities |= Capability.FOREIGN

    def send(self, frame: Frame) -> bool:
        """See `Port`."""
        return self._link.send(frame) is SendResult.SENT

    def send_foreign(self, frame: Frame, remote: bool) -> bool:
        """See `Port`; ValueError where the line can't."""
        if not isinstance(self._link, PythonCanLink):
            raise ValueError("this line carries data frames with 11-bit ids only")
        return self._link.send_foreign(frame, remote) is SendResult.SENT

    def send_bytes(self, data: bytes) -> bool:
        """See `Port`; ValueError where the line can't."""
        if not isinstance(self._link, SerialLink):
            raise ValueError("this line carries frames only")
        return self._link.send_bytes(data) is SendResult.SENT

    def receive(self) -> Sequence[tuple[int, Frame]]:
        """See `Port`."""
        return self._link.receive()

    def line_errors(self) -> int:
        """See `Port`."""
        counters = self._link.counters
        names = ("bad_cobs", "too_short", "too_long", "bad_crc", "bad_id", "bad_length")
        return sum(counters.get(name, 0) for name in names)

    def close(self) -> None:
        """Release the line."""
        self._link.close()
