"""The host's heartbeats, enabling and references (HFP-080 to HFP-087, HFP-100 to HFP-102)."""

import pytest

from firmware_protocol import codec
from firmware_protocol.host.machine import HostPhase
from firmware_protocol.messages import (
    DriveState,
    FaultReason,
    HostHeartbeat,
    Setpoint,
)
from tests.unit.firmware_protocol.host.desk import MS, NODE, Desk, P


def test_hfp_080_heartbeats_each_period_and_at_each_change() -> None:
    desk = Desk()
    desk.ready()
    assert desk.wait(1, 0) == [0]
    assert desk.wait(19, 0) == []
    assert desk.wait(1, 0) == [0]
    desk.host.enable()
    assert desk.wait(1, 0) == [1]
    assert desk.wait(5, 1) == []
    desk.host.disable()
    assert desk.wait(1, 1) == [0]
    sequences = [m.sequence for m in desk.sent if isinstance(m, HostHeartbeat)]
    assert sequences == [1, 2, 3, 4]
    assert desk.host.counters["heartbeats_sent"] == 4


def test_hfp_087_enable_waits_until_low_was_seen() -> None:
    desk = Desk()
    desk.ready()
    desk.host.enable()
    assert desk.wait(41, 0) == [0, 0, 1]
    desk.sample(DriveState.ARMED)
    assert desk.phase() is P.ENABLING


def test_enable_waits_until_the_drive_let_go() -> None:
    """What is left of the last run must not pass for an answer to this one."""
    desk = Desk()
    desk.running()
    desk.host.disable()
    desk.host.enable()
    assert desk.wait(200, DriveState.OPERATIONAL) == [0] * 10
    assert desk.phase() is P.ENABLING
    assert desk.setpoint(5) is None
    assert desk.wait(1, DriveState.DISABLED) == [1]
    desk.sample(DriveState.OPERATIONAL)
    assert desk.phase() is P.RUNNING


@pytest.mark.parametrize(("ms", "phase"), [(999, P.ENABLING), (1_000, P.ENABLING), (1_001, P.READY)])
def test_enable_timeout(ms: int, phase: HostPhase) -> None:
    """It counts from the first poll after the call."""
    desk = Desk()
    desk.ready()
    desk.host.enable()
    desk.wait(ms, 0)
    assert desk.host.phase is phase
    assert desk.host.counters["enable_timeout"] == (phase is P.READY)
    if phase is P.READY:
        desk.host.enable()
        desk.wait(500, 0)
        assert desk.phase() is P.ENABLING


def test_hfp_100_and_101_references() -> None:
    desk = Desk()
    desk.ready()
    assert desk.setpoint(5) is None
    desk.host.enable()
    assert desk.setpoint(5) is None
    desk.wait(30, DriveState.DISABLED)
    assert desk.setpoint(5) is None
    for n in range(3):
        desk.sample(DriveState.ARMED, theta=1_000 + n)
        frame = desk.setpoint(5)
        assert frame == codec.encode(Setpoint(NODE, 1_000 + n, n + 1, desk.n & 0xFF))
    desk.sample(DriveState.OPERATIONAL, theta=2_000)
    assert desk.setpoint(2_005) == codec.encode(Setpoint(NODE, 2_005, 4, desk.n & 0xFF))
    desk.sample(DriveState.FAULT, FaultReason.WATCHDOG)
    assert desk.host.fault is FaultReason.WATCHDOG
    assert desk.setpoint(2_005) is None
    assert desk.host.counters["setpoints_sent"] == 4


def test_hfp_102_a_host_that_takes_no_samples_repeats_the_old_number() -> None:
    """So a drive drops its references as too old, though frames still come in."""
    desk = Desk()
    desk.running()
    assert desk.host.setpoint(5) is None
    taken = desk.host.take_samples()[-1]
    for n in range(50):
        desk.sample(DriveState.OPERATIONAL)
        assert desk.host.setpoint(5) == codec.encode(Setpoint(NODE, 5, n + 1, taken.sequence))
    assert desk.setpoint(5) == codec.encode(Setpoint(NODE, 5, 51, desk.n))


def test_what_is_left_of_the_last_session_is_no_base_for_a_reference() -> None:
    desk = Desk()
    desk.running()
    desk.wait(300)
    assert desk.phase() is P.DISCONNECTED
    assert len(desk.host.take_samples()) > 0
    desk.identify()
    desk.host.enable()
    assert desk.host.setpoint(5) is None


def test_references_wrap_and_number_on() -> None:
    desk = Desk()
    desk.running()
    for n in range(300):
        frame = desk.setpoint((5 << 32) + n)
        assert frame == codec.encode(Setpoint(NODE, n, (n + 1) & 0xFF, desk.n & 0xFF))


def test_fd_references() -> None:
    desk = Desk(fd=True)
    desk.ready()
    desk.host.enable()
    assert desk.host.take_samples() == []  # classic measurements are not for an FD host
    for n in range(60):
        desk.now_ns += MS
        state = DriveState.DISABLED if n < 50 else DriveState.OPERATIONAL
        desk.host.receive(codec.encode_fd_feedback(NODE, 5, 0, n * 1_000, n, 0, state, 0), desk.now_ns)
        desk.host.poll(desk.now_ns)
    assert desk.phase() is P.RUNNING
    assert desk.setpoint(6) == codec.encode(Setpoint(NODE, 6, 1, 59), fd=True)


def test_reset_is_one_pulse_and_ends_with_the_fault() -> None:
    desk = Desk()
    desk.faulted()
    desk.wait(40, DriveState.FAULT)
    desk.host.reset_fault()
    assert desk.wait(60, DriveState.FAULT) == [2, 2, 2, 0]
    assert desk.wait(60, DriveState.FAULT) == [0, 0, 0]
    desk.host.reset_fault()
    desk.host.reset_fault()
    assert desk.wait(30, DriveState.FAULT) == [2, 2]
    assert desk.wait(20, DriveState.DISABLED) == [0]
    assert desk.phase() is P.READY
    assert desk.host.fault is FaultReason.NONE
    desk.sample(DriveState.FAULT, FaultReason.SUPPLY)
    assert 2 not in desk.wait(100, DriveState.FAULT)  # an old wish is no wish
