"""Serial framing by example (HFP-160 to HFP-166); the properties are in tests/property."""

from binascii import crc_hqx

import pytest
from cobs import cobs

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.serial_framing import FD_LENGTHS, SerialReader, encode_serial

FRAME = codec.encode_setpoint(1, -1, 7, 9)
FD_FRAME = codec.encode_fd_feedback(3, 1, 2, 3, 4, 5, 2, 0)


def packet(word: int, payload: bytes) -> bytes:
    body = word.to_bytes(2, "little") + payload
    encoded: bytes = cobs.encode(body + crc_hqx(body, 0xFFFF).to_bytes(2, "little"))
    return encoded + b"\x00"


def counted(reader: SerialReader) -> dict[str, int]:
    return {name: count for name, count in reader.counters.items() if count}


def test_hfp_160_and_161_the_packet_by_hand() -> None:
    assert encode_serial(FRAME) == packet(0x0041, FRAME.data)
    assert encode_serial(FD_FRAME) == packet(0x80C3, FD_FRAME.data)
    assert encode_serial(FRAME).count(0) == 1


def test_all_lengths_that_can_frames_have_pass() -> None:
    assert {0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64} == FD_LENGTHS
    for length in sorted(FD_LENGTHS):
        for frame in [Frame(0x7FF, bytes(length), True), Frame(0, bytes(length), True)] + [
            Frame(0, b"\xff" * length)
        ] * (length <= 8):
            assert SerialReader().feed(encode_serial(frame)) == [frame]


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x41, b"", is_extended=True),
        Frame(0x800, b""),
        Frame(-1, b""),
        Frame(1, bytes(9)),
        Frame(1, bytes(9), True),
        Frame(1, bytes(65), True),
    ],
)
def test_frames_that_no_bus_has_are_the_callers_mistake(frame: Frame) -> None:
    with pytest.raises(ValueError, match=r"11-bit|fit"):
        encode_serial(frame)


@pytest.mark.parametrize(
    ("rubbish", "reason"),
    [
        (packet(0x0800, bytes(8)), "bad_id"),
        (packet(0x4041, bytes(8)), "bad_id"),
        (packet(0x0041, bytes(9)), "bad_length"),
        (packet(0x8041, bytes(9)), "bad_length"),
        (packet(0x8041, bytes(63)), "bad_length"),
        (cobs.encode(b"abc") + b"\x00", "too_short"),
        (cobs.encode(b"abcd") + b"\x00", "bad_crc"),
        (b"\x09abc\x00", "bad_cobs"),
        (b"\x01" * 70 + b"\x00", "too_long"),
    ],
)
def test_hfp_163_and_164_bad_packets_are_counted_and_the_next_is_found(rubbish: bytes, reason: str) -> None:
    reader = SerialReader()
    assert reader.feed(rubbish + encode_serial(FRAME)) == [FRAME]
    assert counted(reader) == {reason: 1}


def test_the_shortest_packet() -> None:
    empty = Frame(0x300, b"")
    assert SerialReader().feed(encode_serial(empty)) == [empty]


def test_hfp_165_memory_is_bounded_and_the_longest_packet_passes() -> None:
    longest = Frame(0x7FF, b"\x55" * 64, True)
    stream = encode_serial(longest)
    assert len(stream) == 70
    reader = SerialReader()
    assert reader.feed(stream[:-1]) == []
    assert counted(reader) == {}
    assert reader.feed(b"\x00") == [longest]
    for _ in range(1_000):
        assert reader.feed(b"\x55" * 1_000) == []
    assert counted(reader) == {"too_long": 1}
    assert len(reader._partial) == 0
    assert reader.feed(b"\x00" + stream) == [longest]


def test_a_short_max_frame_skips_fd_frames() -> None:
    reader = SerialReader(max_frame=8)
    assert reader.feed(encode_serial(FD_FRAME) + encode_serial(FRAME)) == [FRAME]
    assert counted(reader) == {"too_long": 1}
    for wrong in (7, 65):
        with pytest.raises(ValueError, match="max_frame"):
            SerialReader(max_frame=wrong)


def test_hfp_166_empty_packets_are_nothing() -> None:
    reader = SerialReader()
    assert reader.feed(b"\x00\x00" + encode_serial(FRAME) + b"\x00\x00" + encode_serial(FD_FRAME)) == [FRAME, FD_FRAME]
    assert counted(reader) == {}
