"""The ODrive profile: who sends what when, what it makes of what comes, and that nothing from outside raises."""

import math
import struct
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from hil_forceps.drives.odrive.machine import FIRST_REFERENCES, HEARTBEAT_TIMEOUT_NS, TRANSITIONS, ODrive, ODriveConfig

NODE, MS = 5, 1_000_000
CONFIG = ODriveConfig(NODE, "0.6", 1.0, 0.0, 100.0, 1.0, MS)
IDLE, CLOSED_LOOP = 1, 8


def heartbeat(state: int, error: int = 0) -> Frame:
    return Frame(NODE << 5 | 0x01, struct.pack("<IB3x", error, state))


def estimates(position_rev: float, velocity: float = 0.5) -> Frame:
    return Frame(NODE << 5 | 0x09, struct.pack("<ff", position_rev, velocity))


def iq(measured_A: float) -> Frame:
    return Frame(NODE << 5 | 0x14, struct.pack("<ff", 0.0, measured_A))


def ready(config: ODriveConfig = CONFIG) -> ODrive:
    drive = ODrive(config)
    drive.connect(0)
    drive.receive(heartbeat(IDLE), -99 * MS)
    for frame in (heartbeat(IDLE), estimates(0.1), iq(0.0)):
        drive.receive(frame, MS)
    drive.poll(2 * MS)
    assert drive.phase is HostPhase.READY
    drive.take_samples()
    return drive


def running() -> ODrive:
    drive = ready()
    drive.enable()
    sent = ticks(drive, 2, FIRST_REFERENCES + 1)
    assert sent[-1].arbitration_id == NODE << 5 | 0x07
    drive.receive(heartbeat(CLOSED_LOOP), 9 * MS)
    assert drive.phase is HostPhase.RUNNING
    return drive


def ticks(drive: ODrive, first_ms: int, count: int, raw: int = 1000) -> list[Frame]:
    """What goes out in some ticks, as the service asks for it: the reference, then what is due."""
    sent: list[Frame] = []
    for n in range(count):
        reference = drive.setpoint(raw + n)
        sent += [] if reference is None else [reference]
        sent += drive.poll((first_ms + n) * MS)
    return sent


def commands(frames: Iterable[Frame]) -> list[int]:
    return [frame.arbitration_id & 0x1F for frame in frames]


def test_nothing_is_sent_before_the_drive_is_known() -> None:
    drive = ODrive(CONFIG)
    drive.connect(0)
    assert ticks(drive, 0, 50) == []
    drive.receive(heartbeat(IDLE), 50 * MS)
    assert ticks(drive, 51, 50) == []
    assert drive.phase is HostPhase.IDENTIFYING


def test_an_odrive_that_sends_no_current_is_refused_with_the_remedy() -> None:
    drive = ODrive(CONFIG)
    drive.connect(0)
    for n in range(1200):
        drive.receive(estimates(0.1), n * MS)
        if n % 100 == 0:
            drive.receive(heartbeat(IDLE), n * MS)
        drive.poll(n * MS)
    assert drive.phase is HostPhase.REFUSED
    assert "no Iq" in drive.refusal
    assert "iq_msg_rate_ms" in drive.refusal
    assert drive.counters["samples"] == 0


def position_of(frame: Frame) -> float:
    return float(struct.unpack_from("<f", frame.data)[0]) * 2**24


def test_the_measured_angle_goes_out_before_closed_loop_is_asked_for() -> None:
    drive = ready()
    drive.enable()
    sent = ticks(drive, 2, FIRST_REFERENCES + 1)
    # Mode and limits with each of the first references: one frame may be lost.
    assert commands(sent) == [0x0B, 0x0F, *[0x0C, 0x0B, 0x0F] * (FIRST_REFERENCES - 1), 0x0C, 0x07]
    references = [frame for frame in sent if frame.arbitration_id & 0x1F == 0x0C]
    assert [round(position_of(frame)) for frame in references] == [1001, 1002, 1003]
    # Then the angle at the request, so that a load can't push the jaw away while the heartbeat is waited for.
    held = ticks(drive, 10, 50)
    assert commands(held) == [0x0C] * 50
    assert {frame.data for frame in held} == {references[-1].data}


def test_closed_loop_is_asked_for_again_where_a_heartbeat_says_no_and_from_where_the_motor_is_then() -> None:
    drive = ready()
    drive.enable()
    assert commands(ticks(drive, 2, 4))[-1] == 0x07
    drive.receive(heartbeat(IDLE), 6 * MS)  # made before the request
    assert commands(ticks(drive, 7, 90)) == [0x0C] * 90
    drive.receive(heartbeat(IDLE), 106 * MS)
    sent = ticks(drive, 107, 2, raw=5000)
    assert commands(sent) == [0x0C, 0x07, 0x0C]
    assert [round(position_of(sent[place])) for place in (0, 2)] == [5000, 5000]
    drive.receive(heartbeat(CLOSED_LOOP), 206 * MS)
    assert drive.phase is HostPhase.RUNNING
    assert commands(ticks(drive, 207, 160)) == [0x0C] * 160


def test_closed_loop_is_not_asked_for_without_a_fresh_reference() -> None:
    drive = ready()
    drive.enable()
    assert commands(ticks(drive, 2, FIRST_REFERENCES)) == [0x0B, 0x0F, *[0x0C, 0x0B, 0x0F] * (FIRST_REFERENCES - 1)]
    for n in range(10, 300):  # the gate passes nothing any more
        assert drive.poll(n * MS) == []
        if n % 100 == 0:
            drive.receive(heartbeat(IDLE), n * MS)
    assert commands(ticks(drive, 300, 1)) == [0x0C, 0x07]


def test_an_axis_with_torque_by_anothers_word_is_asked_for_idle_before_its_settings_change() -> None:
    drive = ready()
    drive.receive(heartbeat(CLOSED_LOOP), 2 * MS)
    drive.enable()
    assert commands(ticks(drive, 3, 101)) == [0x07] * 3
    drive.receive(heartbeat(IDLE), 104 * MS)
    assert commands(ticks(drive, 105, 2)) == [0x0B, 0x0F, 0x0C, 0x0B, 0x0F]


def test_nothing_but_references_feeds_the_watchdog_of_a_running_drive() -> None:
    drive = running()
    for n in range(10, 300):
        drive.receive(estimates(0.1), n * MS)
        drive.receive(iq(0.1), n * MS)
        if n % 100 == 0:
            drive.receive(heartbeat(CLOSED_LOOP), n * MS)
        assert drive.poll(n * MS) == []


def test_a_sample_has_the_current_of_its_own_tick() -> None:
    drive = running()
    drive.receive(estimates(0.25), 10 * MS)
    assert drive.take_samples() == []
    drive.receive(iq(0.5), 10 * MS + 100_000)
    (sample,) = drive.take_samples()
    assert sample.theta_m * ANGLE_LSB_RAD == pytest.approx(0.5 * math.pi)
    assert sample.current * CURRENT_LSB_A == pytest.approx(0.5)
    assert sample.stamp_ns == sample.received_ns == 10 * MS
    assert sample.state == DriveState.OPERATIONAL


def test_a_lost_current_is_bridged_once_and_then_missed() -> None:
    drive = running()
    drive.receive(iq(0.5), 9 * MS)
    for n in range(10, 20):
        drive.receive(estimates(0.25 + n * 1e-6), n * MS)
    samples = drive.take_samples()
    assert [sample.stamp_ns // MS for sample in samples] == [10, 11]
    assert drive.counters["without_current"] == 7


@pytest.mark.parametrize("ratio", [1.0, -1.0, 7.5, -0.5])
def test_gear_sign_and_zero_are_those_of_the_rig(ratio: float) -> None:
    drive = ready(CONFIG._replace(rev_per_pulley_rev=ratio, zero_rev=0.3))
    drive.enable()
    frame = next(frame for frame in ticks(drive, 2, 2, raw=1 << 22) if frame.arbitration_id & 0x1F == 0x0C)
    position = struct.unpack_from("<f", frame.data)[0]
    assert position == pytest.approx(0.3 + 0.25 * ratio, abs=1e-6)
    drive.receive(estimates(position), 20 * MS)
    drive.receive(iq(0.2), 20 * MS)
    sample = drive.take_samples()[-1]
    assert sample.theta_m == pytest.approx(1 << 22, abs=20)
    assert sample.current * CURRENT_LSB_A == pytest.approx(math.copysign(0.2, ratio), abs=1e-4)


def test_zero_for_an_invalid_estimate_is_no_angle() -> None:
    drive = running()
    drive.receive(estimates(0.0, 0.0), 10 * MS)
    drive.receive(iq(0.1), 10 * MS)
    assert drive.take_samples() == []
    assert drive.counters["no_estimate"] == 1


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


def test_an_angle_that_no_recording_holds_is_counted() -> None:
    drive = running()
    drive.receive(estimates(3e38), 10 * MS)
    drive.receive(iq(0.1), 10 * MS)
    assert drive.take_samples() == []
    assert drive.counters["out_of_range"] == 1


def test_a_current_from_much_later_belongs_to_no_sample() -> None:
    drive = running()
    drive.receive(estimates(0.25), 10 * MS)
    drive.receive(iq(0.5), 410 * MS)
    assert drive.take_samples() == []


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


def test_an_error_in_closed_loop_is_no_end_of_torque() -> None:
    drive = running()
    drive.receive(heartbeat(CLOSED_LOOP, error=0x100), 20 * MS)
    assert drive.phase is HostPhase.FAULT
    assert drive.drive_state is DriveState.ARMED
    drive.disable()
    assert commands(drive.poll(21 * MS)) == [0x07]


def test_closed_loop_by_somebody_elses_word_is_no_start() -> None:
    drive = ready()
    drive.enable()
    ticks(drive, 2, 1)
    drive.receive(heartbeat(CLOSED_LOOP), 3 * MS)
    assert drive.phase is HostPhase.ENABLING
    (frame,) = ticks(drive, 4, 1)
    assert frame == Frame(NODE << 5 | 0x07, struct.pack("<I4x", IDLE))


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
