"""The same frames over a byte stream: COBS, CRC-16, one zero byte as delimiter.

A packet is  u16 id (bit 15: FD)  |  payload  |  CRC-16 over both, little-endian; then COBS; then 0x00. Since COBS
leaves no zero inside, a reader that lost its place finds it again at the next zero, whatever came before.
"""

from binascii import crc_hqx
from typing import Final

from cobs import cobs

from firmware_protocol.codec import CRC16_INIT
from firmware_protocol.frames import Frame

FD_FLAG: Final = 0x8000
MAX_ID: Final = 0x7FF
MAX_CLASSIC_PAYLOAD_BYTES: Final = 8
MAX_FD_PAYLOAD_BYTES: Final = 64
FD_LENGTHS: Final = frozenset((*range(9), 12, 16, 20, 24, 32, 48, 64))  # ISO 11898-1, what a DLC can say
SERIAL_COUNTERS: Final = ("bad_cobs", "too_short", "too_long", "bad_crc", "bad_id", "bad_length")

_MIN_PACKET_BYTES: Final = 4  # id and CRC
_PACKET_OVERHEAD_BYTES: Final = 5  # id, CRC, and the one byte COBS adds to packets below 254 bytes
_DELIMITER: Final = b"\x00"


def encode_serial(frame: Frame) -> bytes:
    """Return the packet with its delimiter; ValueError when the id or the length can't be on a CAN bus."""
    identifier, data, is_fd, is_extended = frame
    if is_extended or not 0 <= identifier <= MAX_ID:
        raise ValueError(f"id {identifier:#x}: an 11-bit id is wanted")
    if not _length_fits(len(data), is_fd):
        raise ValueError(f"{len(data)} bytes do not fit one {'FD' if is_fd else 'classic'} frame")
    packet = (identifier | FD_FLAG if is_fd else identifier).to_bytes(2, "little") + data
    encoded: bytes = cobs.encode(packet + crc_hqx(packet, CRC16_INIT).to_bytes(2, "little"))
    return encoded + _DELIMITER


class SerialReader:
    """Bytes to frames. How the bytes are cut into chunks never shows; memory is bounded by one packet.

    `max_frame` is the longest payload to take, in bytes; longer packets are counted and skipped.
    """

    def __init__(self, max_frame: int = MAX_FD_PAYLOAD_BYTES) -> None:
        if not MAX_CLASSIC_PAYLOAD_BYTES <= max_frame <= MAX_FD_PAYLOAD_BYTES:
            raise ValueError(f"max_frame {max_frame}: must be {MAX_CLASSIC_PAYLOAD_BYTES} to {MAX_FD_PAYLOAD_BYTES}")
        self.counters = dict.fromkeys(SERIAL_COUNTERS, 0)
        self._longest = max_frame + _PACKET_OVERHEAD_BYTES
        self._partial = b""
        self._skipping = False  # the packet under way is already too long: drop up to its delimiter

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that these bytes complete, in order."""
        *complete, partial = (self._partial + data).split(_DELIMITER)
        frames = []
        for packet in complete:
            if self._skipping:
                self._skipping = False
            elif packet:  # an empty packet is a delimiter sent to flush the line
                frame = self._take(packet)
                if frame is not None:
                    frames.append(frame)
        if len(partial) > self._longest and not self._skipping:
            self.counters["too_long"] += 1
            self._skipping = True
        self._partial = b"" if self._skipping else partial
        return frames

    def _take(self, packet: bytes) -> Frame | None:
        outcome = "too_long" if len(packet) > self._longest else _parse(packet)
        if isinstance(outcome, Frame):
            return outcome
        self.counters[outcome] += 1
        return None


def _parse(packet: bytes) -> Frame | str:
    """Return the frame of one packet without its delimiter, or the name of the counter."""
    try:
        decoded = cobs.decode(packet)
    except cobs.DecodeError:
        return "bad_cobs"
    if len(decoded) < _MIN_PACKET_BYTES:
        return "too_short"
    if crc_hqx(decoded[:-2], CRC16_INIT) != decoded[-2] | decoded[-1] << 8:
        return "bad_crc"
    word = decoded[0] | decoded[1] << 8
    is_fd = word >= FD_FLAG
    frame = Frame(word & ~FD_FLAG, decoded[2:-2], is_fd)
    if frame.arbitration_id > MAX_ID:
        return "bad_id"
    return frame if _length_fits(len(frame.data), is_fd) else "bad_length"


def _length_fits(length: int, is_fd: bool) -> bool:
    return length in FD_LENGTHS if is_fd else length <= MAX_CLASSIC_PAYLOAD_BYTES
