"""Frames of a moteus: against the maker's documents and the maker's own library, both ways; and that nothing raises."""

import json
import math
import struct
from pathlib import Path
from typing import Any

import moteus as maker
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moteus import multiplex
from moteus import protocol as maker_protocol

from firmware_protocol.frames import Frame
from hil_forceps.drives.moteus import messages as wire
from hil_forceps.drives.moteus.messages import Command, Mode, Register
from hil_forceps.drives.moteus.profile import ANSWER_BITS, REFERENCE_BITS
from hil_forceps.drives.moteus.subframes import Subframe, parse_subframes
from hil_forceps.drives.registry import PROFILES
from virtual_bus.bus.bit_timing import INTERMISSION_BITS, frame_bits_bounds

GOLDEN = json.loads((Path(__file__).parent / "golden.json").read_text())
NODE = 5
LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)


def frame_of(row: dict[str, Any]) -> Frame:
    return Frame(int(row["arbitration_id"], 16), bytes.fromhex(row["data"]), row["fd"], row["extended"])


def command_frame(position_rev: float, command: Command, node: int = NODE) -> Frame:
    arbitration_id, head, tail = wire.position_command(node, command)
    return Frame(arbitration_id, head + wire.pack_position(position_rev) + tail, True, True)


def controller() -> Any:
    """Return the maker's controller, set to ask for what the profile asks for."""
    query = maker.QueryResolution()
    for name in ("torque", "voltage", "temperature"):
        setattr(query, name, multiplex.IGNORE)
    query.q_current = multiplex.F32
    query._extra = {int(Register.MILLISECONDS): multiplex.INT32}
    return maker.Controller(id=NODE, query_resolution=query, transport=object())


def subframes(data: bytes) -> list[Subframe]:
    found = parse_subframes(data)
    assert found is not None
    return found


def padded(data: bytes) -> bytes:
    return data.ljust(next(length for length in LENGTHS if length >= len(data)), b"\x50")


@pytest.mark.parametrize("row", GOLDEN, ids=lambda row: str(row["name"]))
def test_frames_from_the_makers_documents(row: dict[str, Any]) -> None:
    found = PROFILES["moteus"].decode(frame_of(row))
    assert found is not None
    assert found.name == row["kind"]
    assert found.values == {
        key: pytest.approx(value, abs=1e-9) if isinstance(value, float) else value
        for key, value in row["values"].items()
    }
    for subframe in multiplex.parse_frame(bytes.fromhex(row["data"])):  # the maker's parser sees the same registers
        ours = next(
            each
            for each in parse_subframes(frame_of(row).data) or ()
            if each.register <= subframe.register < each.register + each.number
            and each.kind.upper() == {"RESPONSE": "REPLY"}.get(subframe.type.name, subframe.type.name)
        )
        assert ours.resolution == subframe.resolution
        if subframe.value is not None:
            assert ours.values[subframe.register - ours.register] == subframe.value


@pytest.mark.parametrize("position_rev", [0.25, -3.5, 0.0, 1e-7, 32767.0])
@pytest.mark.parametrize("command", [Command(0.0135, 0.1), Command(0.0, 0.02)])
def test_commands_are_the_makers_to_the_byte(position_rev: float, command: Command) -> None:
    theirs = controller().make_position(
        position=position_rev,
        maximum_torque=command.max_torque_N_m,
        watchdog_timeout=command.watchdog_s,
        velocity_limit=-1.0,
        accel_limit=-1.0,
        query=True,
    )
    ours = command_frame(position_rev, command)
    assert ours.data == padded(theirs.data)
    assert (theirs.destination, theirs.source, theirs.reply_required, theirs.can_prefix) == (NODE, 0, True, 0)
    assert ours.arbitration_id == 0x8000 | theirs.source << 8 | theirs.destination
    assert len(ours.data) == 48


def test_stop_and_query_are_the_makers_to_the_byte() -> None:
    assert wire.stop(NODE) == Frame(0x8005, padded(controller().make_stop(query=True).data), True, True)
    assert wire.query(NODE) == Frame(0x8005, padded(controller().make_query().data), True, True)


def test_the_makers_device_sends_our_ids_with_as_many_bits() -> None:
    """The document says that an id goes with 29 bits beyond 7FFFh; firmware and library part at 7FFh."""
    transport = maker.Transport([])
    for prefix, extended in ((0, True), (1, True)):
        command = maker.Controller(id=NODE, transport=object(), can_prefix=prefix).make_stop(query=True)
        assert transport._command_to_frame(command).is_extended_id is extended
    without_answer = maker.Controller(id=NODE, transport=object()).make_stop()
    frame = transport._command_to_frame(without_answer)
    assert frame.is_extended_id is wire.is_extended(frame.arbitration_id) is False
    assert [wire.is_extended(wire.reply_id(node)) for node in (1, 7, 8, 126)] == [False, False, True, True]


def answer(**changes: float) -> bytes:
    values = {"mode": 10, "position": 0.125, "velocity": -2.0, "current": 0.75, "fault": 0, "time": 123456} | changes
    return padded(
        struct.pack("<BBb", 0x21, 0, int(values["mode"]))
        + struct.pack("<BBff", 0x2E, 1, values["position"], values["velocity"])
        + struct.pack("<BBf", 0x2D, 4, values["current"])
        + struct.pack("<BBb", 0x21, 0x0F, int(values["fault"]))
        + struct.pack("<BBi", 0x29, 0x70, int(values["time"]))
    )


def test_the_makers_parser_reads_the_same_out_of_an_answer() -> None:
    assert wire.parse_feedback(answer()) == (10, 0.125, -2.0, 0.75, 0, 123456)
    theirs = maker_protocol.parse_reply(answer())
    assert theirs == {0: 10, 1: 0.125, 2: -2.0, 4: 0.75, 15: 0, 0x70: 123456}
    assert wire.parse_identity(answer()) is None
    assert wire.parse_identity(answer()[:28] + bytes.fromhex("2a810200010100 05000000".replace(" ", ""))) == (
        0x10100,
        5,
    )


@pytest.mark.parametrize("cut", range(28))
def test_an_answer_that_is_cut_is_none(cut: int) -> None:
    assert wire.parse_feedback(answer()[:cut]) is None


def test_an_answer_of_another_form_is_none() -> None:
    for place in (0, 1, 3, 4, 13, 14, 19, 20, 22, 23):
        other = bytearray(answer())
        other[place] ^= 0x04
        assert wire.parse_feedback(bytes(other)) is None


def test_the_lowest_integer_stands_for_nan() -> None:
    for data in ("21 01 80", "25 01 0080", "29 01 00000080"):
        (subframe,) = subframes(bytes.fromhex(data))
        assert math.isnan(subframe.values[0])
    (subframe,) = subframes(bytes.fromhex("23 0d 80 8178"))
    assert subframe.values[1:] == (-127.0, 120.0)


@pytest.mark.parametrize(
    "data",
    [
        "00",
        "01",
        "0100",
        "0d20000080",
        "11",
        "1c",
        "1c04",
        "1c84",
        "30",
        "3001",
        "41",
        "ff",
        "1c00 01",
        "1c8080808080 01",
    ],
)
def test_subframes_that_are_not_whole_or_not_known_are_none(data: str) -> None:
    assert parse_subframes(bytes.fromhex(data)) is None


def test_a_read_error_names_its_register() -> None:
    assert wire.refused_register(bytes.fromhex("21000a 31 8202 01 50")) == 0x102
    assert wire.refused_register(bytes.fromhex("21000a 30 20 02 50")) is None
    assert wire.refused_register(b"") is None


@pytest.mark.parametrize(
    "command",
    [Command(math.nan, 0.1), Command(1.0, math.nan), Command(-1.0, 0.1), Command(1.0, -0.1), Command(math.inf, 0.1)],
)
def test_no_command_goes_without_limit_or_watchdog(command: Command) -> None:
    with pytest.raises(ValueError, match="no command"):
        wire.position_command(NODE, command)


@given(st.binary(max_size=64))
def test_whatever_comes_nothing_raises(data: bytes) -> None:
    wire.parse_feedback(data)
    wire.parse_identity(data)
    wire.refused_register(data)
    for extended in (False, True):
        PROFILES["moteus"].decode(Frame(0x8005 if extended else 0x500, data, True, extended))


REGISTERS = st.integers(0, 0x200)
VALUES = {0: st.integers(-127, 127), 1: st.integers(-32767, 32767), 2: st.integers(-(2**31) + 1, 2**31 - 1)}


@given(st.data(), REGISTERS, st.integers(0, 3), st.integers(1, 6))
def test_what_is_read_is_what_was_written(data: st.DataObject, register: int, width: int, number: int) -> None:
    one = VALUES.get(width, st.floats(width=32, allow_nan=False))
    values = data.draw(st.lists(one, min_size=number, max_size=number))
    start = bytes((register & 0x7F | 0x80, register >> 7)) if register > 0x7F else bytes((register,))
    body = b"".join(struct.pack(f"<{'bhif'[width]}", value) for value in values)
    frame = bytes((0x20 | width << 2, number)) + start + body + b"\x50\x50"
    (subframe,) = subframes(frame)
    assert subframe == ("reply", width, register, tuple(values), number)
    found = [(each.register, each.value) for each in multiplex.parse_frame(frame)]
    assert found == [(register + place, value) for place, value in enumerate(values)]


def test_bits_of_reference_and_answer_are_those_of_the_wire() -> None:
    for length, bits in ((len(command_frame(0.0, Command(1.0, 0.1)).data), REFERENCE_BITS), (32, ANSWER_BITS)):
        _, most = frame_bits_bounds(length, is_fd=True, is_extended=True)
        assert (most.nominal + INTERMISSION_BITS, most.data) == bits
    assert len(answer()) == 32


def test_words_for_what_took_the_torque_off() -> None:
    assert wire.fault_words(Mode.TIMEOUT, 0) == "watchdog expired (mode 11)"
    assert wire.fault_words(Mode.FAULT, 33) == "fault 33 (motor driver fault, often under voltage)"
    assert wire.fault_words(Mode.FAULT, 77) == "fault 77 (unknown)"
