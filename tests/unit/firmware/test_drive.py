"""The drive of the reference firmware against the specification's traces and its dictionary."""

import ctypes
import json
from ctypes import c_uint8
from dataclasses import replace
from importlib import resources
from typing import Any

import pytest

from firmware_protocol import codec
from firmware_protocol.drive.config import DriveConfig
from firmware_protocol.drive.discovery import identity_delay_us
from firmware_protocol.frames import Frame, arbitration_id
from firmware_protocol.messages import (
    Discover,
    DriveHeartbeat,
    DriveState,
    FaultReason,
    Function,
    ParamOp,
    ParamRequest,
    ParamResponse,
)
from firmware_protocol.parameters import BY_NAME, DICTIONARY, Access, Index
from tests.firmware_library import CDrive, CDriveHead, c_config, dirty_memory, library, size_of

VECTORS: dict[str, Any] = json.loads(
    (resources.files("firmware_protocol") / "golden" / "vectors.json").read_text(encoding="utf-8")
)
CONFIG = DriveConfig(3, 0x1234_5678)
REJECTIONS = 11  # counters that make up `rejected`


def frame_of(row: dict[str, Any]) -> Frame:
    return Frame(row["id"], bytes.fromhex(row["payload"]), row["fd"])


@pytest.mark.parametrize("scenario", VECTORS["drive_scenarios"], ids=lambda s: s["name"])
def test_drive_scenarios_replay(scenario: dict[str, Any]) -> None:
    config = scenario["config"]
    drive = CDrive(DriveConfig(**{**config, "fd": bool(config["fd"])}))
    for step in scenario["steps"]:
        frames: list[Frame] = []
        match step["event"]:
            case "receive":
                frames = drive.receive(frame_of(step), step["now_us"], step["theta_m"])
            case "poll":
                frames = drive.poll(step["now_us"])
            case "sample":
                frames = drive.sample(step["now_us"], step["theta_m"], step["current"])
            case "trip":
                drive.trip(step["reason"])
        assert frames == [frame_of(frame) for frame in step["frames"]], step
        assert drive.status()[1:] == (step["state"], step["fault"], step["reference"]), step
    assert drive.counters() == scenario["counters"]


def ask(drive: CDrive, op: int, index: int, value: int = 0, node: int = 3) -> ParamResponse:
    (frame,) = drive.receive(codec.encode(ParamRequest(node, op, index, value)), 0, 0)
    answer = codec.Decoder().decode(frame)
    assert isinstance(answer, ParamResponse)
    assert (answer.node, answer.parameter) == (node, index)
    return answer


def test_the_dictionary_is_that_of_the_specification() -> None:
    """Every index there is, and the bounds of every row by trying them and their neighbours."""
    known = {int(row.number) for row in DICTIONARY}
    drive = CDrive(CONFIG)
    for index in (*range(0x600), 0xFFFF):
        assert (ask(drive, ParamOp.READ, index).op == ParamOp.OK) == (index in known), hex(index)
    for row in DICTIONARY:
        drive = CDrive(CONFIG)
        held = ask(drive, ParamOp.READ, row.number).value
        if row.access is Access.READ_ONLY:
            assert ask(drive, ParamOp.WRITE, row.number, row.minimum).op == ParamOp.READ_ONLY
            assert ask(drive, ParamOp.READ, row.number).value == (held + 1 if row.number == Index.REJECTED else held)
            continue
        for value in (row.minimum - 1, row.minimum, row.maximum, row.maximum + 1):
            if -(1 << 31) <= value < 1 << 31:
                fits = row.minimum <= value <= row.maximum
                answer = ask(drive, ParamOp.WRITE, row.number, value)
                assert answer.op == (ParamOp.OK if fits else ParamOp.OUT_OF_RANGE), (row.name, value)
                held = value if fits else held
                assert answer.value == held


def test_position_limits_never_cross() -> None:
    """HFP-155: to the unit, from either side."""
    drive = CDrive(replace(CONFIG, theta_min_raw=-5, theta_max_raw=5))
    for index, limit, beyond in ((Index.THETA_MIN, 5, 6), (Index.THETA_MAX, 5, 4)):
        assert ask(drive, ParamOp.WRITE, index, beyond).op == ParamOp.OUT_OF_RANGE
        assert ask(drive, ParamOp.WRITE, index, limit).op == ParamOp.OK
    drive = CDrive(replace(CONFIG, theta_min_raw=-5, theta_max_raw=5))
    assert ask(drive, ParamOp.WRITE, Index.THETA_MAX, -6) == ParamResponse(3, ParamOp.OUT_OF_RANGE, Index.THETA_MAX, 5)
    assert ask(drive, ParamOp.WRITE, Index.THETA_MAX, -5).op == ParamOp.OK
    assert ask(drive, ParamOp.WRITE, Index.THETA_MAX, (1 << 31) - 1).op == ParamOp.OK


def test_values_at_power_up() -> None:
    config = DriveConfig(
        7,
        0xA1B2_C3D4_E5F6,
        True,
        *(-5, 6, 7, 8, 1_009, 5_010, 5_011, 1_012, 13, 14, 15, 16),
    )
    drive = CDrive(config)
    for number, value in config.parameter_values().items():
        assert ask(drive, ParamOp.READ, number, node=7).value == value, hex(number)


def test_defaults_are_those_of_the_specification() -> None:
    made = library().hfp_config_default(7, 0xA1B2_C3D4_E5F6)
    wanted = c_config(DriveConfig(7, 0xA1B2_C3D4_E5F6))
    assert {name: getattr(made, name) for name in DriveConfig.__dataclass_fields__} == {
        name: getattr(wanted, name) for name in DriveConfig.__dataclass_fields__
    }


def init(**changes: int) -> bool:
    """Initialise a drive with settings that a DriveConfig could not hold."""
    config = c_config(CONFIG)
    for name, value in changes.items():
        setattr(config, name, value)
    return bool(library().hfp_drive_init(dirty_memory("drive"), ctypes.byref(config)))


def test_settings_out_of_their_bounds_are_refused() -> None:
    assert init()
    tried = 0
    for name, row in BY_NAME.items():
        if name in DriveConfig.__dataclass_fields__ and name not in ("fd", "theta_min_raw", "theta_max_raw"):
            assert init(**{name: row.minimum}), name
            assert init(**{name: row.maximum}), name
            assert not init(**{name: row.minimum - 1}), name
            if row.maximum < (1 << 31) - 1:
                assert not init(**{name: row.maximum + 1}), name
            tried += 1
    assert tried == 11
    assert init(serial_number=(1 << 48) - 1)
    assert not init(serial_number=1 << 48)
    assert init(theta_min_raw=5, theta_max_raw=5)
    assert not init(theta_min_raw=6, theta_max_raw=5)


def test_counters_saturate_where_the_wire_ends() -> None:
    for count, told, read in (
        (0xFFFE, 0xFFFE, 0xFFFE),
        (0xFFFF, 0xFFFF, 0xFFFF),
        (0x1_0000, 0xFFFF, 0x1_0000),
        ((1 << 31) - 2, 0xFFFF, (1 << 31) - 2),
        (1 << 31, 0xFFFF, (1 << 31) - 1),
        (1 << 40, 0xFFFF, (1 << 31) - 1),
    ):
        drive = CDrive(CONFIG)
        drive.head.counters[3] = count
        heartbeat = codec.Decoder().decode(drive.poll(0)[0])
        assert isinstance(heartbeat, DriveHeartbeat)
        assert heartbeat.rejected == told
        assert ask(drive, ParamOp.READ, Index.REJECTED).value == read
    drive = CDrive(CONFIG)
    drive.head.counters[13] = 0x1_0000_0203
    heartbeat = codec.Decoder().decode(drive.poll(0)[0])
    assert isinstance(heartbeat, DriveHeartbeat)
    assert heartbeat.setpoints_lost == 3
    assert ask(drive, ParamOp.READ, Index.SETPOINTS_LOST).value == (1 << 31) - 1


def test_rejected_is_the_sum_of_the_reasons() -> None:
    drive = CDrive(CONFIG)
    for i in range(len(drive.head.counters)):
        drive.head.counters[i] = 1 << 2 * i
    assert drive.rejected() == sum(1 << 2 * i for i in range(REJECTIONS))


def test_a_trip_needs_a_reason() -> None:
    drive = CDrive(CONFIG)
    drive.trip(FaultReason.NONE)
    assert drive.head.state == DriveState.DISABLED
    drive.trip(FaultReason.INTERNAL)
    assert (drive.head.state, drive.head.fault) == (DriveState.FAULT, FaultReason.INTERNAL)


@pytest.mark.parametrize("serial_number", [0, 1, 0xFFFF_FFFF_FFFF, 0x8000_0000_0000, 0xA1B2_C3D4_E5F6])
def test_discovery_delay(serial_number: int) -> None:
    """To the microsecond, for more answers than the count has values; a second DISCOVER meanwhile asks for no more."""
    drive = CDrive(replace(CONFIG, serial_number=serial_number, heartbeat_period_us=1_000_000))
    now = 0xFFFF_0000
    drive.poll(now)
    identity = Frame(arbitration_id(Function.IDENTITY, 3), serial_number.to_bytes(6, "little") + b"\x01\x00")
    for count in range(260):
        assert drive.receive(codec.encode(Discover(0 if count % 2 else 3)), now, 0) == []
        delay = identity_delay_us(serial_number, count)
        if delay:
            assert identity not in drive.poll(now + delay - 1)
            assert drive.receive(codec.encode(Discover(0)), now + delay - 1, 0) == []
        assert identity in drive.poll(now + delay)
        assert identity not in drive.poll(now + delay + 1)
        now += 40_000


def test_estop_of_any_length_reads_nothing_of_its_payload() -> None:
    for length in (0, 1, 8, 9, 63, 64):
        drive = CDrive(CONFIG)
        drive.receive(Frame(0, b"\xff" * length, length > 8), 0, 0)
        assert drive.head.fault == FaultReason.ESTOP


def test_the_head_of_the_struct_is_what_tests_take_it_for() -> None:
    assert ctypes.sizeof(CDriveHead) < size_of(library(), "drive")
    drive = CDrive(CONFIG)
    drive.receive(Frame(0x7FF, b""), 0, 0)
    assert drive.counters()["not_for_us"] == 1
    assert drive.head.node == c_uint8(3).value
