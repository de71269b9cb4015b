"""Packets of Dynamixel's protocol 2.0: framing, byte stuffing, CRC, instructions and status; pure.

On the line: FF FF FD 00, id, length (2 bytes, little-endian: what follows it), instruction, parameters, CRC-16
(polynomial 8005h, initial value 0, over all before it). Where instruction and parameters hold FF FF FD, another FD
follows. ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0", chapters Instruction Packet, Status Packet and Packet Process.

Inside, a packet is a `Frame`: the servo's id, and instruction and parameters without stuffing. One of more than eight
bytes is marked FD, so that every bus log can hold it; lengths that CAN FD doesn't have are kept all the same.
"""

from enum import IntEnum
from typing import Final, NamedTuple

from fastcrc import crc16

from firmware_protocol.frames import Frame
from hil_forceps.drives.framing import Framing

MAX_ID: Final = 252
BROADCAST_ID: Final = 254
MAX_DATA_BYTES: Final = 64  # of instruction and parameters: a frame's
BITS_PER_BYTE: Final = 10  # 8N1
OVERHEAD_BYTES: Final = 9  # header, id, length, CRC
ALERT: Final = 0x80  # in the error byte: Hardware Error Status (70) says what it is

_HEADER: Final = b"\xff\xff\xfd\x00"
_PATTERN: Final = b"\xff\xff\xfd"
_STUFFED: Final = b"\xff\xff\xfd\xfd"
_HEAD: Final = 7  # header, id, length
_CRC: Final = 2
_MAX_LENGTH: Final = MAX_DATA_BYTES + MAX_DATA_BYTES // len(_PATTERN) + _CRC

READER_COUNTERS: Final = ("skipped_bytes", "bad_length", "bad_crc", "bad_id", "cut_off")

ERROR_WORDS: Final[dict[int, str]] = {
    1: "result fail",
    2: "instruction error",
    3: "CRC error",
    4: "data range error",
    5: "data length error",
    6: "data limit error",
    7: "access error",
}


class Instruction(IntEnum):
    """Instructions that matter here."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class Status(NamedTuple):
    """A status packet: the number of the error, 0 without one; whether the servo alerts; the parameters."""

    error: int
    alert: bool
    data: bytes


def packet(servo_id: int, data: bytes) -> Frame:
    """Return instruction and parameters as a frame."""
    return Frame(servo_id, data, len(data) > 8)


def ping(servo_id: int) -> Frame:
    """Return PING; of `BROADCAST_ID` for all."""
    return packet(servo_id, bytes((Instruction.PING,)))


def read(servo_id: int, address: int, size: int) -> Frame:
    """Return READ."""
    return packet(servo_id, bytes((Instruction.READ,)) + _word(address) + _word(size))


def write(servo_id: int, address: int, data: bytes) -> Frame:
    """Return WRITE, which the servo answers."""
    return packet(servo_id, bytes((Instruction.WRITE,)) + _word(address) + data)


def write_unanswered(servo_id: int, address: int, data: bytes) -> Frame:
    """Return SYNC WRITE to one servo: as WRITE, but no status packet comes back."""
    parameters = _word(address) + _word(len(data)) + bytes((servo_id,)) + data
    return packet(BROADCAST_ID, bytes((Instruction.SYNC_WRITE,)) + parameters)


def reboot(servo_id: int) -> Frame:
    """Return REBOOT."""
    return packet(servo_id, bytes((Instruction.REBOOT,)))


def parse_status(data: bytes) -> Status | None:
    """Return a status packet, None for what is none."""
    if len(data) < 2 or data[0] != Instruction.STATUS:
        return None
    return Status(data[1] & ~ALERT, bool(data[1] & ALERT), data[2:])


def error_words(error: int) -> str:
    """Return the number of an error in words."""
    return ERROR_WORDS.get(error, f"error {error}")


def encode(frame: Frame) -> bytes:
    """Return the bytes of a packet; ValueError for an id or a length that can't be."""
    servo_id, data = frame[0], frame[1]
    if not (0 <= servo_id <= MAX_ID or servo_id == BROADCAST_ID):
        raise ValueError(f"no servo has the id {servo_id}")
    if not 1 <= len(data) <= MAX_DATA_BYTES:
        raise ValueError(f"a packet has 1 to {MAX_DATA_BYTES} bytes of instruction and parameters, not {len(data)}")
    body = data.replace(_PATTERN, _STUFFED)
    head = _HEADER + bytes((servo_id,)) + _word(len(body) + _CRC) + body
    return head + _word(crc16.umts(head))


class Reader:
    """Bytes to packets; memory is bounded by one packet.

    A header can't stand inside a packet, so one that does tells that the packet before was cut off.
    """

    def __init__(self) -> None:
        self.counters = dict.fromkeys(READER_COUNTERS, 0)
        self._partial = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Return the packets that these bytes complete, in order."""
        data = self._partial + data
        frames: list[Frame] = []
        at = 0
        while True:
            begin = data.find(_HEADER, at)
            if begin < 0:
                begin = len(data) - _header_begun(data[at:])
            self.counters["skipped_bytes"] += begin - at
            if len(data) - begin < _HEAD:
                break
            length = data[begin + 5] | data[begin + 6] << 8
            if not _CRC < length <= _MAX_LENGTH:
                self.counters["bad_length"] += 1
                at = begin + len(_HEADER)
                continue
            end = begin + _HEAD + length
            within = data.find(_HEADER, begin + len(_HEADER), end - _CRC)
            if within >= 0:
                self.counters["cut_off"] += 1
                at = within
            elif len(data) < end:
                break
            else:
                at = self._take(data[begin:end], frames, begin)
        self._partial = data[begin:]
        return frames

    def _take(self, whole: bytes, frames: list[Frame], begin: int) -> int:
        """Add the packet's frame if it is sound; return where to look on."""
        if crc16.umts(whole[:-_CRC]) != whole[-2] | whole[-1] << 8:
            self.counters["bad_crc"] += 1
            return begin + len(_HEADER)
        servo_id, data = whole[4], whole[_HEAD:-_CRC].replace(_STUFFED, _PATTERN)
        if servo_id <= MAX_ID or servo_id == BROADCAST_ID:
            if len(data) <= MAX_DATA_BYTES:
                frames.append(packet(servo_id, data))
            else:
                self.counters["bad_length"] += 1
        else:
            self.counters["bad_id"] += 1
        return begin + len(whole)


def _header_begun(data: bytes) -> int:
    """Return how many bytes at the end may be the beginning of a header."""
    return next((n for n in (3, 2, 1) if data.endswith(_HEADER[:n])), 0)


def _word(value: int) -> bytes:
    return value.to_bytes(2, "little")


FRAMING: Final = Framing(encode, Reader)
