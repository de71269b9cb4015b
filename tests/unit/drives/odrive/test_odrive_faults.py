"""The ODrive profile's faults, restarts, and torque that has to end; nothing from outside raises."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.states import HostPhase
from hil_forceps.drives.odrive.machine import FIRST_REFERENCES, HEARTBEAT_TIMEOUT_NS, TRANSITIONS, ODrive
from tests.unit.drives.odrive.bench import (
    CLOSED_LOOP,
    CONFIG,
    IDLE,
    MS,
    commands,
    estimates,
    heartbeat,
    iq,
    ready,
    running,
    ticks,
)


def test_an_error_ends_it_and_is_told() -> None:
    drive = running()
    drive.receive(heartbeat(IDLE, 0x1000000), 100 * MS)
    assert drive.phase is HostPhase.FAULT
    assert drive.drive_state is DriveState.FAULT
    assert drive.fault_words() == "axis error 0x1000000 (watchdog expired)"
    assert ticks(drive, 101, 20) == []
    drive.reset_fault()
    assert commands(drive.poll(130 * MS)) == [0x18]
    drive.receive(heartbeat(IDLE), 200 * MS)
    drive.poll(201 * MS)
    assert drive.phase.name == "READY"


def test_disabling_asks_for_idle_until_it_is_seen() -> None:
    drive = running()
    drive.disable()
    assert drive.setpoint(0) is None
    sent = commands(ticks(drive, 10, 120))
    assert sent == [0x07] * 3
    drive.receive(heartbeat(IDLE), 131 * MS)
    assert ticks(drive, 132, 100) == []
    assert drive.drive_state is DriveState.DISABLED


def test_disabling_while_enabling_does_not_trust_a_heartbeat_from_before() -> None:
    drive = ready()
    drive.enable()
    assert 0x07 in commands(ticks(drive, 2, FIRST_REFERENCES + 1))  # closed loop is asked for; no heartbeat says so yet
    drive.disable()
    states = [drive.drive_state]
    assert commands(drive.poll(10 * MS)) == [0x07]
    drive.receive(heartbeat(IDLE), 11 * MS)  # made before either request arrived
    states.append(drive.drive_state)
    drive.receive(heartbeat(CLOSED_LOOP), 111 * MS)
    assert commands(drive.poll(112 * MS)) == [0x07]
    drive.receive(heartbeat(IDLE), 211 * MS)
    states.append(drive.drive_state)
    assert states == [None, None, DriveState.DISABLED]
    assert drive.poll(300 * MS) == []


def test_a_drive_that_restarts_or_falls_silent_is_gone() -> None:
    drive = running()
    drive.receive(heartbeat(IDLE), 100 * MS)
    assert drive.phase is HostPhase.READY
    drive = running()
    drive.poll(9 * MS + HEARTBEAT_TIMEOUT_NS + 1)
    assert drive.phase is HostPhase.DISCONNECTED
    assert drive.setpoint(0) is None


@pytest.mark.parametrize("call", ["enable", "reset_fault"])
def test_calls_at_the_wrong_time_raise(call: str) -> None:
    with pytest.raises(ValueError, match=r"can't be enabled|no fault"):
        getattr(ODrive(CONFIG), call)()


@pytest.mark.parametrize("change", [{"node": 63}, {"node": -1}, {"rev_per_pulley_rev": 0.0}])
def test_what_is_no_odrive(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="no ODrive"):
        ODrive(CONFIG._replace(**change))  # type: ignore[arg-type]


def test_every_phase_but_the_first_can_be_left() -> None:
    for phase in set(HostPhase) - {HostPhase.DISCONNECTED}:
        assert any(source is phase for source, _ in TRANSITIONS)


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8), st.integers(-5, 20 * MS)), max_size=40))
def test_whatever_comes_nothing_raises_and_nothing_is_sent_unasked(frames: list[tuple[int, bytes, int]]) -> None:
    drive = ready()
    now_ns = 10 * MS
    for arbitration_id, data, step_ns in frames:
        now_ns += step_ns
        drive.receive(Frame(arbitration_id, data), now_ns)
        assert drive.poll(now_ns) == []
        assert drive.setpoint(0) is None
    stamps = [sample.stamp_ns for sample in drive.take_samples()]
    assert stamps == sorted(set(stamps))


def test_one_heartbeat_alone_says_nothing() -> None:
    drive = ODrive(CONFIG)
    drive.connect(0)
    drive.receive(heartbeat(IDLE, error=0x40), MS)
    assert drive.phase.name == "IDENTIFYING"
    drive.receive(heartbeat(IDLE, error=0x40), 101 * MS)
    assert drive.phase is HostPhase.FAULT


def test_frames_at_the_pace_of_samples_are_no_heartbeats() -> None:
    """Another protocol may use the id: the project's own sends a sample with that of node 5's each millisecond."""
    drive = ODrive(CONFIG)
    drive.connect(0)
    for n in range(10):
        drive.receive(heartbeat(IDLE, error=0x12345 + n), n * MS)
        drive.poll(n * MS)
    assert drive.phase is HostPhase.REFUSED
    assert "0A1h" in drive.refusal
    assert "motor_driver.profile" in drive.refusal


def test_a_drive_whose_heartbeats_stopped_is_asked_for_idle() -> None:
    drive = ready()
    drive.enable()
    ticks(drive, 2, 10)
    late = 3 * HEARTBEAT_TIMEOUT_NS // MS
    drive.poll(late * MS)
    assert drive.drive_state is None
    drive.disable()
    assert commands(drive.poll((late + 1) * MS)) == [0x07]


@pytest.mark.parametrize("state", [3, 4, 6, 7, 9, 11, 13])
def test_a_drive_that_calibrates_has_torque_and_is_asked_for_idle(state: int) -> None:
    drive = ready()
    drive.receive(heartbeat(state), 10 * MS)
    assert drive.drive_state is DriveState.ARMED
    drive.disable()
    assert commands(drive.poll(11 * MS)) == [0x07]


def test_an_axis_that_calibrates_is_refused() -> None:
    drive = ODrive(CONFIG)
    drive.connect(0)
    for n in range(0, 1200, 100):
        for frame in (heartbeat(3), estimates(0.1), iq(0.0)):
            drive.receive(frame, n * MS)
        assert drive.poll(n * MS) == []
    assert drive.phase is HostPhase.REFUSED
    assert "axis state 3" in drive.refusal


def test_a_reset_that_was_not_needed_does_not_clear_the_next_fault() -> None:
    drive = running()
    drive.receive(heartbeat(IDLE, error=0x40), 10 * MS)
    drive.reset_fault()
    drive.receive(heartbeat(IDLE), 11 * MS)  # cleared by another
    assert drive.phase is HostPhase.IDENTIFYING
    drive.receive(heartbeat(IDLE, error=0x40), 100 * MS)
    assert drive.poll(101 * MS) == []


def test_disabling_asks_for_idle_in_every_phase_of_a_connected_drive() -> None:
    drive = running()
    drive.receive(heartbeat(IDLE, error=0x40), 10 * MS)
    drive.receive(heartbeat(IDLE), 11 * MS)
    assert drive.phase is HostPhase.IDENTIFYING
    drive.disable()
    assert commands(drive.poll(12 * MS)) == [0x07]
    drive.receive(heartbeat(IDLE, error=0x40), 100 * MS)
    drive.disable()
    assert commands(drive.poll(101 * MS)) == [0x07]
    assert drive.drive_state is DriveState.FAULT
    drive.receive(heartbeat(IDLE), 201 * MS)
    assert drive.drive_state.name == "DISABLED"


def test_connecting_twice_raises() -> None:
    with pytest.raises(ValueError, match="connected already"):
        running().connect(20 * MS)


def test_frames_with_29_bits_are_somebody_elses() -> None:
    drive = running()
    before = dict(drive.counters)
    for frame in (heartbeat(IDLE, error=1), estimates(0.3), iq(2.0)):
        drive.receive(frame._replace(is_extended=True), 10 * MS)
    assert drive.phase is HostPhase.RUNNING
    assert drive.take_samples() == []
    assert drive.counters == {**before, "not_for_us": before["not_for_us"] + 3}


def heard(drive: ODrive, interval_ms: float, duration_ms: int = 1200) -> ODrive:
    """Listen to a drive whose estimates come with an interval."""
    drive.connect(0)
    due_ms = 0.0
    for n in range(duration_ms):
        while due_ms <= n:
            drive.receive(estimates(0.1), round(due_ms * MS))
            due_ms += interval_ms
        drive.receive(iq(0.0), n * MS + 1)
        if n % 100 == 0:
            drive.receive(heartbeat(IDLE), n * MS + 2)
        drive.poll(n * MS + 3)
    return drive


@pytest.mark.parametrize(("interval_ms", "phase"), [(0.5, HostPhase.REFUSED), (0.95, HostPhase.READY)])
def test_estimates_as_often_as_of_two_drives_are_refused_before_torque(interval_ms: float, phase: HostPhase) -> None:
    drive = heard(ODrive(CONFIG), interval_ms)
    assert drive.phase is phase
    if phase is HostPhase.REFUSED:
        assert "come every 0.5 ms, and motor_driver.feedback_period_s is 1 ms" in drive.refusal
        assert "another drive has the same node id" in drive.refusal


def test_estimates_that_begin_late_are_waited_for() -> None:
    """Once the time to identify was over, an idle axis whose rate was not known yet was said to calibrate."""
    drive = ODrive(CONFIG)
    drive.connect(0)
    for n in range(1100):
        if n % 100 == 0:
            drive.receive(heartbeat(IDLE), n * MS)
        if n >= 980:
            drive.receive(estimates(0.1), n * MS)
            drive.receive(iq(0.0), n * MS + 1)
        drive.poll(n * MS + 2)
        assert drive.phase is not HostPhase.REFUSED
    assert drive.phase is HostPhase.READY


def test_frames_that_a_host_read_late_make_no_second_drive() -> None:
    """Two hundred that waited in the queue are read at once; then they come as they should."""
    drive = ODrive(CONFIG)
    drive.connect(0)
    for n in range(200):
        drive.receive(estimates(0.1), n)
    for n in range(1, 150):
        drive.receive(estimates(0.1), n * MS)
        drive.receive(iq(0.0), n * MS + 1)
        if n % 100 == 1:
            drive.receive(heartbeat(IDLE), n * MS + 2)
        drive.poll(n * MS + 3)
    assert drive.phase is HostPhase.READY
