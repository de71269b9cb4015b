"""Packets of Dynamixel's protocol 2.0 as a servo makes and reads them (ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0").

A frame is a packet's id with instruction and parameters; one of more than eight bytes is marked FD.
"""

from typing import Final

from firmware_protocol.frames import Frame
from virtual_bus.bus.wire import LineCodec

HEADER: Final = bytes((0xFF, 0xFF, 0xFD, 0x00))
_HEAD_BYTES: Final = 7
_MAX_LENGTH_BYTES: Final = 1024


def _table() -> tuple[int, ...]:
    """Return the CRC of each byte: x¹⁶ + x¹⁵ + x² + 1, highest bit first."""
    values = []
    for byte in range(256):
        value = byte << 8
        for _ in range(8):
            value = (value << 1) ^ (0x8005 if value & 0x8000 else 0)
        values.append(value & 0xFFFF)
    return tuple(values)


_CRC: Final = _table()


def crc(data: bytes) -> int:
    """Return the CRC-16 of a packet up to its own."""
    value = 0
    for byte in data:
        value = (value << 8 & 0xFF00) ^ _CRC[value >> 8 ^ byte]
    return value


def stuffed(data: bytes) -> bytes:
    """Return instruction and parameters as they go over the line."""
    out = bytearray()
    for byte in data:
        out.append(byte)
        if out[-3:] == b"\xff\xff\xfd":
            out.append(0xFD)
    return bytes(out)


def unstuffed(data: bytes) -> bytes:
    """Return instruction and parameters without what was put in."""
    out = bytearray()
    skip = False
    for byte in data:
        if skip:
            skip = False
            continue
        out.append(byte)
        skip = out[-3:] == b"\xff\xff\xfd"
    return bytes(out)


def encode(frame: Frame) -> bytes:
    """Return a packet's bytes; ValueError for an id that is none."""
    identifier, data = frame[0], frame[1]
    if not 0 <= identifier <= 254 or not data:
        raise ValueError(f"no packet of this line: {frame}")
    body = stuffed(data)
    head = HEADER + bytes((identifier,)) + (len(body) + 2).to_bytes(2, "little") + body
    return head + crc(head).to_bytes(2, "little")


class ServoReader:
    """Bytes to packets. One with a wrong CRC comes as a frame without data: a servo answers that, too."""

    def __init__(self) -> None:
        self.counters = {"bad_crc": 0, "bad_length": 0}
        self._data = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Return the packets that these bytes complete."""
        self._data += data
        frames: list[Frame] = []
        while True:
            begin = self._data.find(HEADER)
            if begin < 0:
                self._data = self._data[-3:]
                return frames
            self._data = self._data[begin:]
            if len(self._data) < _HEAD_BYTES:
                return frames
            length = int.from_bytes(self._data[5:7], "little")
            if not 3 <= length <= _MAX_LENGTH_BYTES:
                self.counters["bad_length"] += 1
                self._data = self._data[1:]
            elif len(self._data) < _HEAD_BYTES + length:
                return frames
            else:
                frames.append(self._take(self._data[: _HEAD_BYTES + length]))

    def _take(self, packet: bytes) -> Frame:
        if crc(packet[:-2]) != int.from_bytes(packet[-2:], "little"):
            self.counters["bad_crc"] += 1
            self._data = self._data[1:]
            return Frame(packet[4], b"")
        self._data = self._data[len(packet) :]
        data = unstuffed(packet[_HEAD_BYTES:-2])
        return Frame(packet[4], data, len(data) > 8)


CODEC: Final = LineCodec(encode, ServoReader)
