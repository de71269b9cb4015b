"""How frames become the bytes of a serial line, and bytes frames: what a serial link is told of a protocol."""

from collections.abc import Callable
from typing import Final, NamedTuple, Protocol

from firmware_protocol.frames import Frame
from firmware_protocol.serial_framing import SerialReader, encode_serial


class PacketReader(Protocol):
    """Bytes to frames; how they are cut into chunks doesn't show, memory is bounded, nothing raises."""

    counters: dict[str, int]

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that these bytes complete, in order."""


class Framing(NamedTuple):
    """One way of packing. `resume` goes ahead of the packet behind a torn one."""

    encode: Callable[[Frame], bytes]
    reader: Callable[[], PacketReader]
    resume: bytes = b""


NATIVE: Final = Framing(encode_serial, SerialReader, b"\x00")
