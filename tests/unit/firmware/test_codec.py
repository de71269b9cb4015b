"""Frames of the reference firmware against the specification's vectors and against Python, on random ones too.

HFP_RANDOM_FRAMES sets how many random frames (100,000 here; a million: `make -C firmware_protocol/c million`).
"""

import ctypes
import json
import os
import random
from binascii import crc_hqx
from collections import Counter
from collections.abc import Iterator
from importlib import resources
from typing import Any

import pytest
from fastcrc.crc8 import autosar

from firmware_protocol import codec
from firmware_protocol.frames import Frame, arbitration_id, split_id
from firmware_protocol.golden.vectors import draw_messages
from firmware_protocol.layouts import LAYOUTS
from firmware_protocol.messages import Function, Message
from firmware_protocol.serial_framing import FD_LENGTHS, SerialReader, encode_serial
from tests.firmware_library import DBC, VERDICTS, CFrame, CSerialReader, c_serial_encode, generated_struct, library

VECTORS: dict[str, Any] = json.loads(
    (resources.files("firmware_protocol") / "golden" / "vectors.json").read_text(encoding="utf-8")
)
RANDOM_FRAMES = int(os.environ.get("HFP_RANDOM_FRAMES", "100000"))
LENGTHS = sorted(FD_LENGTHS)


def frame_of(row: dict[str, Any]) -> Frame:
    return Frame(row["id"], bytes.fromhex(row["payload"]), row["fd"])


def c_verdict(frame: Frame) -> str | None:
    c_frame = CFrame()
    c_frame.fill(frame)
    return VERDICTS[library().hfp_verify(ctypes.byref(c_frame))]


def described(function: Function, node: int) -> str:
    """Return the name that the DBC has for a message."""
    return function.name + ("_ALL" if node == 0 and function in (Function.ESTOP, Function.DISCOVER) else "")


class Generated:
    """Struct, pack and unpack of one message, as cantools writes them."""

    def __init__(self, function: Function, node: int) -> None:
        name = described(function, node)
        self.held = generated_struct(name)()
        self.names = [field[0] for field in self.held._fields_ if field[0] not in ("crc8", "crc16", "dummy")]
        prefix = f"motor_driver_{name.lower()}"
        self.pack, self.unpack = getattr(library(), f"{prefix}_pack"), getattr(library(), f"{prefix}_unpack")
        self.length = LAYOUTS[function].length

    def fields(self, data: bytes) -> dict[str, int]:
        assert self.unpack(ctypes.byref(self.held), data, ctypes.c_size_t(len(data))) == 0
        return {name: getattr(self.held, name) for name in self.names}


GENERATED: dict[tuple[Function, bool], Generated] = {}


def generated(function: Function, node: int) -> Generated:
    key = (function, node == 0)
    if key not in GENERATED:
        GENERATED[key] = Generated(function, node)
    return GENERATED[key]


def c_encode(function: Function, message: Message) -> Frame:
    """Pack the fields by the generated code, seal by ours."""
    made = generated(function, message.node)
    for name in made.names:
        setattr(made.held, name, getattr(message, name))
    frame = CFrame()
    ctypes.memset(frame.data, 0xA5, 64)  # what was there before must not show
    size = made.pack(ctypes.byref(frame.data), ctypes.byref(made.held), ctypes.c_size_t(64))
    assert size == max(made.length, 0)
    library().hfp_seal(ctypes.byref(frame), int(function), ctypes.c_uint8(message.node))
    return frame.frame()


def agree(frame: Frame, decoder: codec.Decoder) -> str:
    """Let both judge and read one frame; return the verdict."""
    before = dict(decoder.counters)
    message = decoder.decode(frame)
    wanted = None if message is not None else next(n for n, c in decoder.counters.items() if c != before[n])
    assert c_verdict(frame) == wanted, frame
    if message is not None:
        function, node = split_id(frame.arbitration_id)
        read = generated(Function(function), node).fields(frame.data)
        assert read == {name: value for name, value in message._asdict().items() if name != "node"}, frame
    return wanted or "intact"


def test_checksums() -> None:
    rng = random.Random(1)
    assert library().hfp_crc16(0xFFFF, b"123456789", 9) == 0x29B1  # the catalogue's check value
    for length in (0, 1, 2, 7, 8, 62, 64):
        data = rng.randbytes(length)
        for _ in range(20):
            identifier, start = rng.randrange(0x800), rng.randrange(0x10000)
            assert library().hfp_crc8(identifier, data, length) == autosar(identifier.to_bytes(2, "little") + data)
            assert library().hfp_crc16(start, data, length) == crc_hqx(data, start)


def test_golden_messages() -> None:
    seen = set()
    for row in VECTORS["messages"]:
        frame = frame_of(row)
        assert agree(frame, codec.Decoder()) == "intact"
        message = codec.Decoder().decode(frame)
        assert message is not None
        assert c_encode(Function[row["message"]], message) == frame
        assert c_serial_encode(frame).hex() == row["serial"]
        assert CSerialReader().feed(bytes.fromhex(row["serial"])) == [frame]
        seen.add(row["message"])
    assert seen == {function.name for function in Function}


def test_golden_rejects() -> None:
    for row in VECTORS["rejects"]:
        assert c_verdict(frame_of(row)) == row["counter"], row["case"]


def test_golden_serial_streams() -> None:
    for row in VECTORS["serial_streams"]:
        reader = CSerialReader()
        assert reader.feed(bytes.fromhex(row["stream"])) == [frame_of(frame) for frame in row["frames"]]
        assert reader.counters == row["counters"]


def test_every_id_format_and_length_is_judged_alike() -> None:
    """Dense: all ids with a message's own length, and all lengths of all functions; ids beyond 11 bits too."""
    decoder, seen = codec.Decoder(), Counter[str]()
    for identifier in range(0x800):
        for is_fd in (False, True):
            for length in (0, 8, 16):
                seen[agree(Frame(identifier, bytes(length), is_fd), decoder)] += 1
    for function in range(0x20):
        for length in range(65):
            for is_fd in (False, True):
                seen[agree(Frame(arbitration_id(function, 1), bytes(length), is_fd), decoder)] += 1
    for identifier in (0x800, 0x841, 0xFFFF):
        assert agree(Frame(identifier, bytes(8)), decoder) == "unknown_id"
    assert set(seen) == {"intact", "unknown_id", "bad_length", "bad_format", "bad_crc"}


def test_every_message_both_ways() -> None:
    """Bounds and random fields of each message, packed by C and by Python."""
    decoder, seen = codec.Decoder(), set()
    for message, fd in draw_messages(random.Random(11), 200):
        frame = codec.encode(message, fd)
        function = Function(split_id(frame.arbitration_id)[0])
        assert c_encode(function, message) == frame
        assert agree(frame, decoder) == "intact"
        seen.add(function)
    assert seen == set(Function)


@pytest.mark.parametrize("function", [f for f in Function if LAYOUTS[f].length > 0])
def test_generated_code_refuses_buffers_that_are_too_short(function: Function) -> None:
    node = LAYOUTS[function].lowest_node
    made = generated(function, node)
    short = ctypes.c_size_t(made.length - 1)
    data = ctypes.create_string_buffer(made.length)
    assert made.pack(data, ctypes.byref(made.held), short) == -22
    assert made.unpack(ctypes.byref(made.held), data, short) == -22


def test_generated_code_knows_the_ranges_of_the_dbc() -> None:
    """All that cantools writes is run, so that what we link is covered whole."""
    tried = 0
    for message in DBC.messages:
        if not message.signals:
            continue
        held = generated_struct(message.name)()
        ctypes.memset(ctypes.byref(held), 0xA5, ctypes.sizeof(held))
        prefix = f"motor_driver_{message.name.lower()}"
        assert getattr(library(), f"{prefix}_init")(ctypes.byref(held)) == 0
        assert getattr(library(), f"{prefix}_init")(None) != 0
        assert not any(bytes(held))
        for signal in message.signals:
            kind: Any = next(field[1] for field in held._fields_ if field[0] == signal.name)
            bits = 8 * ctypes.sizeof(kind)
            least, most = (-(1 << bits - 1), (1 << bits - 1) - 1) if signal.is_signed else (0, (1 << bits) - 1)
            is_in_range = getattr(library(), f"{prefix}_{signal.name}_is_in_range")
            is_in_range.restype, is_in_range.argtypes = ctypes.c_bool, (kind,)
            is_in_phys_range = getattr(library(), f"{prefix}_{signal.name}_is_in_phys_range")
            is_in_phys_range.restype, is_in_phys_range.argtypes = ctypes.c_bool, (ctypes.c_double,)
            low, high = int(signal.minimum), int(signal.maximum)
            for value in (low - 1, low, high, high + 1):
                assert is_in_phys_range(value) == (low <= value <= high)
                if least <= value <= most:
                    assert is_in_range(value) == (low <= value <= high), (message.name, signal.name, value)
                    tried += 1
    assert tried > 100


POOL = [codec.encode(message, fd) for message, fd in draw_messages(random.Random(12), 300)]


def random_frames(rng: random.Random, count: int) -> Iterator[Frame]:
    """Messages with random fields, whole or with a bit, a length, an id or a format that is not theirs; noise."""
    for i in range(count):
        identifier, data, is_fd, _ = POOL[rng.randrange(len(POOL))]
        kind = i % 8
        if kind == 0 and data:
            bit = rng.randrange(8 * len(data))
            data = (int.from_bytes(data, "little") ^ 1 << bit).to_bytes(len(data), "little")
        elif kind == 1:
            identifier = rng.randrange(0x800)
        elif kind == 2:
            data = data[: rng.randrange(9)] + rng.randbytes(rng.choice((0, 0, 1, 8)))
        elif kind == 3:
            is_fd = not is_fd
        elif kind == 4:
            length = rng.randrange(9) if rng.random() < 0.5 else rng.choice(LENGTHS)
            identifier, data, is_fd = rng.randrange(0x360), rng.randbytes(length), length > 8
        elif kind == 5 and data:  # random payload with a right check: reserved bits, codes without meaning
            function = Function(identifier >> 5)
            check = int(LAYOUTS[function].check)
            body = rng.randbytes(len(data) - check)
            tail = b""
            head = identifier.to_bytes(2, "little")
            if check:
                value = autosar(head + body) if check == 1 else crc_hqx(head + body, 0xFFFF)
                tail = value.to_bytes(check, "little")
            data = body + tail
        yield Frame(identifier, data, is_fd)


def test_random_frames_are_judged_and_read_alike() -> None:
    decoder, seen = codec.Decoder(), Counter[str]()
    for frame in random_frames(random.Random(RANDOM_FRAMES), RANDOM_FRAMES):
        seen[agree(frame, decoder)] += 1
    assert sum(seen.values()) == RANDOM_FRAMES
    for verdict in ("intact", "unknown_id", "bad_length", "bad_format", "bad_crc"):
        assert seen[verdict] > RANDOM_FRAMES // 100, seen


def test_serial_packets_are_written_alike() -> None:
    rng = random.Random(3)
    for length in LENGTHS:
        for _ in range(30):
            data = bytes(rng.choice((0, 0, 1, 255, rng.randrange(256))) for _ in range(length))
            frame = Frame(rng.randrange(0x800), data, length > 8 or rng.random() < 0.5)
            assert c_serial_encode(frame) == encode_serial(frame)


def test_serial_packets_that_no_can_frame_has_are_not_written() -> None:
    assert c_serial_encode(Frame(0x800, b"")) == b""
    assert c_serial_encode(Frame(1, bytes(9))) == b""
    for length in set(range(65)) - FD_LENGTHS:
        assert c_serial_encode(Frame(1, bytes(length), True)) == b""
    frame = CFrame(id=1, is_fd=True, length=255)
    assert library().hfp_serial_encode(ctypes.byref(frame), ctypes.create_string_buffer(70)) == 0


def random_stream(rng: random.Random) -> bytes:
    """Packets, cut ones, damaged ones, noise, too many bytes, runs of zeros."""
    parts = []
    for frame in random_frames(rng, 40):
        fits = len(frame.data) in FD_LENGTHS and (frame.is_fd or len(frame.data) <= 8)
        packet = encode_serial(frame) if fits else rng.randbytes(rng.randrange(20)) + b"\0"
        match rng.randrange(8):
            case 0:
                packet = packet[: rng.randrange(len(packet))]
            case 1:
                packet = packet[:-1].replace(packet[:1], rng.randbytes(1), 1) + b"\0"
            case 2:
                packet += rng.randbytes(rng.choice((1, 69, 70, 71, 300)))
            case 3:
                word = rng.choice((0x0800, 0x7FFF, 0x8800, 0x07FF, 0x87FF)).to_bytes(2, "little")
                body = word + rng.randbytes(rng.choice((*range(20), 63, 64)))
                packet = cobs_packet(body + crc_hqx(body, 0xFFFF).to_bytes(2, "little"))
            case 4:
                packet = b"\0" * rng.randrange(3) + packet
            case 5:
                packet = cobs_packet(rng.randbytes(rng.randrange(6)))
        parts.append(packet)
    return b"".join(parts)


def cobs_packet(plain: bytes) -> bytes:
    runs = plain.split(b"\0")
    return b"".join(bytes((len(run) + 1,)) + run for run in runs) + b"\0"


@pytest.mark.parametrize("max_frame", [8, 16, 64])
def test_serial_streams_are_read_alike(max_frame: int) -> None:
    rng = random.Random(max_frame)
    ours, theirs, frames = CSerialReader(max_frame), SerialReader(max_frame), 0
    for _ in range(50):
        stream = random_stream(rng)
        wanted = theirs.feed(stream)
        assert ours.feed(stream) == wanted
        assert ours.counters == theirs.counters
        frames += len(wanted)
    assert frames > 200
    never = {"bad_length"} if max_frame == 8 else set()  # too long before it can be of no length
    assert {name for name, count in theirs.counters.items() if not count} == never


def test_the_longest_packets_to_the_byte() -> None:
    for max_frame in (8, 64):
        for extra in (-1, 0, 1, 2):
            ours, theirs = CSerialReader(max_frame), SerialReader(max_frame)
            stream = b"\x01" * (max_frame + 5 + extra) + b"\0" + encode_serial(Frame(5, bytes(8)))
            assert ours.feed(stream) == theirs.feed(stream) == [Frame(5, bytes(8))]
            assert ours.counters == theirs.counters
            assert ours.counters["too_long"] == (extra > 0)


def test_a_reader_refuses_bounds_that_make_no_sense() -> None:
    for max_frame in (0, 7, 65, 255):
        with pytest.raises(ValueError, match=str(max_frame)):
            CSerialReader(max_frame)
