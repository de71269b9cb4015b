"""Bits on the wire: against a bit-by-bit reference that shares nothing with the kernel, and against the bounds."""

import pytest

from firmware_protocol.frames import Frame
from virtual_bus.bus.bit_timing import BitTiming, clash, frame_bits, frame_bits_bounds

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


def reference_classic_bits(arbitration_id: int, data: bytes) -> int:
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
