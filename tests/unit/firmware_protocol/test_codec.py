"""Codec: round trips at the bounds, the check values, and what is refused (HFP-020 to HFP-032)."""

import random
from collections.abc import Callable
from itertools import combinations

import pytest

from firmware_protocol import codec
from firmware_protocol.frames import MAX_NODE, Frame, arbitration_id, split_id
from firmware_protocol.golden.vectors import draw_messages
from firmware_protocol.layouts import LAYOUTS, Check
from firmware_protocol.messages import (
    AssignNode,
    BenchSensor,
    Discover,
    DriveHeartbeat,
    Estop,
    FdFeedback,
    Feedback,
    Function,
    HostHeartbeat,
    Identity,
    Message,
    ParamRequest,
    Setpoint,
    Timing,
)

MESSAGES = draw_messages(random.Random(20), 20)
CHECKED = [codec.encode(message, fd) for message, fd in draw_messages(random.Random(3), 1)]
CHECKED = [frame for frame in CHECKED if LAYOUTS[Function(split_id(frame.arbitration_id)[0])].check]


def crc(data: bytes, width: int, polynomial: int) -> int:
    """Bit by bit, init all ones, not reflected: nothing shared with the libraries that the codec uses."""
    register = (1 << width) - 1
    for byte in data:
        register ^= byte << (width - 8)
        for _ in range(8):
            top = register >> (width - 1)
            register = (register << 1 & (1 << width) - 1) ^ (polynomial if top else 0)
    return register


def crc8(data: bytes) -> int:
    return crc(data, 8, 0x2F) ^ 0xFF


def crc16(data: bytes) -> int:
    return crc(data, 16, 0x1021)


def decode(frame: Frame) -> tuple[Message | None, list[str]]:
    decoder = codec.Decoder()
    message = decoder.decode(frame)
    return message, [name for name, count in decoder.counters.items() for _ in range(count)]


@pytest.mark.parametrize(("message", "fd"), MESSAGES)
def test_every_message_survives_the_wire(message: Message, fd: bool) -> None:
    frame = codec.encode(message, fd)
    assert decode(frame) == (message, [])
    layout = LAYOUTS[Function(split_id(frame.arbitration_id)[0])]
    assert len(frame.data) == max(layout.length, 0)
    assert frame.is_fd == bool(layout.is_fd)


@pytest.mark.parametrize("frame", CHECKED)
def test_hfp_030_and_031_check_values_are_the_published_ones(frame: Frame) -> None:
    assert (crc8(b"123456789"), crc16(b"123456789")) == (0xDF, 0x29B1)
    head = frame.arbitration_id.to_bytes(2, "little")
    if LAYOUTS[Function(split_id(frame.arbitration_id)[0])].check is Check.CRC8:
        assert frame.data[-1] == crc8(head + frame.data[:-1])
    else:
        assert frame.data[-2:] == crc16(head + frame.data[:-2]).to_bytes(2, "little")


@pytest.mark.parametrize("frame", CHECKED)
def test_hfp_032_all_single_and_double_bit_errors_are_refused(frame: Frame) -> None:
    value = int.from_bytes(frame.data, "little")
    bits = range(8 * len(frame.data))
    decoder = codec.Decoder()
    errors = [(bit,) for bit in bits] + list(combinations(bits, 2))
    for error in errors:
        damaged = value ^ sum(1 << bit for bit in error)
        assert decoder.decode(frame._replace(data=damaged.to_bytes(len(frame.data), "little"))) is None
    assert decoder.counters["bad_crc"] == len(errors)


@pytest.mark.parametrize("frame", CHECKED)
def test_hfp_032_sampled_triple_bit_errors_are_refused(frame: Frame) -> None:
    rng = random.Random(frame.arbitration_id)
    value = int.from_bytes(frame.data, "little")
    decoder = codec.Decoder()
    for _ in range(2_000):
        damaged = value ^ sum(1 << bit for bit in rng.sample(range(8 * len(frame.data)), 3))
        assert decoder.decode(frame._replace(data=damaged.to_bytes(len(frame.data), "little"))) is None


@pytest.mark.parametrize("frame", CHECKED)
def test_hfp_032_a_frame_under_another_id_is_refused(frame: Frame) -> None:
    """Nodes differ in up to five bits of the id; the CRC-8 finds up to three, the rest with 255/256."""
    function, node = split_id(frame.arbitration_id)
    layout = LAYOUTS[Function(function)]
    decoder = codec.Decoder()
    others = [n for n in range(layout.lowest_node, layout.highest_node + 1) if n != node]
    near = [n for n in others if (n ^ node).bit_count() <= 3]
    taken = [n for n in others if decoder.decode(frame._replace(arbitration_id=arbitration_id(Function(function), n)))]
    assert not set(taken) & set(near)
    assert len(taken) <= 1


def test_no_setpoint_is_all_zeros_or_all_ones() -> None:
    """A line stuck at a level must not move a motor."""
    for function, length in ((Function.SETPOINT, 8), (Function.FD_SETPOINT, 8)):
        for node in range(1, MAX_NODE + 1):
            for byte in (b"\x00", b"\xff"):
                frame = Frame(arbitration_id(function, node), byte * length, function is Function.FD_SETPOINT)
                assert decode(frame) == (None, ["bad_crc"])


@pytest.mark.parametrize("function", list(Function))
def test_hfp_021_only_the_right_length_passes(function: Function) -> None:
    layout = LAYOUTS[function]
    identifier = arbitration_id(function, layout.highest_node)
    for length in (*range(9), 12, 16, 20, 64):
        _, counted = decode(Frame(identifier, bytes(length), bool(layout.is_fd)))
        assert (counted == ["bad_length"]) == (length != layout.length and function is not Function.ESTOP)


@pytest.mark.parametrize("function", list(Function))
def test_hfp_022_only_the_right_format_passes(function: Function) -> None:
    layout = LAYOUTS[function]
    frame = Frame(arbitration_id(function, layout.highest_node), bytes(max(layout.length, 0)), not layout.is_fd)
    assert (decode(frame)[1] == ["bad_format"]) == (function is not Function.ESTOP)


@pytest.mark.parametrize("function", list(Function))
def test_hfp_010_and_011_ids_and_nodes(function: Function) -> None:
    layout = LAYOUTS[function]
    data = bytes(max(layout.length, 0))
    for node in range(32):
        identifier = function * 32 + node
        assert identifier == arbitration_id(function, node)
        unknown = decode(Frame(identifier, data, bool(layout.is_fd)))[1] == ["unknown_id"]
        assert unknown == (not layout.lowest_node <= node <= layout.highest_node)


def test_unassigned_functions_are_unknown() -> None:
    for identifier in range(1 << 11):
        function, _ = split_id(identifier)
        if function not in set(Function):
            assert decode(Frame(identifier, bytes(8)))[1] == ["unknown_id"]


def test_hfp_024_reserved_bits_are_ignored() -> None:
    check = crc8(bytes((0x41, 0, 1, 0, 0, 0, 2, 3, 0xFF)))
    frame = Frame(0x41, bytes((1, 0, 0, 0, 2, 3, 0xFF, check)))
    assert decode(frame) == (Setpoint(1, 1, 2, 3), [])


def test_hfp_023_reserved_bits_are_sent_as_zero() -> None:
    assert codec.encode(Setpoint(1, -1, 255, 255)).data[6] == 0
    assert codec.encode(HostHeartbeat(1, 255, 255, 255, 255)).data[3:6] == bytes(3)
    assert codec.encode(FdFeedback(1, -1, -1, (1 << 32) - 1, 255, 255, 15, 15)).data[13] == 0


def test_hfp_020_layout_by_hand() -> None:
    assert codec.encode(Feedback(1, 0x01020304, -2, 5)).data[:7] == bytes((4, 3, 2, 1, 0xFE, 0xFF, 5))
    assert codec.encode(Timing(1, 0x01020304, 5, 6, 3, 9)).data[:7] == bytes((4, 3, 2, 1, 5, 6, 0x93))
    assert codec.encode(BenchSensor(1, -2, 3, 4)).data[:7] == bytes((0xFE, 0xFF, 0xFF, 3, 0, 0, 4))
    assert codec.encode(DriveHeartbeat(1, 2, 1, 1, 0, 0x0102, 7, 8)).data[:7] == bytes((0x12, 1, 0, 2, 1, 7, 8))
    assert codec.encode(ParamRequest(1, 1, 0x0102, -2)).data[:7] == bytes((1, 2, 1, 0xFE, 0xFF, 0xFF, 0xFF))
    assert codec.encode(Identity(1, 0x010203040506, 1, 2)).data == bytes((6, 5, 4, 3, 2, 1, 1, 2))
    assert codec.encode(AssignNode(0, 0x010203040506, 7)).data[:7] == bytes((6, 5, 4, 3, 2, 1, 7))


@pytest.mark.parametrize(
    "message",
    [
        Setpoint(0, 0, 0, 0),
        Setpoint(31, 0, 0, 0),
        Setpoint(-1, 0, 0, 0),
        Setpoint(1, 1 << 31, 0, 0),
        Setpoint(1, 0, 256, 0),
        Feedback(1, 0, 1 << 15, 0),
        Timing(1, -1, 0, 0, 0, 0),
        Timing(1, 0, 0, 0, 16, 0),
        Timing(1, 0, 0, 0, 0, -1),
        BenchSensor(1, 1 << 23, 0, 0),
        Identity(1, 1 << 48, 1, 0),
        AssignNode(1, 0, 2),
        Estop(31),
        Discover(-1),
    ],
)
def test_what_does_not_fit_is_the_callers_mistake(message: Message) -> None:
    with pytest.raises(ValueError, match=r"node|fit"):
        codec.encode(message)


def test_fd_is_for_setpoints_only() -> None:
    with pytest.raises(ValueError, match="no FD variant"):
        codec.encode(Feedback(1, 0, 0, 0), fd=True)
    with pytest.raises(TypeError, match="not a message"):
        codec.encode(Frame(1, b""))  # type: ignore[arg-type]


def test_fast_paths_equal_the_general_one() -> None:
    for message, fd in draw_messages(random.Random(9), 50):
        if isinstance(message, Setpoint):
            assert codec.encode_setpoint(*message, fd) == codec.encode(message, fd)
        elif isinstance(message, Feedback):
            assert codec.encode_feedback(*message) == codec.encode(message)
        elif isinstance(message, Timing):
            assert codec.encode_timing(*message) == codec.encode(message)
        elif isinstance(message, FdFeedback):
            assert codec.encode_fd_feedback(*message) == codec.encode(message)


@pytest.mark.parametrize("node", [0, 31, -1])
def test_fast_paths_refuse_nodes(node: int) -> None:
    calls: list[Callable[[], Frame]] = [
        lambda: codec.encode_setpoint(node, 0, 0, 0),
        lambda: codec.encode_feedback(node, 0, 0, 0),
        lambda: codec.encode_timing(node, 0, 0, 0, 0, 0),
        lambda: codec.encode_fd_feedback(node, 0, 0, 0, 0, 0, 0, 0),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="node"):
            call()


def test_fast_paths_refuse_fields() -> None:
    calls: list[Callable[[], Frame]] = [
        lambda: codec.encode_setpoint(1, 1 << 31, 0, 0),
        lambda: codec.encode_setpoint(1, 0, 0, 256, fd=True),
        lambda: codec.encode_feedback(1, 0, 1 << 15, 0),
        lambda: codec.encode_timing(1, 1 << 32, 0, 0, 0, 0),
        lambda: codec.encode_fd_feedback(1, 0, 0, -1, 0, 0, 0, 0),
        lambda: codec.encode_fd_feedback(1, 0, 0, 0, 0, 0, 0, 16),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="fit"):
            call()


def test_counters_can_be_shared() -> None:
    counters = {"bad_crc": 5, "mine": 1}
    codec.Decoder(counters).decode(Frame(0x41, bytes(8)))
    assert counters == {"bad_crc": 6, "mine": 1, "unknown_id": 0, "bad_length": 0, "bad_format": 0}


def test_a_known_id_with_29_bits_is_not_known() -> None:
    decoder = codec.Decoder()
    assert decoder.decode(codec.encode_feedback(1, 1, 2, 3)._replace(is_extended=True)) is None
    assert decoder.counters["unknown_id"] == 1


def test_frames_built_the_fast_way_have_all_their_fields() -> None:
    """`make` fills in no defaults: a shorter tuple would compare unequal and lack its last field."""
    for frame in (
        codec.encode_setpoint(1, 1, 2, 3),
        codec.encode_setpoint(1, 1, 2, 3, fd=True),
        codec.encode_feedback(1, 1, 2, 3),
        codec.encode_timing(1, 1, 2, 3, 0, 0),
        codec.encode_fd_feedback(1, 1, 2, 3, 4, 5, 0, 0),
        codec.encode_bench_sensor(1, 1, 2, 3),
    ):
        assert len(frame) == len(Frame._fields)
        assert frame == Frame(frame.arbitration_id, frame.data, frame.is_fd)
