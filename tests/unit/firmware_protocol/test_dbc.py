"""The DBC is the source of truth: the codec, the scales and the enumerations must say the same."""

import random
from enum import IntEnum
from importlib import resources
from typing import Any

import cantools
import pytest

from firmware_protocol import codec, scales
from firmware_protocol.frames import split_id
from firmware_protocol.golden.vectors import draw_messages
from firmware_protocol.layouts import LAYOUTS, Check
from firmware_protocol.messages import DriveState, FaultReason, Function, ParamOp, Setpoint

DBC: Any = cantools.database.load_string(
    (resources.files("firmware_protocol") / "motor_driver.dbc").read_text(encoding="ascii"), "dbc", strict=True
)
SI = {
    "theta_m_ref": (scales.ANGLE_LSB_RAD, "rad"),
    "theta_m": (scales.ANGLE_LSB_RAD, "rad"),
    "theta_j": (scales.ANGLE_LSB_RAD, "rad"),
    "current": (scales.CURRENT_LSB_A, "A"),
    "stamp_us": (scales.STAMP_LSB_NS * 1e-9, "s"),
    "tau_w": (scales.BENCH_TORQUE_LSB_N_M, "N m"),
}


def attribute(of: Any, name: str) -> Any:
    held = (of.dbc.attributes or {}).get(name)
    return DBC.dbc.attribute_definitions[name].default_value if held is None else held.value


def test_codec_and_cantools_agree_on_every_message() -> None:
    """Payload by payload, both ways, on bounds and 2,000 random values of each message."""
    seen = set()
    for message, fd in draw_messages(random.Random(4), 2_000):
        frame = codec.encode(message, fd)
        function, node = split_id(frame.arbitration_id)
        broadcast = "_ALL" if node == 0 and Function(function) in (Function.ESTOP, Function.DISCOVER) else ""
        described = DBC.get_message_by_name(Function(function).name + broadcast)
        decoded = described.decode(frame.data, decode_choices=False, scaling=False)
        for check in ("crc8", "crc16"):
            decoded.pop(check, None)
        fields = {name: value for name, value in message._asdict().items() if name != "node"}
        assert decoded == fields
        check_bytes = LAYOUTS[Function(function)].check
        values = {**fields, "crc8": frame.data[-1] if frame.data else 0}
        values["crc16"] = int.from_bytes(frame.data[-2:], "little")
        wanted = {name: values[name] for name in (signal.name for signal in described.signals)}
        assert described.encode(wanted, scaling=False, strict=False) == frame.data
        assert (check_bytes is Check.NONE) == (not {"crc8", "crc16"} & wanted.keys())
        seen.add(described.name)
    assert seen == {message.name for message in DBC.messages}


@pytest.mark.parametrize("described", DBC.messages, ids=lambda m: m.name)
def test_frames_are_described_as_the_codec_sends_them(described: Any) -> None:
    function, node = split_id(described.frame_id)
    layout = LAYOUTS[Function(function)]
    assert described.name.removesuffix("_ALL") == Function(function).name
    assert node == (0 if described.name.endswith("_ALL") or layout.highest_node == 0 else 1)
    assert described.length == max(layout.length, 0)
    assert described.is_fd == bool(layout.is_fd)
    assert not described.is_extended_frame
    assert described.comment
    choice = attribute(described, "CheckValue")
    names = DBC.dbc.attribute_definitions["CheckValue"].choices
    chosen = choice if isinstance(choice, str) else names[choice]
    assert chosen == {Check.NONE: "none", Check.CRC8: "crc8_autosar", Check.CRC16: "crc16_ccitt"}[layout.check]


@pytest.mark.parametrize("described", DBC.messages, ids=lambda m: m.name)
def test_signals_carry_raw_integers_and_say_their_si(described: Any) -> None:
    for signal in described.signals:
        assert (signal.scale, signal.offset, signal.is_float) == (1, 0, False)
        assert signal.byte_order == "little_endian"
        factor, unit = SI.get(signal.name, (1, "1"))
        assert attribute(signal, "SiFactor") == pytest.approx(factor, rel=1e-15)
        assert attribute(signal, "SiUnit") == unit


def test_value_tables_are_the_enumerations() -> None:
    tables: dict[str, type[IntEnum]] = {"state": DriveState, "fault": FaultReason, "op": ParamOp}
    found = 0
    for described in DBC.messages:
        for signal in described.signals:
            if signal.name in tables:
                expected = {int(member): member.name for member in tables[signal.name]}
                assert {value: str(name) for value, name in signal.choices.items()} == expected
                found += 1
    assert found == 3 + 3 + 2


def test_scales() -> None:
    assert pytest.approx(6.283185307179586, rel=1e-15) == 2**24 * scales.ANGLE_LSB_RAD
    assert scales.angle_raw_from_rad(scales.ANGLE_LSB_RAD * 12345) == 12345
    assert (scales.ANGLE_MODULUS, scales.STAMP_MODULUS, scales.SEQUENCE_MODULUS) == (2**32, 2**32, 2**8)
    for raw in (-(1 << 31), -1, 0, (1 << 31) - 1):
        assert scales.wrap_int32(raw) == raw
        assert scales.wrap_int32(raw + (1 << 32)) == raw
    assert scales.unwrap(5, 1 << 32, 1 << 32) == (1 << 32) + 5
    assert scales.unwrap(-5, 1 << 32, 1 << 32) == (1 << 32) - 5
    assert scales.unwrap(127, 0, 256) == 127
    assert scales.unwrap(128, 0, 256) == -128
    assert codec.encode(Setpoint(1, scales.wrap_int32(1 << 31), 0, 0)).data[:4] == b"\x00\x00\x00\x80"
