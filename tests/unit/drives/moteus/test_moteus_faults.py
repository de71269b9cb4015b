"""The moteus profile's faults, stops and restarts; nothing from outside raises."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.states import HostPhase
from hil_forceps.drives.moteus import messages as wire
from hil_forceps.drives.moteus.machine import FLIGHT_NS, TRANSITIONS, Moteus
from hil_forceps.drives.moteus.messages import Mode
from tests.unit.drives.moteus.bench import CONFIG, MS, NODE, Session, answer, commands


def test_what_limits_the_torque_is_no_fault() -> None:
    session = Session().running()
    session.tick(Mode.POSITION, fault=102)
    assert session.drive.phase.name == "RUNNING"


@pytest.mark.parametrize(
    ("mode", "fault", "words", "state"),
    [
        (Mode.FAULT, 33, "fault 33 (motor driver fault", DriveState.FAULT),
        (Mode.TIMEOUT, 0, "watchdog expired (mode 11)", DriveState.ARMED),
    ],
)
def test_fault_and_timeout_end_it_and_only_a_stop_clears_them(
    mode: Mode, fault: int, words: str, state: DriveState
) -> None:
    session = Session().running()
    session.tick(mode, fault=fault)
    drive = session.drive
    assert drive.phase.name == "FAULT"
    assert drive.fault_words().startswith(words)
    assert drive.drive_state is state
    assert drive.setpoint(0) is None
    assert commands(session.tick(mode, fault=fault)) == [-1]
    drive.reset_fault()
    assert commands(session.tick(mode, fault=fault)) == [Mode.STOPPED]
    session.tick(Mode.STOPPED)
    assert drive.phase.name == "IDENTIFYING"
    session.ms += 20
    session.tick(Mode.STOPPED)
    assert drive.phase.name == "READY"


def test_a_fault_has_no_torque_and_is_kept_for_who_comes_next() -> None:
    """A stop would clear it."""
    session = Session().running()
    session.tick(Mode.FAULT, fault=38)
    session.drive.disable()
    assert session.drive.drive_state is DriveState.FAULT
    assert all(commands(session.tick(Mode.FAULT, fault=38)) == [-1] for _ in range(30))


def test_a_timeout_may_have_torque_and_is_stopped() -> None:
    session = Session().running()
    session.tick(Mode.TIMEOUT)
    session.drive.disable()
    assert commands(session.tick(Mode.TIMEOUT)) == [Mode.STOPPED]
    session.tick(Mode.STOPPED)
    assert session.drive.drive_state is DriveState.DISABLED or session.drive.phase.name == "IDENTIFYING"


def test_stops_go_on_until_an_answer_from_behind_them_says_stopped() -> None:
    session = Session().ready()
    session.drive.enable()
    session.tick(Mode.STOPPED)  # a command is on its way, which the answer doesn't show yet
    session.drive.disable()
    assert session.drive.drive_state is None
    stops = 0
    while session.state() is not DriveState.DISABLED:
        assert commands(session.tick(Mode.STOPPED)) == [Mode.STOPPED]
        stops += 1
    assert stops * MS == FLIGHT_NS + MS
    assert commands(session.tick(Mode.STOPPED)) == [-1]


def test_stops_go_on_while_nobody_answers() -> None:
    session = Session().running()
    session.drive.disable()
    assert all(commands(session.tick(None)) == [Mode.STOPPED] for _ in range(300))
    assert session.drive.drive_state is None


def test_a_drive_that_loses_its_mode_is_out() -> None:
    session = Session().running()
    session.tick(Mode.STOPPED)
    assert session.drive.phase.name == "READY"
    assert session.drive.setpoint(0) is None
    assert session.drive.drive_state is DriveState.ARMED  # what went out with the last reference may yet enable it


def test_a_drive_whose_clock_began_anew_is_gone_even_in_position_mode() -> None:
    session = Session().running()
    session.ms += 1000
    session.drive.receive(answer(Mode.POSITION, session.ms), session.ms * MS)
    session.drive.receive(answer(Mode.POSITION, 3), (session.ms + 1) * MS)
    assert session.drive.phase.name == "DISCONNECTED"
    assert session.drive.counters["restarts"] == 1
    assert session.drive.setpoint(0) is None
    session.drive.disable()
    assert session.drive.drive_state is None
    assert commands(session.tick(None)) == [Mode.STOPPED]


def test_a_late_answer_says_nothing() -> None:
    session = Session().running()
    session.tick(Mode.POSITION)
    session.drive.take_samples()
    session.drive.receive(answer(Mode.STOPPED, session.ms - 10), session.ms * MS)
    assert session.drive.phase.name == "RUNNING"
    assert session.drive.take_samples() == []
    assert session.drive.counters["stale"] == 1


def test_the_clock_may_wrap() -> None:
    session = Session().running()
    for n, ms in enumerate((0x7FFFFFFE, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0, 5)):
        session.drive._feedback = None if n == 0 else session.drive._feedback
        session.drive.receive(answer(Mode.POSITION, ms), (session.ms + n) * MS)
    assert session.drive.phase.name == "RUNNING"
    assert session.drive.counters["restarts"] == 0


def test_silence_is_the_end_of_it() -> None:
    session = Session().running()
    for _ in range(102):
        session.tick(None)
    assert session.drive.phase.name == "DISCONNECTED"
    assert session.drive.drive_state is None


@pytest.mark.parametrize("call", ["enable", "reset_fault"])
def test_calls_at_the_wrong_time_are_a_mistake(call: str) -> None:
    with pytest.raises(ValueError, match=r"can't be enabled|no fault"):
        getattr(Moteus(CONFIG), call)()


@pytest.mark.parametrize(
    "change",
    [{"node": 0}, {"node": 127}, {"rev_per_pulley_rev": 0.0}, {"max_torque_N_m": math.nan}, {"watchdog_s": -1.0}],
)
def test_what_is_no_moteus(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"no moteus|no command"):
        Moteus(CONFIG._replace(**change))  # type: ignore[arg-type]


def test_every_phase_but_the_first_can_be_left() -> None:
    for phase in set(HostPhase) - {HostPhase.DISCONNECTED}:
        assert any(source is phase for source, _ in TRANSITIONS)


def test_the_emergency_frame_is_a_stop() -> None:
    assert Moteus(CONFIG).estop_frame() == wire.stop(NODE)
    assert Moteus(CONFIG).fault_words() == "no fault reported"
    assert Moteus(CONFIG).take_bench() == []


IDS = st.sampled_from([(NODE << 8, False), (NODE << 8, True), (0x8005, True), (0x100, False)])
ANSWERS = st.builds(
    lambda mode, ms, position, fault: answer(mode, ms, position, fault=fault).data,
    st.integers(-128, 127),
    st.integers(0, 2**32 - 1),
    st.floats(width=32),
    st.integers(-128, 127),
)


@given(st.lists(st.tuples(IDS, st.binary(max_size=64) | ANSWERS, st.integers(-5, 20 * MS)), max_size=40))
def test_whatever_comes_nothing_raises_and_no_torque_is_asked_for(
    frames: list[tuple[tuple[int, bool], bytes, int]],
) -> None:
    session = Session().ready()
    now_ns = session.ms * MS
    for (arbitration_id, is_extended), data, step_ns in frames:
        now_ns += step_ns
        session.drive.receive(Frame(arbitration_id, data, True, is_extended), now_ns)
        assert session.drive.setpoint(0) is None
        assert set(commands(session.drive.poll(now_ns))) <= {-1}
    stamps = [sample.stamp_ns for sample in session.drive.take_samples()]
    assert stamps == sorted(set(stamps))
