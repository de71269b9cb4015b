"""The drive's rules at their boundaries, to the microsecond, the sequence and the unit."""

import pytest

from firmware_protocol import codec
from firmware_protocol.frames import Frame, arbitration_id
from firmware_protocol.golden.scenarios import Script
from firmware_protocol.messages import (
    DriveState,
    FaultReason,
    FdFeedback,
    Feedback,
    Function,
    ParamOp,
    Timing,
)
from firmware_protocol.parameters import Index

DISABLED, ARMED, OPERATIONAL, FAULT = DriveState
LOW, ENABLE, RESET, BOTH = 0, 1, 2, 3
NODE = 3
MICROSECONDS = [(-1, OPERATIONAL), (0, FAULT), (1, FAULT)]


def rejected(s: Script) -> int:
    return s.drive.rejected()


@pytest.mark.parametrize("timeout_us", [1_000, 20_000, 500_000])
@pytest.mark.parametrize(("late_us", "state"), MICROSECONDS)
def test_hfp_120_watchdog_by_poll(timeout_us: int, late_us: int, state: DriveState) -> None:
    s = Script("watchdog", watchdog_timeout_us=timeout_us, host_heartbeat_timeout_us=2_000_000)
    s.run()
    s.wait(500)
    s.setpoint(1)
    s.wait(timeout_us + late_us)
    assert s.drive.state is state
    assert s.drive.fault is (FaultReason.WATCHDOG if state is FAULT else FaultReason.NONE)


@pytest.mark.parametrize(("late_us", "state"), MICROSECONDS)
def test_hfp_121_watchdog_when_the_reference_comes_late(late_us: int, state: DriveState) -> None:
    """Without any poll in between: the frame itself finds the timeout passed."""
    s = Script("watchdog")
    s.run()
    s.now_us += 20_000 + late_us
    s.setpoint(1)
    assert s.drive.state is state
    assert s.drive.reference_raw == (1 if state is OPERATIONAL else None)


def test_hfp_122_nothing_else_feeds_the_watchdog() -> None:
    s = Script("watchdog", host_heartbeat_timeout_us=2_000_000)
    s.run()
    for i in range(19):
        s.wait(1_000)
        s.sample()
        s.heartbeat(ENABLE)
        s.param(ParamOp.READ, Index.THETA_MAX)
        s.param(ParamOp.WRITE, Index.THETA_MAX, 0)
        s.setpoint(0, advance=0)  # repeated
        s.setpoint(0, advance=-1)  # older
        s.setpoint(0, advance=1, age=30 + i)  # stale sample
        good = codec.encode_setpoint(NODE, 0, (i + 1) & 0xFF, (i + 1) & 0xFF)
        s.receive(good._replace(arbitration_id=good.arbitration_id - 1))  # for another
        s.receive(good._replace(data=good.data[:7] + bytes((good.data[7] ^ 1,))))  # damaged
        s.receive(good._replace(data=good.data[:7]))
        s.receive(good._replace(is_fd=True))
        s.receive(Frame(arbitration_id(Function.DISCOVER, NODE), b""))
    s.wait(999)
    assert s.drive.state is OPERATIONAL
    s.wait(1)
    assert (s.drive.state, s.drive.fault) == (FAULT, FaultReason.WATCHDOG)


@pytest.mark.parametrize(("late_us", "state"), [(-1, ARMED), (0, FAULT), (1, FAULT)])
def test_hfp_098_arm_timeout(late_us: int, state: DriveState) -> None:
    s = Script("arm", arm_timeout_us=7_000)
    s.arm()
    s.wait(7_000 + late_us)
    assert s.drive.state is state
    assert s.drive.fault is (FaultReason.ENABLE_TIMEOUT if state is FAULT else FaultReason.NONE)


@pytest.mark.parametrize("arm", [True, False])
@pytest.mark.parametrize(("late_us", "faulted"), [(-1, False), (0, True), (1, True)])
def test_hfp_084_host_heartbeat_timeout(arm: bool, late_us: int, faulted: bool) -> None:
    s = Script("host", host_heartbeat_timeout_us=8_000)
    (Script.arm if arm else Script.run)(s)
    s.wait(3_000)
    s.heartbeat(ENABLE)
    s.heartbeat(ENABLE, advance=0)  # repeats do not count (HFP-083)
    s.wait(8_000 + late_us)
    assert (s.drive.fault is FaultReason.HOST_HEARTBEAT_LOST) == faulted
    assert (s.drive.state is FAULT) == faulted


def test_hfp_084_a_repeated_heartbeat_keeps_nobody_alive() -> None:
    """An adapter that goes on sending the last frame of a dead host."""
    s = Script("host")
    s.arm()
    for _ in range(100):
        s.wait(1_000)
        s.heartbeat(ENABLE, advance=0)
    assert s.drive.fault is FaultReason.HOST_HEARTBEAT_LOST
    assert s.drive.counters["heartbeat_stale"] == 99


@pytest.mark.parametrize(("lost", "state"), [(3, OPERATIONAL), (4, FAULT)])
def test_margin_of_the_host_heartbeat_as_published(lost: int, state: DriveState) -> None:
    s = Script("host", watchdog_timeout_us=500_000)
    s.run()
    s.wait(20_000 * (lost + 1))
    s.heartbeat(ENABLE)
    assert s.drive.state is state


@pytest.mark.parametrize(("lost", "state"), [(18, OPERATIONAL), (19, FAULT)])
def test_margin_of_the_watchdog_as_published(lost: int, state: DriveState) -> None:
    s = Script("watchdog")
    s.run()
    s.wait(1_000 * (lost + 1))
    s.sample()
    s.setpoint(0, advance=lost + 1)
    assert s.drive.state is state


@pytest.mark.parametrize("theta", [0, -500_000, (1 << 31) - 3, -(1 << 31) + 3, 5 << 32])
@pytest.mark.parametrize("tolerance", [0, 5])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("beyond", "state"), [(0, OPERATIONAL), (1, FAULT)])
def test_hfp_096_and_097_first_reference(theta: int, tolerance: int, sign: int, beyond: int, state: DriveState) -> None:
    s = Script("first", reference_tolerance_raw=tolerance)
    s.theta = theta
    s.arm()
    target = theta + sign * (tolerance + beyond)
    s.setpoint(target)
    assert s.drive.state is state
    if state is FAULT:
        assert s.drive.fault is FaultReason.REFERENCE_MISMATCH
    else:
        assert s.drive.reference_raw == target  # HFP-117, also across the wrap


@pytest.mark.parametrize(("offset", "state"), [(0, OPERATIONAL), (1, FAULT)])
def test_hfp_096_the_angle_is_that_at_arrival(offset: int, state: DriveState) -> None:
    s = Script("first", reference_tolerance_raw=5)
    s.arm()
    s.theta = 1_000
    s.setpoint(1_005 + offset)
    assert s.drive.state is state


@pytest.mark.parametrize("armed", [True, False])
@pytest.mark.parametrize(
    ("target", "fits"), [(-2_000, True), (-2_001, False), (3_000, True), (3_001, False), (1 << 31, False)]
)
def test_hfp_115_position_limits(armed: bool, target: int, fits: bool) -> None:
    s = Script("limits", theta_min_raw=-2_000, theta_max_raw=3_000, max_step_raw=1 << 24)
    if armed:
        s.theta = target
        s.arm()
    else:
        s.run()
    s.setpoint(target)
    assert s.drive.state is (OPERATIONAL if fits else FAULT)
    assert s.drive.fault is (FaultReason.NONE if fits else FaultReason.REFERENCE_POSITION)


def test_limits_at_the_ends_of_the_range_are_none() -> None:
    s = Script("limits", max_step_raw=1 << 24)
    for theta in (-(1 << 31), (1 << 31) - 1):
        s.theta = theta
        s.run()
        assert s.drive.state is OPERATIONAL
        s.heartbeat(LOW)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("advance", "factor"), [(1, 1), (2, 2), (7, 7), (8, 8), (9, 8), (127, 8)])
@pytest.mark.parametrize("start", [0, (1 << 31) - 1])
def test_hfp_116_step_limit(sign: int, advance: int, factor: int, start: int) -> None:
    for beyond in (0, 1):
        s = Script("step", max_step_raw=700)
        s.theta = start
        s.run()
        s.setpoint(start + sign * (700 * factor + beyond), advance)
        assert s.drive.state is (FAULT if beyond else OPERATIONAL)
        assert s.drive.fault is (FaultReason.REFERENCE_RATE if beyond else FaultReason.NONE)
        assert s.drive.reference_raw == (None if beyond else start + sign * 700 * factor)


def test_hfp_116_steps_are_from_the_reference_before() -> None:
    s = Script("step", max_step_raw=700)
    s.run()
    for target in (700, 1_400, 2_100, 1_400):
        s.setpoint(target)
        assert s.drive.reference_raw == target
    s.setpoint(2_101)
    assert s.drive.fault is FaultReason.REFERENCE_RATE


@pytest.mark.parametrize(
    ("advance", "taken"),
    [(1, True), (2, True), (126, True), (127, True), (128, False), (129, False), (255, False), (0, False)],
)
@pytest.mark.parametrize("base", [0, 5, 200, 255])
def test_hfp_042_and_110_sequence_of_references(base: int, advance: int, taken: bool) -> None:
    s = Script("sequence")
    s.arm()
    s.setpoint(0, advance=base + 1)
    s.wait(1_000)
    s.setpoint(7, advance)
    assert s.drive.reference_raw == (7 if taken else 0)
    assert s.drive.counters["setpoint_stale"] == (not taken)
    assert s.drive.counters["setpoints_lost"] == (advance - 1 if taken else 0)  # HFP-046
    assert rejected(s) == (not taken)


def test_hfp_111_any_first_sequence_is_new() -> None:
    s = Script("sequence")
    s.run()
    s.heartbeat(LOW)
    s.heartbeat(ENABLE)
    s.setpoint(0, advance=-100)
    assert s.drive.state is OPERATIONAL
    assert s.drive.counters["setpoints_lost"] == 0


@pytest.mark.parametrize("armed", [True, False])
@pytest.mark.parametrize("samples", [30, 300])
@pytest.mark.parametrize(
    ("max_age", "age", "counter"),
    [
        (20, 0, None),
        (20, 20, None),
        (20, 21, "sample_old"),
        (20, 127, "sample_old"),
        (20, 128, "sample_future"),
        (20, -1, "sample_future"),
        (0, 0, None),
        (0, 1, "sample_old"),
        (127, 127, None),
        (127, 128, "sample_future"),
    ],
)
def test_hfp_110_112_113_age_of_the_sample(
    armed: bool, samples: int, max_age: int, age: int, counter: str | None
) -> None:
    s = Script("age", max_sample_age=max_age)
    (Script.arm if armed else Script.run)(s)
    for _ in range(samples):
        s.sample()
    before = s.drive.counters["setpoints_accepted"]
    s.setpoint(3, age=age)
    assert s.drive.counters["setpoints_accepted"] - before == (counter is None)
    assert s.drive.counters["sample_old"] == (counter == "sample_old")
    assert s.drive.counters["sample_future"] == (counter == "sample_future")
    assert s.drive.fault is FaultReason.NONE
    assert rejected(s) == (counter is not None)


def test_hfp_113_no_measurement_no_reference() -> None:
    s = Script("age", max_sample_age=127)
    s.heartbeat(LOW)
    s.heartbeat(ENABLE)
    for sample_sequence in range(256):
        s.receive(codec.encode_setpoint(NODE, 0, 1, sample_sequence))
    assert s.drive.state is ARMED
    assert s.drive.counters["sample_future"] == 256


@pytest.mark.parametrize("prepare", [Script.sample, None])
def test_hfp_114_references_are_dropped_without_enabling(prepare: object) -> None:
    s = Script("not enabled")
    s.sample()
    if prepare is None:
        s.trip(FaultReason.SUPPLY)
    before = s.drive.state
    s.setpoint(0)
    assert s.drive.state is before
    assert s.drive.counters["not_enabled"] == 1
    assert rejected(s) == 1


@pytest.mark.parametrize("fd", [True, False])
def test_hfp_170_and_171_variants(fd: bool) -> None:
    s = Script("variant", fd=fd)
    s.arm()
    s.receive(codec.encode_setpoint(NODE, 0, 1, 0, fd=not fd))
    assert s.drive.state is ARMED
    s.setpoint(0)
    assert s.drive.state is OPERATIONAL
    kinds = [type(codec.Decoder().decode(frame)) for frame in s.drive.sample(5, 6, 7)]
    assert kinds == ([FdFeedback] if fd else [Feedback, Timing])
