"""The mini cheetah protocol's frames against what makers print and against two programs by others, both ways."""

import json
from pathlib import Path
from typing import Any, cast

import pytest
from damiao_motor.core.motor import DaMiaoMotor
from hypothesis import given
from hypothesis import strategies as st
from motor_driver import canmotorlib

from hil_forceps.drives.mit import messages as wire
from hil_forceps.drives.mit.messages import MAX_CODE, MAX_POSITION_CODE, Codes, Special

GOLDEN = json.loads((Path(__file__).parent / "golden.json").read_text())["frames"]
NODE = 5
FIELDS = ("position_rad", "speed_rad_per_s", "kp", "kd", "torque_N_m")

positions = st.integers(0, MAX_POSITION_CODE)
twelve = st.integers(0, MAX_CODE)
commands = st.builds(Codes, positions, twelve, twelve, twelve, twelve)
STEP = 1.000001  # of a field; the last digits are the floats'


def of_kind(kind: str) -> pytest.MarkDecorator:
    frames = [frame for frame in GOLDEN if frame["kind"] == kind]
    return pytest.mark.parametrize("frame", frames, ids=[frame["name"] for frame in frames])


@of_kind("special")
def test_golden_frames_without_values(frame: dict[str, Any]) -> None:
    ours = wire.special(frame["arbitration_id"], Special[frame["special"]])
    assert (ours.arbitration_id, ours.data.hex().upper()) == (frame["arbitration_id"], frame["data"])
    assert wire.special_of(ours.data) is Special[frame["special"]]
    assert wire.parse_command(ours.data) is None


def span(name: str, ranges: dict[str, float]) -> tuple[float, float, int]:
    low = 0.0 if name in ("kp", "kd") else -ranges[name]
    return low, ranges[name], MAX_POSITION_CODE if name == "position_rad" else MAX_CODE


@of_kind("command")
def test_golden_commands(frame: dict[str, Any]) -> None:
    """The maker cut off where we round: each code is ours, or the one below."""
    codes = wire.parse_command(bytes.fromhex(frame["data"]))
    assert codes is not None
    for name, code in zip(FIELDS, codes, strict=True):
        low, high, steps = span(name, frame["ranges"])
        asked = frame["values"][name]
        assert wire.code_of(asked, low, high, steps) - code in {0, 1}
        assert 0.0 <= asked - wire.value_of(code, low, high, steps) <= STEP * (high - low) / steps
    assert wire.command(frame["arbitration_id"], codes).data.hex().upper() == frame["data"]


@of_kind("reply")
def test_golden_answers(frame: dict[str, Any]) -> None:
    reply = wire.parse_reply(bytes.fromhex(frame["data"]))
    assert reply is not None
    assert wire.is_from(frame["variant"], frame["node"], reply)
    assert not wire.is_from(frame["variant"], frame["node"] + 1, reply)
    assert wire.status_of(frame["variant"], reply) == frame["status"]
    assert wire.fault_of(frame["variant"], reply) == frame["fault"]
    reach, torque = frame["ranges"]["position_rad"], frame["ranges"]["torque_N_m"]
    # 1e-3 rad is what the user of the one on the bench wrote down
    near = max(2.0 * reach / MAX_POSITION_CODE, 1e-3)
    assert wire.measured(reply.position, reach, MAX_POSITION_CODE) == pytest.approx(
        frame["values"]["position_rad"], abs=near
    )
    assert wire.measured(reply.torque, torque, MAX_CODE) == pytest.approx(frame["values"]["torque_N_m"], abs=1e-12)


def test_the_code_for_no_torque_is_as_near_to_zero_as_any() -> None:
    for code, sign in ((wire.ZERO_SPEED_CODE, 1.0), (wire.ZERO_TORQUE_CODE, -1.0)):
        assert wire.value_of(code, -18.0, 18.0, MAX_CODE) == pytest.approx(sign * 18.0 / MAX_CODE)


@pytest.mark.parametrize("length", [0, 1, 5, 9])
def test_other_lengths_are_no_answers(length: int) -> None:
    assert wire.parse_reply(bytes(length)) is None
    assert wire.parse_command(bytes(length)) is None
    assert wire.special_of(bytes(length)) is None


@pytest.mark.parametrize("codes", [Codes(-1, 0, 0, 0, 0), Codes(1 << 16, 0, 0, 0, 0), Codes(0, 0, 4096, 0, 0)])
def test_codes_that_the_fields_do_not_hold_raise(codes: Codes) -> None:
    with pytest.raises(ValueError, match="no command"):
        wire.command(NODE, codes)


@pytest.mark.parametrize("value", [-12.6, 12.6, float("nan")])
def test_a_value_beyond_its_range_is_not_wrapped(value: float) -> None:
    with pytest.raises(ValueError, match="is beyond"):
        wire.code_of(value, -12.5, 12.5, MAX_POSITION_CODE)


def damiao_motor() -> DaMiaoMotor:
    return DaMiaoMotor(NODE, 0x15, cast(Any, None), motor_type="4310")


def values_of(codes: Codes, half: dict[str, float]) -> dict[str, float]:
    return {name: wire.value_of(code, *span(name, half)) for name, code in zip(FIELDS, codes, strict=True)}


DM4310 = {"position_rad": 12.5, "speed_rad_per_s": 30.0, "kp": 500.0, "kd": 5.0, "torque_N_m": 10.0}


@given(commands)
def test_damiao_motor_packs_what_we_do(codes: Codes) -> None:
    """It cuts off: it is given the middle of each step."""
    half = {name: value / (MAX_POSITION_CODE if name == "position_rad" else MAX_CODE) for name, value in DM4310.items()}
    value = values_of(codes, DM4310)
    middle = {name: value[name] + half[name] * (0.5 if name in ("kp", "kd") else 1.0) for name in FIELDS}
    theirs = damiao_motor().encode_cmd_msg(
        middle["position_rad"], middle["speed_rad_per_s"], middle["torque_N_m"], middle["kp"], middle["kd"]
    )
    assert theirs == wire.command(NODE, codes).data or wire.special_of(theirs) is not None


@given(positions, twelve, twelve, st.integers(0, 15))
def test_damiao_motor_reads_answers_as_we_do_but_for_half_a_step(
    position: int, speed: int, torque: int, status: int
) -> None:
    data = bytes((status << 4 | NODE,)) + (position << 24 | speed << 12 | torque).to_bytes(5, "big") + bytes((30, 31))
    theirs = damiao_motor().decode_sensor_feedback(data, 0x15)
    reply = wire.parse_reply(data)
    assert reply is not None
    assert wire.is_from("damiao", int(theirs["can_id"]), reply)
    assert wire.status_of("damiao", reply) == theirs["status_code"]
    for ours, name, reach, steps in (
        (wire.measured(reply.position, 12.5, MAX_POSITION_CODE), "pos", 12.5, MAX_POSITION_CODE),
        (wire.measured(reply.torque, 10.0, MAX_CODE), "torq", 10.0, MAX_CODE),
    ):
        assert ours - theirs[name] == pytest.approx(reach / steps)  # the middle of a step against its lower end


def test_damiao_motor_has_the_same_orders() -> None:
    for theirs, which in (
        (DaMiaoMotor.encode_enable_msg(), Special.ENTER),
        (DaMiaoMotor.encode_disable_msg(), Special.EXIT),
        (DaMiaoMotor.encode_save_position_zero_msg(), Special.SET_ZERO),
        (DaMiaoMotor.encode_clear_error_msg(), Special.CLEAR_ERRORS),
    ):
        assert wire.special(NODE, which).data == theirs


def mini_cheetah() -> canmotorlib.CanMotorController:
    """Without a socket: it takes any that is already there."""
    canmotorlib.CanMotorController.can_socket_declared = True
    return canmotorlib.CanMotorController(motor_id=NODE, motor_type="AK80_9_V2")


AK80_9_V2 = {"position_rad": 12.5, "speed_rad_per_s": 25.64, "kp": 500.0, "kd": 5.0, "torque_N_m": 18.0}


@given(commands)
def test_mini_cheetah_driver_packs_what_we_do(codes: Codes) -> None:
    controller = mini_cheetah()
    sent: list[bytes] = []
    controller._send_can_frame = sent.append
    controller._recv_can_frame = lambda: (0, 6, bytes(6))
    controller._send_raw_command(*codes)
    assert sent == [
        (codes.position << 48 | codes.speed << 36 | codes.kp << 24 | codes.kd << 12 | codes.torque).to_bytes(8, "big")
    ]
    if wire.special_of(sent[0]) is None:
        assert wire.parse_command(sent[0]) == codes


@given(positions, twelve, twelve)
def test_mini_cheetah_driver_reads_answers_as_we_do_but_for_half_a_step(position: int, speed: int, torque: int) -> None:
    controller = mini_cheetah()
    data = bytes((NODE,)) + (position << 24 | speed << 12 | torque).to_bytes(5, "big")
    angle, _, last = controller.convert_raw_to_physical_rad(*controller.decode_motor_status(data))
    reply = wire.parse_reply(data)
    assert reply is not None
    assert wire.measured(reply.position, 12.5, MAX_POSITION_CODE) - angle == pytest.approx(12.5 / MAX_POSITION_CODE)
    assert wire.measured(reply.torque, 18.0, MAX_CODE) - last == pytest.approx(18.0 / MAX_CODE)
