"""What the host makes of what it hears: faults, states, and frames that are none of its drive's."""

import pytest

from firmware_protocol import codec
from firmware_protocol.host.machine import HostConfig
from firmware_protocol.messages import (
    BenchSensor,
    DriveHeartbeat,
    DriveState,
    FaultReason,
    HostHeartbeat,
    Identity,
    ParamOp,
    ParamRequest,
    ParamResponse,
    Setpoint,
)
from tests.unit.firmware_protocol.host.desk import MS, NODE, Desk, P


def test_faults_by_name_and_by_unknown_number() -> None:
    desk = Desk()
    desk.ready()
    desk.sample(DriveState.FAULT, FaultReason.INTERNAL)
    assert desk.host.counters["unknown_fault"] == 0
    desk.sample(DriveState.FAULT, 15)
    assert desk.host.fault is FaultReason.INTERNAL
    assert desk.host.counters["unknown_fault"] == 1
    (sample,) = desk.host.take_samples()[-1:]
    assert (sample.state, sample.fault) == (3, 15)


def test_dropping_out_is_counted() -> None:
    desk = Desk()
    desk.running()
    desk.sample(DriveState.DISABLED)
    assert desk.phase() is P.READY
    assert desk.host.counters["dropped_out"] == 1
    assert desk.wait(1, 0) == [0]


@pytest.mark.parametrize(("silence_ms", "believed"), [(49, False), (50, True)])
def test_heartbeats_say_the_state_only_when_samples_stay_away(silence_ms: int, believed: bool) -> None:
    desk = Desk()
    desk.running()
    desk.now_ns += silence_ms * MS
    desk.drive_heartbeat(DriveState.FAULT, FaultReason.SUPPLY)
    assert (desk.host.phase is P.FAULT) == believed


def test_a_heartbeat_alone_tells_a_fault() -> None:
    desk = Desk()
    desk.identify()
    desk.drive_heartbeat(DriveState.FAULT, FaultReason.ENCODER)
    assert (desk.host.phase, desk.host.fault) == (P.FAULT, FaultReason.ENCODER)
    for count, state in enumerate((4, 9, 15), start=1):
        desk.drive_heartbeat(state, 0)
        assert desk.host.counters["unknown_state"] == count
    assert desk.phase() is P.FAULT
    assert desk.setpoint(1) is None


@pytest.mark.parametrize(("advance", "stale"), [(0, True), (1, False), (127, False), (128, True), (255, True)])
def test_stale_drive_heartbeats(advance: int, stale: bool) -> None:
    desk = Desk()
    desk.identify()
    desk.drive_heartbeat(lost=250)
    desk.drive_heartbeat(DriveState.FAULT, FaultReason.SUPPLY, lost=4, advance=advance)
    assert (desk.host.phase is P.READY) == stale
    assert desk.host.counters["stale_heartbeat"] == stale
    assert desk.host.counters["lost_setpoints"] == (0 if stale else 10)
    assert desk.host.counters["rejected_by_drive"] == 3


def test_bench_and_parameters() -> None:
    desk = Desk()
    desk.ready()
    desk.hear(BenchSensor(NODE, 5, -6, 7))
    (bench,) = desk.host.take_bench()
    assert bench == (7, 5, -6, desk.now_ns)
    assert desk.host.read_parameter(0x0201) == codec.encode(ParamRequest(NODE, ParamOp.READ, 0x0201, 0))
    assert desk.host.write_parameter(0x0201, 9) == codec.encode(ParamRequest(NODE, ParamOp.WRITE, 0x0201, 9))
    for value in range(70):
        desk.hear(ParamResponse(NODE, ParamOp.OK, 0x0201, value))
    assert [answer.value for answer in desk.host.take_responses()] == list(range(6, 70))
    assert desk.host.take_responses() == []
    assert desk.host.counters["responses_overflow"] == 6


def test_what_others_say_and_our_own_echo_are_nothing() -> None:
    desk = Desk()
    desk.ready()
    before = dict(desk.host.counters)
    desk.hear(DriveHeartbeat(5, 3, 3, 2, 0, 0, 0, 0))
    desk.hear(Identity(5, 1, 2, 0))
    desk.hear(HostHeartbeat(NODE, 1, 1, 0, 0))
    desk.hear(Setpoint(NODE, 1, 1, 0))
    assert desk.phase() is P.READY
    assert desk.host.counters == {**before, "not_for_us": before["not_for_us"] + 4}


def test_damaged_frames_are_counted() -> None:
    desk = Desk()
    desk.ready()
    good = codec.encode_feedback(NODE, 1, 2, 3)
    desk.host.receive(good._replace(data=good.data[:-1] + b"\xff"), desk.now_ns)
    assert desk.host.counters["bad_crc"] == 1


@pytest.mark.parametrize(
    "wrong",
    [{"node": 31}, {"node": -1}, {"heartbeat_period_ns": 0}, {"drive_timeout_ns": -1}, {"enable_timeout_ns": 0}],
)
def test_config_is_checked(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        HostConfig(**{"node": 1, **wrong})  # type: ignore[arg-type]
    HostConfig(node=0, heartbeat_period_ns=1)
    HostConfig(node=30)


def test_frames_of_the_drive_with_29_bits_are_somebody_elses() -> None:
    desk = Desk()
    desk.ready()
    host = desk.host
    host.take_samples()
    before = dict(host.counters)
    for frame in (codec.encode_feedback(NODE, 1, 2, 3), codec.encode_timing(NODE, 5, 3, 0, 0, 0)):
        host.receive(frame._replace(is_extended=True), desk.now_ns)
    assert host.take_samples() == []
    assert host.counters == {**before, "not_for_us": before["not_for_us"] + 2}
