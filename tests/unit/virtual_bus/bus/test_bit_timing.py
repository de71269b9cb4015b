"""Bits on the wire: against a bit-by-bit reference that shares nothing with the kernel, and against the bounds."""

import pytest

from firmware_protocol.frames import Frame
from virtual_bus.bus.bit_timing import BitTiming, arbitration_key, clash, frame_bits, frame_bits_bounds

FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)


def crc15(bits: str) -> int:
    """CRC-15/CAN by long division, as in ISO 11898-1."""
    register = 0
    for bit in bits:
        flip = int(bit) ^ (register >> 14 & 1)
        register = register << 1 & 0x7FFF
        if flip:
            register ^= 0x4599
    return register


def stuffed(bits: str) -> str:
    out = ""
    for bit in bits:
        out += bit
        if len(out) >= 5 and out[-5:] in ("00000", "11111"):
            out += "1" if bit == "0" else "0"
    return out


def reference_classic_bits(arbitration_id: int, data: bytes, is_extended: bool = False) -> int:
    if is_extended:
        bits = format(arbitration_id, "029b")
        body = "0" + bits[:11] + "11" + bits[11:] + "000" + format(len(data), "04b")
    else:
        body = "0" + format(arbitration_id, "011b") + "000" + format(len(data), "04b")
    body += "".join(format(byte, "08b") for byte in data)
    return len(stuffed(body + format(crc15(body), "015b"))) + 1 + 2 + 7


def test_reference_crc_has_the_published_check_value() -> None:
    assert crc15("".join(format(byte, "08b") for byte in b"123456789")) == 0x059E


@pytest.mark.parametrize(
    ("arbitration_id", "data"),
    [
        (0x000, b""),
        (0x7FF, b"\xff" * 8),
        (0x000, b"\x00" * 8),
        (0x041, bytes(range(8))),
        (0x078, b"\x3c" * 8),
        (0x555, b"\xaa" * 7),
    ],
)
def test_classic_frame_is_counted_as_it_is_stuffed(arbitration_id: int, data: bytes) -> None:
    assert frame_bits(Frame(arbitration_id, data)) == (reference_classic_bits(arbitration_id, data), 0)


@pytest.mark.parametrize(
    ("arbitration_id", "data"),
    [
        (0x00000000, b""),
        (0x1FFFFFFF, b"\xff" * 8),
        (0x00000000, b"\x00" * 8),
        (0x00000041, bytes(range(8))),
        (0x1E0F83C0, b"\x3c" * 8),
        (0x15555555, b"\xaa" * 7),
    ],
)
def test_extended_classic_frame_is_counted_as_it_is_stuffed(arbitration_id: int, data: bytes) -> None:
    frame = Frame(arbitration_id, data, is_extended=True)
    assert frame_bits(frame) == (reference_classic_bits(arbitration_id, data, is_extended=True), 0)
    assert BitTiming().frame_ns(frame) == 1000 * frame_bits(frame).nominal


def test_extended_frames_of_eight_bytes_take_131_to_160_bits_with_intermission() -> None:
    fewest, most = frame_bits_bounds(8, is_extended=True)
    assert (fewest.nominal + 3, most.nominal + 3) == (131, 160)


def most_stuff_bits(bits: list[str]) -> int:
    """Return the most stuff bits ahead of any of these bits, each one of the characters that it may be."""
    most = {("", 0): 0}  # by last bit and run
    for choices in bits:
        ahead: dict[tuple[str, int], int] = {}
        for (last, run), count in most.items():
            for bit in choices:
                sent, length, stuffs = (("1" if last == "0" else "0"), 1, count + 1) if run == 5 else (last, run, count)
                after = (bit, length + 1 if bit == sent else 1)
                ahead[after] = max(ahead.get(after, 0), stuffs)
        most = ahead
    return max(most.values())


@pytest.mark.parametrize("is_extended", [False, True])
def test_bound_of_the_stuff_bits_in_an_fd_head_is_the_most_that_any_id_makes(is_extended: bool) -> None:
    free = "01"
    rest = ["1", "1", *[free] * 18, "0"] if is_extended else ["0", "0"]
    head = ["0", *[free] * 11, *rest, "1", "0", "1"]
    fewest, most = frame_bits_bounds(8, is_fd=True, is_extended=is_extended)
    assert fewest.nominal == len(head) + 9
    assert most.nominal - fewest.nominal == most_stuff_bits(head)


def test_eight_bytes_take_111_to_135_bits_with_intermission() -> None:
    fewest, most = frame_bits_bounds(8)
    assert (fewest.nominal + 3, most.nominal + 3) == (111, 135)


def test_a_frame_without_runs_has_no_stuff_bits() -> None:
    data = b"\x55\x55\x55\x55\x55\x55\x55\x55"
    found = [i for i in range(0x800) if frame_bits(Frame(i, data)).nominal == frame_bits_bounds(8)[0].nominal]
    assert found, "with some id the CRC has no run of five either"


@pytest.mark.parametrize("length", FD_LENGTHS)
def test_fd_frame_phases(length: int) -> None:
    # 0x55 never stuffs; of the head, SOF and id 0x2AA alternate, and 0 0 1 0 1 ends it; DLC and ESI may stuff.
    nominal, data = frame_bits(Frame(0x2AA, b"\x55" * length, is_fd=True))
    crc = 27 if length <= 16 else 32
    assert nominal == 17 + 9
    assert data - (1 + 4 + 8 * length + crc + 1) in (0, 1)


def test_fd_run_at_the_end_of_data_is_left_to_the_fixed_stuff_bit() -> None:
    # 0xE0 ends in five zeros: inside the data they get a stuff bit, at its end they don't.
    inside = frame_bits(Frame(0x2AA, b"\xe0\xe0", is_fd=True)).data
    assert inside == frame_bits(Frame(0x2AA, b"\x55\x55", is_fd=True)).data + 1


def test_fd_time_uses_both_rates() -> None:
    frame = Frame(0x101, bytes(range(16)), is_fd=True)
    nominal, data = frame_bits(frame)
    assert BitTiming(500_000, 2_000_000).frame_ns(frame) == nominal * 2000 + data * 500


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x800, b""),
        Frame(-1, b""),
        Frame(1, b"\0" * 9),
        Frame(1, b"\0" * 9, is_fd=True),
        Frame(1, b"\0" * 65, True),
        Frame(0x20000000, b"", is_extended=True),
        Frame(0x20000000, b"", is_fd=True, is_extended=True),
        Frame(1, b"\0" * 9, is_extended=True),
    ],
)
def test_what_is_no_frame_is_refused(frame: Frame) -> None:
    with pytest.raises(ValueError, match=r"bits|bytes"):
        frame_bits(frame)
    with pytest.raises(ValueError, match=r"bits|bytes"):
        BitTiming().frame_ns(frame)


def test_clash_finds_the_first_differing_bit_behind_stuff_bits() -> None:
    timing = BitTiming()
    first, second = Frame(0x000, b"\x00\x00"), Frame(0x000, b"\x00\x80")
    met = clash(first, second, timing)
    assert met is not None
    # SOF, id, RTR, IDE, r0, DLC 0010, eight zeros, then the bit: 28 bits. Zeros up to 17, a one, zeros from 19 on:
    # stuff bits behind 5, 10, 15 and 23.
    assert met.after_ns == (28 + 4) * 1000
    assert met.first_is_dominant
    assert clash(first, first, timing) is None


def test_classic_frame_beats_fd_frame_of_the_same_id() -> None:
    met = clash(Frame(0x10, b"\x01"), Frame(0x10, b"\x01", is_fd=True), BitTiming())
    assert met is not None
    assert met.first_is_dominant  # r0 is dominant where FDF is recessive


def test_clash_of_extended_frames_counts_the_longer_head() -> None:
    timing = BitTiming()
    first, second = (Frame(0x0AAAAAAA, data, is_extended=True) for data in (b"\x00\x00", b"\x00\x80"))
    met = clash(first, second, timing)
    assert met is not None
    # SOF, 11 bits of id, SRR, IDE, 18 bits of id, RTR, r1, r0, DLC 0010, eight zeros, then the bit: 48 bits. The head
    # alternates; a stuff bit after RTR, r1, r0 and two of the DLC's, and one five zeros on.
    unstuffed = "0" + "01010101010" + "11" + "101010101010101010" + "000" + "0010" + "00000000"
    assert met.after_ns == (len(stuffed(unstuffed)) + 1) * 1000
    fast = clash(first._replace(is_fd=True), second._replace(is_fd=True), timing)
    assert fast is not None
    head = "0" + "01010101010" + "11" + "101010101010101010" + "0101"
    in_head = len(stuffed(head[:-1])) + 1
    whole = len(stuffed(head + "0" + "0010" + "00000000")) + 1
    assert fast.after_ns == in_head * 1000 + (whole - in_head) * 200
    assert clash(first, first._replace(is_fd=True), timing) is not None


ORDER = [  # bits that arbitrate, written out: the lower word of zeros and ones wins
    Frame(0x000, b""),
    Frame(0x00000000, b"", is_extended=True),
    Frame(0x00000001, b"", is_extended=True),
    Frame(0x0003FFFF, b"", is_extended=True),
    Frame(0x001, b""),
    Frame(0x00040000, b"", is_extended=True),
    Frame(0x7FF, b""),
    Frame(0x1FFC0000, b"", is_extended=True),
    Frame(0x1FFFFFFF, b"", is_extended=True),
]


def test_base_and_extended_frames_arbitrate_as_their_bits_do() -> None:
    def bits(frame: Frame) -> str:
        if not frame.is_extended:
            return f"{frame.arbitration_id:011b}00"
        number = f"{frame.arbitration_id:029b}"
        return f"{number[:11]}11{number[11:]}"

    keys = [arbitration_key(frame.arbitration_id, frame.is_extended) for frame in ORDER]
    assert keys == sorted(set(keys))
    assert [bits(frame).ljust(31, "0") for frame in ORDER] == sorted(bits(frame).ljust(31, "0") for frame in ORDER)
