"""Parameter access and discovery (HFP-060 to HFP-066, HFP-150 to HFP-159)."""

from dataclasses import fields

import pytest

from firmware_protocol import codec
from firmware_protocol.drive.discovery import MAX_DELAY_US, identity_delay_us
from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.frames import MAX_NODE, Frame
from firmware_protocol.golden.scenarios import Script
from firmware_protocol.messages import (
    AssignNode,
    Discover,
    DriveState,
    FaultReason,
    HostHeartbeat,
    Identity,
    ParamOp,
    ParamRequest,
    ParamResponse,
    Timing,
)
from firmware_protocol.parameters import BY_NAME, DICTIONARY, Access, Index, Parameter

NODE = 3
SERIAL = 0x0000_1234_5678
LOW, ENABLE = 0, 1
WRITABLE = [row for row in DICTIONARY if row.access is Access.WRITE_WHILE_DISABLED]
READ_ONLY = [row for row in DICTIONARY if row.access is Access.READ_ONLY]


def ask(s: Script, op: int, index: int, value: int = 0) -> tuple[int, int]:
    (frame,) = s.drive.receive(codec.encode(ParamRequest(NODE, op, index, value)), s.now_us, s.theta)
    answer = codec.Decoder().decode(frame)
    assert isinstance(answer, ParamResponse)
    assert (answer.node, answer.parameter) == (NODE, index)
    return answer.op, answer.value


def identities(frames: list[Frame]) -> list[Identity]:
    decoded = [codec.Decoder().decode(frame) for frame in frames]
    return [message for message in decoded if isinstance(message, Identity)]


def test_hfp_151_reads_give_what_the_drive_is() -> None:
    s = Script("read", fd=True, sample_period_us=250, counts_per_rev=4096, torque_constant_nN_m_per_A=7)
    expected = {
        Index.PROTOCOL_MAJOR: 1,
        Index.PROTOCOL_MINOR: 0,
        Index.NODE: NODE,
        Index.SERIAL_LOW: 0x345678,
        Index.SERIAL_HIGH: 0x12,
        Index.FD: 1,
        Index.SAMPLE_PERIOD: 250,
        Index.COUNTS_PER_REV: 4096,
        Index.TORQUE_CONSTANT: 7,
    }
    for row in DICTIONARY:
        default = 0 if row.default is None else row.default
        assert ask(s, ParamOp.READ, row.number) == (ParamOp.OK, expected.get(row.number, default))


@pytest.mark.parametrize("row", WRITABLE, ids=lambda row: row.name)
def test_hfp_155_159_writes_within_bounds(row: Parameter) -> None:
    number, low, high = row.number, row.minimum, row.maximum
    for value in (low, high):
        s = Script("write")
        assert ask(s, ParamOp.WRITE, number, value) == (ParamOp.OK, value)
        assert ask(s, ParamOp.READ, number) == (ParamOp.OK, value)
    for value in (low - 1, high + 1):
        if -(1 << 31) <= value < 1 << 31:
            assert ask(s, ParamOp.WRITE, number, value) == (ParamOp.OUT_OF_RANGE, high)


def test_hfp_159_what_is_written_acts_at_once() -> None:
    s = Script("act")
    for number, value in (
        (Index.WATCHDOG_TIMEOUT, 3_000),
        (Index.REFERENCE_TOLERANCE, 50),
        (Index.MAX_STEP, 60),
        (Index.THETA_MAX, 1_000),
        (Index.THETA_MIN, -1_000),
        (Index.MAX_SAMPLE_AGE, 1),
        (Index.ARM_TIMEOUT, 4_000),
        (Index.HOST_HEARTBEAT_TIMEOUT, 6_000),
        (Index.HEARTBEAT_PERIOD, 7_000),
    ):
        assert ask(s, ParamOp.WRITE, number, value) == (ParamOp.OK, value)
    drive = s.drive
    faults = []
    for _ in range(3):
        s.sample()
    s.heartbeat(LOW)
    s.heartbeat(ENABLE)
    s.setpoint(0, age=2)
    assert drive.state is DriveState.ARMED
    s.wait(4_000)
    faults.append(drive.fault)
    for target in (61, 1_001):
        s.heartbeat(LOW)
        s.heartbeat(2)
        s.run()
        s.setpoint(target)
        faults.append(drive.fault)
    s.heartbeat(LOW)
    s.heartbeat(2)
    s.run()
    s.wait(3_000)
    faults.append(drive.fault)
    expected = ["ENABLE_TIMEOUT", "REFERENCE_RATE", "REFERENCE_POSITION", "WATCHDOG"]
    assert [fault.name for fault in faults] == expected
    s.drive.poll(s.now_us)
    assert len(s.drive.poll(s.now_us + 7_000)) == 1


def test_hfp_155_limits_do_not_cross() -> None:
    s = Script("cross")
    assert ask(s, ParamOp.WRITE, Index.THETA_MAX, 10) == (ParamOp.OK, 10)
    assert ask(s, ParamOp.WRITE, Index.THETA_MIN, 11) == (ParamOp.OUT_OF_RANGE, -(1 << 31))
    assert ask(s, ParamOp.WRITE, Index.THETA_MIN, 10) == (ParamOp.OK, 10)
    assert ask(s, ParamOp.WRITE, Index.THETA_MAX, 9) == (ParamOp.OUT_OF_RANGE, 10)
    assert ask(s, ParamOp.WRITE, Index.THETA_MAX, 11) == (ParamOp.OK, 11)


def test_hfp_152_156_158_refusals() -> None:
    s = Script("refuse")
    for op in (ParamOp.READ, ParamOp.WRITE):
        assert ask(s, op, 0x7777, 5) == (ParamOp.UNKNOWN_INDEX, 0)
    for wrong in (2, 0x0F, 0x10, 0xFF):
        assert ask(s, wrong, Index.THETA_MAX, 5) == (ParamOp.UNKNOWN_OP, (1 << 31) - 1)
        assert ask(s, wrong, 0x7777, 5) == (ParamOp.UNKNOWN_OP, 0)
    assert s.drive.counters["param_refused"] == s.drive.rejected() == 10
    assert ask(s, ParamOp.READ, Index.REJECTED) == (ParamOp.OK, 10)


@pytest.mark.parametrize("row", READ_ONLY, ids=lambda row: row.name)
def test_hfp_153_read_only(row: Parameter) -> None:
    s = Script("read only")
    held = ask(s, ParamOp.READ, row.number)[1]
    result, value = ask(s, ParamOp.WRITE, row.number, held + 1)
    assert result == ParamOp.READ_ONLY
    assert value == held


@pytest.mark.parametrize("prepare", ["arm", "run", "fault"])
def test_hfp_150_154_157_only_while_disabled(prepare: str) -> None:
    s = Script("state")
    (Script.arm if prepare == "arm" else Script.run)(s)
    if prepare == "fault":
        s.trip(FaultReason.SUPPLY)
    for row in WRITABLE:
        assert ask(s, ParamOp.READ, row.number) == (ParamOp.OK, row.default)
        for value in (row.maximum, -(1 << 31)):  # the state is judged before the range
            assert ask(s, ParamOp.WRITE, row.number, value) == (ParamOp.WRONG_STATE, row.default)
    assert ask(s, ParamOp.WRITE, Index.NODE, 5)[0] == ParamOp.READ_ONLY
    assert ask(s, ParamOp.WRITE, 0x7777, 5)[0] == ParamOp.UNKNOWN_INDEX


def test_counters_are_readable() -> None:
    s = Script("counters")
    s.run()
    s.setpoint(0, advance=5)
    assert ask(s, ParamOp.READ, Index.SETPOINTS_ACCEPTED) == (ParamOp.OK, 2)
    assert ask(s, ParamOp.READ, Index.SETPOINTS_LOST) == (ParamOp.OK, 4)
    s.drive.counters["setpoints_accepted"] = 1 << 40
    assert ask(s, ParamOp.READ, Index.SETPOINTS_ACCEPTED) == (ParamOp.OK, (1 << 31) - 1)


def test_hfp_124_the_watchdog_stays_on() -> None:
    row = BY_NAME["watchdog_timeout_us"]
    assert (row.minimum, row.maximum) == (1_000, 500_000)
    for value in (0, 999, 500_001):
        with pytest.raises(ValueError, match="watchdog_timeout_us"):
            DriveConfig(node=1, serial_number=1, watchdog_timeout_us=value)


def test_the_dictionary_and_the_config_say_the_same() -> None:
    assert len({row.number for row in DICTIONARY}) == len(DICTIONARY) == len(Index)
    defaults = {field.name: field.default for field in fields(DriveConfig)}
    for row in WRITABLE:
        assert defaults[row.name] == row.default
        assert row.default is not None
        assert row.minimum <= row.default <= row.maximum


def test_config_names_every_problem() -> None:
    with pytest.raises(ValueError, match=r"serial_number .*; node 31.*; arm_timeout_us 0.*; theta_min_raw 5 is above"):
        DriveConfig(node=31, serial_number=1 << 48, arm_timeout_us=0, theta_min_raw=5, theta_max_raw=4)
    for node in (0, 31):
        with pytest.raises(ValueError, match="node"):
            DriveConfig(node=node, serial_number=0)
    DriveConfig(node=30, serial_number=(1 << 48) - 1, theta_min_raw=5, theta_max_raw=5)


@pytest.mark.parametrize("serial", [0, 1, 0xFF_FFFF, 0x100_0000, (1 << 48) - 1])
def test_serial_number_in_two_halves(serial: int) -> None:
    drive = DriveMachine(DriveConfig(node=NODE, serial_number=serial))
    halves = []
    for index in (Index.SERIAL_LOW, Index.SERIAL_HIGH):
        (frame,) = drive.receive(codec.encode(ParamRequest(NODE, ParamOp.READ, index, 0)), 0, 0)
        answer = codec.Decoder().decode(frame)
        assert isinstance(answer, ParamResponse)
        halves.append(answer.value)
    assert halves == [serial % (1 << 24), serial // (1 << 24)]


def test_a_serial_number_fits_48_bits() -> None:
    for wrong in (-1, 1 << 48):
        with pytest.raises(ValueError, match="serial_number"):
            DriveConfig(node=1, serial_number=wrong)


@pytest.mark.parametrize("node", [0, NODE])
def test_hfp_060_061_062_identity_after_its_delay(node: int) -> None:
    s = Script("discover")
    s.wait(0)
    for count in range(300):
        s.now_us += 1
        assert s.drive.receive(codec.encode(Discover(node)), s.now_us, 0) == []
        due = s.now_us + identity_delay_us(SERIAL, count)
        s.drive.receive(codec.encode(Discover(node)), due, 0)  # while the answer waits: none of its own
        assert identities(s.drive.poll(due - 1)) == []
        assert identities(s.drive.poll(due)) == [Identity(NODE, SERIAL, 1, 0)]
        assert identities(s.drive.poll(due + 40_000)) == []
        s.now_us = due + 40_000


def test_hfp_061_delays() -> None:
    delays = {identity_delay_us(serial, 0) for serial in range(2_000)}
    assert delays == set(range(0, MAX_DELAY_US + 1, 500))
    assert MAX_DELAY_US == 31_500
    assert identity_delay_us(1, 0) == identity_delay_us(1, 256)
    together = [n for n in range(100) if identity_delay_us(5, n) == identity_delay_us(7, n)]
    assert len(together) < 10  # drives that meet once do not meet for ever


def test_discovery_works_in_every_state() -> None:
    """HFP-060: no enabling, no fault is in its way, and it is in nobody's."""
    s = Script("discover")
    for prepare in (Script.sample, Script.arm, Script.run, lambda x: x.trip(FaultReason.SUPPLY)):
        prepare(s)
        before = s.drive.state
        s.drive.receive(codec.encode(Discover(0)), s.now_us, 0)
        for _ in range(33):
            s.sample()
            s.setpoint(0)
            s.now_us += 1_000
            found = identities(s.drive.poll(s.now_us))
            if found:
                break
        assert found
        assert s.drive.state is (before if before is not DriveState.ARMED else DriveState.OPERATIONAL)
        s.heartbeat(LOW)


def assign(s: Script, serial: int, node: int) -> list[Identity]:
    return identities(s.drive.receive(codec.encode(AssignNode(0, serial, node)), s.now_us, 0))


@pytest.mark.parametrize(("node", "taken"), [(0, False), (1, True), (MAX_NODE, True), (31, False), (255, False)])
def test_hfp_063_065_node_range(node: int, taken: bool) -> None:
    s = Script("assign")
    assert assign(s, SERIAL, node) == ([Identity(node, SERIAL, 1, 0)] if taken else [])
    assert s.drive.node == (node if taken else NODE)
    assert s.drive.rejected() == s.drive.counters["assign_refused"] == (not taken)


def test_hfp_064_only_while_disabled() -> None:
    s = Script("assign")
    s.arm()
    assert assign(s, SERIAL, 9) == []
    s.setpoint(0)
    assert assign(s, SERIAL, 9) == []
    s.trip(FaultReason.SUPPLY)
    assert assign(s, SERIAL, 9) == []
    assert s.drive.counters["assign_refused"] == 3
    assert s.drive.node == NODE


def test_hfp_066_another_serial_number() -> None:
    s = Script("assign")
    assert assign(s, SERIAL + 1, 9) == []
    assert (s.drive.node, s.drive.rejected()) == (NODE, 0)


def test_a_new_node_is_heard_and_the_old_one_is_not() -> None:
    """HFP-063, HFP-085: and the host starts over with it."""
    s = Script("assign")
    s.heartbeat(LOW)
    assign(s, SERIAL, 9)
    old = codec.encode(ParamRequest(NODE, ParamOp.READ, Index.NODE, 0))
    assert s.drive.receive(old, s.now_us, 0) == []
    (frame,) = s.drive.receive(codec.encode(ParamRequest(9, ParamOp.READ, Index.NODE, 0)), s.now_us, 0)
    assert codec.Decoder().decode(frame) == ParamResponse(9, ParamOp.OK, Index.NODE, 9)
    assert {frame.arbitration_id & 31 for frame in s.drive.sample(0, 0, 0) + s.drive.poll(s.now_us)} == {9}
    for sequence, control in enumerate((ENABLE, LOW, ENABLE), start=200):
        assert s.drive.state is DriveState.DISABLED
        s.drive.receive(codec.encode(HostHeartbeat(9, control, 1, 0, sequence)), s.now_us, 0)
    assert s.drive.counters["heartbeat_stale"] == 0
    assert s.drive.node == 9
    assert codec.Decoder().decode(s.drive.sample(0, 0, 0)[1]) == Timing(9, 0, 1, 0, DriveState.ARMED, 0)
