"""Invariant: whatever bytes come, however they are cut, a reader gives the same frames, keeps at most one packet,
raises nothing, and takes the next good packet after the next zero byte. HFP-162, HFP-163, HFP-165.
"""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.golden.vectors import draw_messages
from firmware_protocol.serial_framing import FD_LENGTHS, SerialReader, encode_serial

classic = st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8), st.just(False), st.just(False))
fd_payloads = st.sampled_from(sorted(FD_LENGTHS)).flatmap(lambda n: st.binary(min_size=n, max_size=n))
frames = classic | st.builds(Frame, st.integers(0, 0x7FF), fd_payloads, st.just(True), st.just(False))
GOOD = codec.encode_setpoint(1, -77, 3, 4)


def feed_in_chunks(stream: bytes, sizes: list[int]) -> tuple[list[Frame], dict[str, int]]:
    reader, read, at, i = SerialReader(), [], 0, 0
    while at < len(stream):
        size = sizes[i % len(sizes)]
        read += reader.feed(stream[at : at + size])
        at, i = at + size, i + 1
    return read, reader.counters


@given(st.lists(frames, max_size=20))
def test_frames_survive_whole_byte_by_byte_and_with_trailing_data(sent: list[Frame]) -> None:
    stream = b"".join(encode_serial(frame) for frame in sent)
    for trailing in (b"", encode_serial(GOOD)[:-1], b"\x07\x01"):
        for sizes in ([1 << 20], [1]):
            read, counters = feed_in_chunks(stream + trailing, sizes)
            assert read == sent
            assert not any(counters.values())


@given(st.binary(max_size=600), st.lists(st.integers(1, 90), min_size=1, max_size=8))
def test_cuts_never_show(stream: bytes, sizes: list[int]) -> None:
    assert feed_in_chunks(stream, sizes) == feed_in_chunks(stream, [1 << 20])


@given(st.lists(st.binary(max_size=120) | frames.map(encode_serial), max_size=20), st.integers(1, 50))
def test_cuts_never_show_among_good_packets(parts: list[bytes], size: int) -> None:
    stream = b"".join(parts)
    assert feed_in_chunks(stream, [size]) == feed_in_chunks(stream, [1 << 20])


@given(st.binary(max_size=400), st.lists(st.integers(1, 30), min_size=1, max_size=5))
def test_the_next_good_packet_is_always_found(rubbish: bytes, sizes: list[int]) -> None:
    read, _ = feed_in_chunks(rubbish + b"\x00" + encode_serial(GOOD), sizes)
    assert read[-1] == GOOD


@given(frames, st.integers(0, 71), st.integers(1, 255))
def test_a_damaged_byte_never_gives_another_frame(frame: Frame, at: int, flip: int) -> None:
    """The CRC-16 finds every burst of up to 16 bits; a new delimiter makes two pieces, of which none is whole."""
    stream = bytearray(encode_serial(frame))
    stream[at % (len(stream) - 1)] ^= flip
    read = SerialReader().feed(bytes(stream))
    assert read in ([], [frame])


@pytest.mark.parametrize("seed", range(4))
def test_a_long_noisy_line(seed: int) -> None:
    """10**5 packets in all, a third damaged: every sound one arrives but those whose neighbour lost its delimiter."""
    rng = random.Random(seed)
    reader, sound, read = SerialReader(), 0, 0
    packets = [encode_serial(codec.encode(message, fd)) for message, fd in draw_messages(rng, 20)]
    for _ in range(25_000):
        packet = packets[rng.randrange(len(packets))]
        damage = rng.random() < 1 / 3
        if damage:
            at = rng.randrange(len(packet) - 1)
            packet = packet[:at] + bytes((rng.randrange(1, 256),)) * rng.randrange(3) + packet[at + 1 :]
        sound += not damage
        read += len(reader.feed(packet))
        assert len(reader._partial) <= 69
    assert sound <= read <= sound + 400  # a replaced byte may be the same byte
    assert sum(reader.counters.values()) > 5_000
    assert reader.feed(b"\x00" + encode_serial(GOOD)) == [GOOD]


@settings(max_examples=50)
@given(st.binary(min_size=70, max_size=4000).map(lambda b: b.replace(b"\x00", b"\x01")))
def test_memory_is_bounded_without_any_delimiter(stream: bytes) -> None:
    reader = SerialReader()
    for at in range(0, len(stream), 33):
        assert reader.feed(stream[at : at + 33]) == []
        assert len(reader._partial) <= 69
    assert reader.counters["too_long"] == 1
