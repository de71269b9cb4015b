"""How long a frame occupies the wire: exact bits with stuffing, and their bounds (ISO 11898-1:2015, 10.4 to 10.5).

Classical base frame: SOF 1, id 11, RTR 1, IDE 1, r0 1, DLC 4, data 8n, CRC 15 are stuffed; CRC delimiter 1, ACK 2,
EOF 7 are not. FD base frame, always with bit-rate switch: SOF 1, id 11, RRS 1, IDE 1, FDF 1, res 1, BRS 1 at the
nominal rate; ESI 1, DLC 4, data 8n, stuff count 4, CRC 17 or 21 with fixed stuff bits, CRC delimiter 1 at the data
rate; ACK 2, EOF 7 nominal again. The rate changes inside BRS and inside the CRC delimiter at the same share of a bit,
so counting BRS whole as nominal and the delimiter whole as data gives the same time. An extended frame has, for the 11
bits of the id and the bit behind them: id 11, SRR 1 and IDE 1, both recessive, id 18, RTR 1 (RRS 1 in FD); then, for
IDE and r0 of a classical frame, r1 1 and r0 1, and in FD at once FDF.
"""

from typing import Final, NamedTuple

from firmware_protocol.frames import MAX_BASE_ID, MAX_EXTENDED_ID, Frame
from virtual_bus.bus.stuffing import (
    FD_EXTENSION_BITS,
    FD_HEAD_BITS,
    classic_stuff_bits,
    extended_id,
    extended_stuff_bits,
    fd_head,
    fd_stuff_bits,
)

INTERMISSION_BITS: Final = 3
EOF_BITS: Final = 7
ACK_DELIMITER_BITS: Final = 1
# Error flag 6, the flags of those who answer it up to 6 more, delimiter 8 (10.4.4.2): the worst case.
ERROR_FRAME_BITS: Final = 6 + 6 + 8
RECOVERY_SEQUENCES: Final = 128  # of 11 recessive bits each, until a node that went bus-off may come back
RECOVERY_SEQUENCE_BITS: Final = 11

NS_PER_S: Final = 1_000_000_000

_CLASSIC_FIXED_BITS: Final = 44  # everything but data and stuff bits, without intermission
_CLASSIC_STUFFED_BITS: Final = 34  # of these, up to the end of the CRC
_EXTENSION_BITS: Final = 20  # more of an extended classical frame: 18 of the id, SRR, r1
_FD_MOST_HEAD_STUFF_BITS: Final = 3  # FDF 1, res 0 and BRS 1 end a run
_FD_MOST_EXTENDED_HEAD_STUFF_BITS: Final = 7  # the same, and SRR and IDE are ones
_FD_TAIL_BITS: Final = 9
_FD_FIXED_DATA_BITS: Final = 10  # ESI, DLC, stuff count, CRC delimiter
_FD_DLC_OF_LENGTH: Final = {
    **{length: length for length in range(9)},
    **{length: 9 + index for index, length in enumerate((12, 16, 20, 24, 32, 48, 64))},
}


class FrameBits(NamedTuple):
    """Bits on the wire from SOF to the end of EOF at each rate; a classical frame has none at the data rate."""

    nominal: int
    data: int


def _fd_crc_bits(length: int) -> int:
    """Return the CRC with the fixed stuff bits of stuff count and CRC: one first, then one after every four bits."""
    return 17 + 6 if length <= 16 else 21 + 7


def frame_bits(frame: Frame) -> FrameBits:
    """Count the bits of this frame as it is stuffed; ValueError when no such frame can be sent."""
    arbitration_id, data, is_fd, is_extended = frame
    length = len(data)
    if not 0 <= arbitration_id <= (MAX_EXTENDED_ID if is_extended else MAX_BASE_ID):
        raise ValueError(f"an arbitration id has {29 if is_extended else 11} bits, {arbitration_id:#x} has not")
    if not is_fd:
        if length > 8:
            raise ValueError(f"a classical frame carries at most 8 bytes, not {length}")
        number = int.from_bytes(data, "big", signed=True)
        if is_extended:
            stuffed = _EXTENSION_BITS + extended_stuff_bits(arbitration_id, length, number)
        else:
            stuffed = classic_stuff_bits(arbitration_id, length, number)
        return FrameBits(_CLASSIC_FIXED_BITS + 8 * length + stuffed, 0)
    dlc = _FD_DLC_OF_LENGTH.get(length)
    if dlc is None:
        raise ValueError(f"no CAN FD frame carries {length} bytes")
    nominal, body = fd_stuff_bits(arbitration_id, is_extended, dlc, data)
    if is_extended:
        nominal += FD_EXTENSION_BITS
    return FrameBits(
        FD_HEAD_BITS + _FD_TAIL_BITS + nominal, _FD_FIXED_DATA_BITS + 8 * length + _fd_crc_bits(length) + body
    )


def frame_bits_bounds(length: int, is_fd: bool = False, is_extended: bool = False) -> tuple[FrameBits, FrameBits]:
    """Return fewest and most bits of any frame with `length` bytes, without intermission.

    One stuff bit follows the first five equal bits and then every four: (stuffed region - 1) // 4 at most. An FD frame
    can't have more than three of them before its data phase, an extended one more than seven.
    """
    if not is_fd:
        more = _EXTENSION_BITS if is_extended else 0
        fewest = _CLASSIC_FIXED_BITS + more + 8 * length
        return FrameBits(fewest, 0), FrameBits(fewest + (_CLASSIC_STUFFED_BITS + more + 8 * length - 1) // 4, 0)
    head = FD_HEAD_BITS + (FD_EXTENSION_BITS if is_extended else 0)
    in_head = _FD_MOST_EXTENDED_HEAD_STUFF_BITS if is_extended else _FD_MOST_HEAD_STUFF_BITS
    nominal, data = head + _FD_TAIL_BITS, _FD_FIXED_DATA_BITS + 8 * length + _fd_crc_bits(length)
    stuffed = (head + 5 + 8 * length - 1) // 4
    return FrameBits(nominal, data), FrameBits(nominal + in_head, data + stuffed - in_head)


def arbitration_key(arbitration_id: int, is_extended: bool) -> int:
    """Return a number that is the lower, the sooner a frame wins the bus (ISO 11898-1:2015, 10.3).

    It is the bits that arbitrate, 0 winning: 11 of the id, then RTR 0 and IDE 0 of a base frame against SRR 1 and IDE 1
    of an extended one, and its other 18.
    """
    if is_extended:
        return (arbitration_id >> 18) << 19 | 1 << 18 | arbitration_id & 0x3FFFF
    return arbitration_id << 19


def classic_times_ns(bitrate_bit_per_s: int) -> tuple[int, ...]:
    """Return the times of classical base frames by the number of their data and stuff bits together."""
    most = 8 * 8 + (_CLASSIC_STUFFED_BITS + 8 * 8 - 1) // 4
    return tuple((_CLASSIC_FIXED_BITS + bits) * NS_PER_S // bitrate_bit_per_s for bits in range(most + 1))


def frame_time_ns(frame: Frame, bitrate_bit_per_s: int, data_bitrate_bit_per_s: int) -> int:
    """Return the time from SOF to the end of EOF, when receivers have the frame; ValueError as `frame_bits`."""
    arbitration_id, data, is_fd, is_extended = frame
    length = len(data)
    # `frame_bits` without the detour, for most frames
    if not is_fd and not is_extended and length <= 8 and 0 <= arbitration_id <= MAX_BASE_ID:
        stuffed = classic_stuff_bits(arbitration_id, length, int.from_bytes(data, "big", signed=True))
        return (_CLASSIC_FIXED_BITS + 8 * length + stuffed) * NS_PER_S // bitrate_bit_per_s
    nominal, fast = frame_bits(frame)
    return nominal * NS_PER_S // bitrate_bit_per_s + fast * NS_PER_S // data_bitrate_bit_per_s


class BitTiming(NamedTuple):
    """The two bit rates of a bus; times are rounded down to whole ns once per frame."""

    bitrate_bit_per_s: int = 1_000_000
    data_bitrate_bit_per_s: int = 5_000_000

    def bits_ns(self, nominal: int) -> int:
        """Return the time of this many bits at the nominal rate."""
        return nominal * NS_PER_S // self.bitrate_bit_per_s

    def frame_ns(self, frame: Frame) -> int:
        """Return the time from SOF to the end of EOF, when receivers have the frame; ValueError as `frame_bits`."""
        return frame_time_ns(frame, self.bitrate_bit_per_s, self.data_bitrate_bit_per_s)


class Clash(NamedTuple):
    """Two senders of one id that part after arbitration: the first bit at which they differ."""

    after_ns: int  # from SOF to the end of that bit
    first_is_dominant: bool  # the first of the two sends the dominant bit and doesn't notice


def clash(first: Frame, second: Frame, timing: BitTiming) -> Clash | None:
    """Find where two frames that share an arbitration key differ; None when they are the same bits and so one frame."""
    bits_a, bits_b = _unstuffed(first), _unstuffed(second)
    index = next((i for i, (a, b) in enumerate(zip(bits_a, bits_b, strict=False)) if a != b), None)
    if index is None:
        return None
    nominal_bits = data_bits = 0
    head_bits = FD_HEAD_BITS + (FD_EXTENSION_BITS if first.is_extended else 0)
    run, last = 0, ""
    for position in range(index + 1):
        width = 1
        if run == 5:
            width, run, last = 2, 1, "1" if last == "0" else "0"
        run = run + 1 if bits_a[position] == last else 1
        last = bits_a[position]
        if first.is_fd and second.is_fd and position >= head_bits:
            data_bits += width
        else:
            nominal_bits += width
    after = timing.bits_ns(nominal_bits) + data_bits * NS_PER_S // timing.data_bitrate_bit_per_s
    return Clash(after, bits_a[index] == "0")


def _unstuffed(frame: Frame) -> str:
    """Write the bits from SOF to the last data bit; where these agree, so do the CRCs."""
    data = "".join(f"{byte:08b}" for byte in frame.data)
    if frame.is_fd:
        head, head_bits = fd_head(frame.arbitration_id, frame.is_extended)
        return f"{head:0{head_bits}b}{_FD_DLC_OF_LENGTH[len(frame.data)]:05b}{data}"
    if frame.is_extended:
        return f"{extended_id(frame.arbitration_id) << 7 | len(frame.data):039b}{data}"
    return f"{frame.arbitration_id << 7 | len(frame.data):019b}{data}"
