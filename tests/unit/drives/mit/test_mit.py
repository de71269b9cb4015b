"""The mini cheetah profile: who sends what when, what it makes of answers, what it claims without a drive's word."""

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV, CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from hil_forceps.drives.mit import messages as wire
from hil_forceps.drives.mit.exchange import FLIGHT_NS, MAX_IN_FLIGHT
from hil_forceps.drives.mit.machine import FIRST_REFERENCES, RESTART_NS, TRANSITIONS, Mit, MitConfig
from hil_forceps.drives.mit.messages import Codes, Ranges, Special

NODE, MS = 5, 1_000_000
RANGES = Ranges(12.5, 50.0, 500.0, 5.0, 18.0)
CONFIG = MitConfig(NODE, 0, "bgkatz", RANGES, 20.0, 10.0, 1.0, 1.0, 0.0, MS, 3 * MS)
DAMIAO = CONFIG._replace(variant="damiao", reply_id=0x15)
CUBEMARS = CONFIG._replace(variant="cubemars", reply_id=NODE)
POSITION = 40_000
DISABLED, ENABLED, OVER_CURRENT = 0x0, 0x1, 0xA
EXIT, ENTER = wire.special(NODE, Special.EXIT), wire.special(NODE, Special.ENTER)
Answers = Callable[[Frame], Frame | None]


def answer(position: int = POSITION, torque: int = 2047, extra: bytes = b"\xff", reply_id: int = 0) -> Frame:
    packed = position << 24 | 2047 << 12 | torque
    return Frame(reply_id, bytes((NODE,)) + packed.to_bytes(5, "big") + extra)


def damiao(status: int, position: int = POSITION) -> Frame:
    return Frame(0x15, bytes((status << 4 | NODE,)) + answer(position).data[1:6] + bytes((25, 25)))


class Motor:
    """A DaMiao: enters, leaves, and says so; the answer is of before the order."""

    def __init__(self) -> None:
        self.status = DISABLED

    def __call__(self, frame: Frame) -> Frame | None:
        reply = damiao(self.status)
        special = wire.special_of(frame.data)
        if special is Special.CLEAR_ERRORS or (special is Special.EXIT and self.status == ENABLED):
            self.status = DISABLED
        elif special is Special.ENTER and self.status == DISABLED:
            self.status = ENABLED
        return reply


def ticks(
    drive: Mit, first_ms: int, count: int, raw: int | None = 0, answers: Answers = lambda _: answer()
) -> list[list[Frame]]:
    """What goes out in some ticks, as the service asks for it; each frame is answered half a tick later."""
    sent = []
    for now_ms in range(first_ms, first_ms + count):
        reference = None if raw is None else drive.setpoint(raw)
        frames = [] if reference is None else [reference]
        frames += drive.poll(now_ms * MS)
        sent.append(frames)
        for frame in frames:
            reply = answers(frame)
            if reply is not None:
                drive.receive(reply, now_ms * MS + MS // 2)
    return sent


def ready(config: MitConfig = CONFIG, answers: Answers = lambda _: answer()) -> Mit:
    drive = Mit(config)
    drive.connect(0)
    ticks(drive, 1, 15, answers=answers)
    assert drive.phase is HostPhase.READY
    return drive


def running(config: MitConfig = CONFIG, answers: Answers = lambda _: answer()) -> Mit:
    """At 56 ms."""
    drive = ready(config, answers)
    drive.enable()
    ticks(drive, 16, 40, answers=answers)
    assert drive.phase is HostPhase.RUNNING
    drive.take_samples()
    return drive


def codes(frame: Frame) -> Codes:
    found = wire.parse_command(frame.data)
    assert found is not None
    return found


def nobody(_: Frame) -> None:
    return None


def test_before_it_is_enabled_it_is_asked_by_exit_alone() -> None:
    drive = Mit(CONFIG)
    assert ticks(drive, 0, 3) == [[], [], []]
    drive.connect(3 * MS)
    sent = ticks(drive, 4, 30)
    assert sent == [[EXIT]] * 30
    assert drive.phase is HostPhase.READY
    assert drive.drive_state is DriveState.DISABLED


def test_a_silent_drive_is_asked_on_and_on_and_never_ready() -> None:
    drive = Mit(CONFIG)
    drive.connect(0)
    assert ticks(drive, 1, 1000, answers=nobody) == [[EXIT]] * 1000
    assert drive.phase is HostPhase.IDENTIFYING
    assert drive.drive_state is None


def test_it_enters_without_gains_at_the_measured_angle_and_gains_begin_where_it_is_then() -> None:
    drive = ready()
    drive.enable()
    sent = ticks(drive, 16, 30, raw=1000)
    entering = [frames for frames in sent if ENTER in frames]
    assert entering == sent[: len(entering)]
    for command, enter in entering:
        assert enter == ENTER
        assert codes(command)[2:4] == (0, 0)
        assert abs(codes(command).position - POSITION) <= 1
    held = wire.code_of(2.0 * math.pi * 1000 / ANGLE_LSB_PER_REV, -12.5, 12.5, wire.POSITION_CODES)
    first = [frames[0] for frames in sent[len(entering) : len(entering) + FIRST_REFERENCES]]
    assert {codes(frame).position for frame in first} == {held}
    assert {codes(frame)[2:4] for frame in first} == {(82, 819)}  # 10 of 500 and 1 of 5
    assert drive.phase.name == "RUNNING"
    assert drive.drive_state is DriveState.OPERATIONAL


def test_while_enabling_the_reference_stays_where_it_was() -> None:
    drive = ready()
    drive.enable()
    positions = []
    for n in range(40):
        sent = ticks(drive, 16 + n, 1, raw=1000 * n)
        if drive.phase is HostPhase.ENABLING and ENTER not in sent[0]:
            positions.append(codes(sent[0][0]).position)
    assert len(positions) == FIRST_REFERENCES - 1
    assert len(set(positions)) == 1


def test_while_it_runs_a_tick_sends_its_reference_and_nothing_else() -> None:
    drive = running()
    sent = [ticks(drive, 56 + n, 1, raw=10_000 * n)[0] for n in range(20)]
    assert [len(frames) for frames in sent] == [1] * 20
    assert len({codes(frame).position for (frame,) in sent}) == 20
    assert {codes(frame)[1:] for (frame,) in sent} == {(2048, 82, 819, 2047)}


def test_a_lost_answer_repeats_the_reference_until_it_is_too_old_and_then_lets_go() -> None:
    drive = running()
    ((reference,),) = ticks(drive, 56, 1, raw=7777, answers=nobody)
    sent = ticks(drive, 57, 6, raw=None, answers=nobody)
    assert sent[:3] == [[reference]] * 3
    for (frame,) in sent[3:]:
        assert codes(frame)[1:] == (2048, 0, 819, 2047)  # damps, and pulls nowhere
    assert (drive.counters["repeats"], drive.counters["releases"]) == (3, 3)


def test_an_answer_brings_a_lost_exchange_back() -> None:
    drive = running()
    ticks(drive, 56, 1, raw=7777, answers=nobody)
    ticks(drive, 57, 1, raw=None)
    assert len(drive.take_samples()) == 1
    assert codes(ticks(drive, 58, 1, raw=8888)[0][0]).kp == 82


def test_where_the_answer_came_and_no_reference_follows_nothing_pulls() -> None:
    drive = running()
    for (frame,) in ticks(drive, 56, 20, raw=None):
        assert codes(frame).kp == 0
    assert drive.counters["repeats"] == 0
    assert len(drive.take_samples()) == 20  # the service goes on to see


def test_silence_longer_than_a_restart_is_the_end() -> None:
    drive = running()
    ticks(drive, 56, RESTART_NS // MS + 2, answers=nobody)
    assert drive.phase is HostPhase.DISCONNECTED
    assert drive.drive_state is None
    assert drive.setpoint(0) is None
    drive.disable()
    assert ticks(drive, 80, 5, answers=nobody) == [[EXIT]] * 5


def test_a_host_that_was_late_is_no_silence() -> None:
    drive = running()
    ticks(drive, 56 + 500, 1)
    assert drive.phase.name == "RUNNING"


def test_no_torque_is_claimed_only_behind_an_answer_that_can_be_to_nothing_but_exit() -> None:
    drive = running()
    ticks(drive, 56, 1, answers=nobody)
    drive.disable()
    assert drive.drive_state is DriveState.ARMED
    silent = ticks(drive, 57, 30, answers=nobody)
    assert silent == [[EXIT]] * 30
    assert drive.drive_state is DriveState.ARMED  # nobody said anything
    drive.receive(answer(), 86 * MS)
    assert drive.drive_state is DriveState.ARMED  # to the command at 56 ms, if that was held up
    drive.receive(answer(), 87 * MS)
    assert drive.drive_state.name == "DISABLED"


def test_answers_to_commands_that_were_held_up_are_none_to_exit_however_late_they_come() -> None:
    drive = running()
    asked = sum(len(frames) for frames in ticks(drive, 56, 5, answers=nobody))
    drive.disable()
    ticks(drive, 61, 30, answers=nobody)
    for n in range(asked):
        drive.receive(answer(), (91 + n) * MS)
        assert drive.drive_state is DriveState.ARMED
        ticks(drive, 91 + n, 1, answers=nobody)
    drive.receive(answer(), 99 * MS)
    assert getattr(drive.drive_state, "name", "") == "DISABLED"  # it was ARMED a moment ago, says the type checker


def test_an_answer_that_was_on_its_way_is_none_to_exit() -> None:
    drive = running()
    drive.disable()
    states = []
    for n in range(20):
        ticks(drive, 56 + n, 1)
        states.append(drive.drive_state)
    assert states.index(DriveState.DISABLED) == FLIGHT_NS // MS


def test_a_damiao_is_off_when_it_says_so() -> None:
    motor = Motor()
    drive = running(DAMIAO, motor)
    drive.disable()
    ticks(drive, 56, 50, answers=lambda _: damiao(ENABLED))  # deaf to exit
    assert drive.drive_state is DriveState.ARMED
    assert ticks(drive, 106, 2, answers=motor) == [[EXIT]] * 2
    assert drive.drive_state.name == "DISABLED"


def test_a_damiao_that_does_not_enter_gets_no_gains() -> None:
    drive = ready(DAMIAO, lambda _: damiao(DISABLED))
    drive.enable()
    sent = ticks(drive, 16, 200, answers=lambda frame: damiao(DISABLED) if frame == ENTER else None)
    assert all(ENTER in frames for frames in sent)
    assert drive.phase is HostPhase.ENABLING


def test_a_damiao_that_leaves_ends_the_run() -> None:
    drive = running(DAMIAO, Motor())
    ticks(drive, 56, 1, answers=lambda _: damiao(DISABLED))
    assert drive.phase is HostPhase.READY
    assert drive.drive_state is DriveState.DISABLED


def test_a_fault_of_a_damiao_is_told_and_cleared_once() -> None:
    motor = Motor()
    drive = running(DAMIAO, motor)
    motor.status = OVER_CURRENT
    ticks(drive, 56, 1, answers=motor)
    assert drive.phase is HostPhase.FAULT
    assert drive.drive_state is DriveState.ARMED  # a fault is no word on torque yet
    assert drive.fault_words() == "error Ah (over current)"
    assert ticks(drive, 57, 15, answers=motor) == [[EXIT]] * 15
    assert drive.drive_state.name == "FAULT"
    drive.reset_fault()
    sent = ticks(drive, 72, 30, answers=motor)
    assert [frames[0].data[7] for frames in sent].count(Special.CLEAR_ERRORS) == 1
    assert drive.phase.name == "READY"


def test_an_error_byte_of_a_cubemars_is_a_fault_and_a_shorter_answer_has_none() -> None:
    for extra, phase in ((bytes((40, 2)), "FAULT"), (b"", "RUNNING"), (bytes((40, 0)), "RUNNING")):
        good = bytes((40, 0))
        drive = running(CUBEMARS, lambda _, extra=good: answer(extra=extra, reply_id=NODE))  # type: ignore[misc]
        ticks(drive, 56, 1, answers=lambda _, extra=extra: answer(extra=extra, reply_id=NODE))  # type: ignore[misc]
        assert drive.phase.name == phase
    assert Mit(CUBEMARS).fault_words() == "no error given"


def test_only_a_damiaos_errors_can_be_cleared() -> None:
    drive = running(CUBEMARS, lambda _: answer(extra=bytes((40, 0)), reply_id=NODE))
    ticks(drive, 56, 1, answers=lambda _: answer(extra=bytes((40, 1)), reply_id=NODE))
    drive.reset_fault()
    assert ticks(drive, 57, 3, answers=nobody) == [[EXIT]] * 3


@pytest.mark.parametrize("code", [0, wire.POSITION_CODES])
def test_an_angle_at_the_end_of_its_field_is_none(code: int) -> None:
    drive = running()
    ticks(drive, 56, 1, answers=lambda _: answer(code))
    assert drive.take_samples() == []
    assert drive.counters["at_range_end"] == 1
    fresh = Mit(CONFIG)
    fresh.connect(0)
    ticks(fresh, 1, 600, answers=lambda _: answer(code))
    assert "end of motor_driver.position_range_rad" in fresh.refusal


def test_an_angle_that_wrapped_is_dropped_and_nothing_pulls_towards_it() -> None:
    drive = running()
    sent = ticks(drive, 56, 10, raw=None, answers=lambda _: answer(POSITION - 33_000))
    assert drive.counters["wrapped"] == 10
    assert drive.take_samples() == []
    assert {codes(frame).kp for (frame,) in sent} == {0}


def test_a_reference_beyond_the_field_is_refused_and_not_wrapped() -> None:
    drive = running()
    beyond = math.ceil(12.6 / 2.0 / math.pi * ANGLE_LSB_PER_REV)
    assert drive.setpoint(beyond) is None
    assert drive.setpoint(-beyond) is None
    assert drive.counters["beyond_range"] == 2


def test_two_drives_with_one_id_are_refused() -> None:
    drive = Mit(CONFIG)
    drive.connect(0)
    for n in range(10):
        drive.poll(n * MS)
        for position in (POSITION, 20_000):
            drive.receive(answer(position), n * MS + MS // 2)
    assert drive.phase is HostPhase.REFUSED
    assert "two drives have this id" in drive.refusal
    assert drive.poll(11 * MS) == []


def test_answers_that_nobody_asked_for_are_no_samples() -> None:
    drive = running()
    for n in range(MAX_IN_FLIGHT + 5):
        drive.receive(answer(), 56 * MS + n)
    assert drive.take_samples() == []
    assert drive.counters["unasked"] == MAX_IN_FLIGHT + 5


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (answer(reply_id=0x15), "answers come under the id 015h, not 000h; set motor_driver.reply_id"),
        (Frame(0, bytes((NODE, 1, 2))), "answers have 3 bytes"),
    ],
)
def test_what_comes_instead_of_answers_is_told_with_the_remedy(frame: Frame, said: str) -> None:
    drive = Mit(CONFIG)
    drive.connect(0)
    ticks(drive, 1, 600, answers=lambda _: frame)
    assert drive.phase is HostPhase.REFUSED
    assert said in drive.refusal


def test_a_damiaos_answer_has_eight_bytes() -> None:
    drive = Mit(DAMIAO)
    drive.connect(0)
    ticks(drive, 1, 600, answers=lambda _: answer(reply_id=0x15))
    assert drive.counters["bad_length"] == 500  # then nothing is asked any more
    assert drive.phase is HostPhase.REFUSED


def test_answers_of_other_motors_under_the_same_id_are_not_ours() -> None:
    drive = running()
    ticks(drive, 56, 3, answers=lambda _: Frame(0, bytes((NODE + 1,)) + answer().data[1:]))
    assert drive.counters["not_for_us"] == 3
    assert drive.take_samples() == []


@pytest.mark.parametrize("ratio", [1.0, -1.0, 7.5, -0.5])
def test_gear_sign_and_zero_are_those_of_the_rig(ratio: float) -> None:
    config = CONFIG._replace(rev_per_pulley_rev=ratio, zero_rev=0.3, current_range_A=math.copysign(20.0, ratio))
    drive = running(config)
    raw = 1 << 20
    sent = codes(ticks(drive, 56, 1, raw=raw)[0][0])
    asked_rad = wire.value_of(sent.position, -12.5, 12.5, wire.POSITION_CODES)
    assert asked_rad == pytest.approx(2.0 * math.pi * (0.3 + ratio / 16.0), abs=12.5 / wire.POSITION_CODES)
    (sample,) = drive.take_samples()
    measured_rad = (POSITION + 0.5) * 25.0 / wire.POSITION_CODES - 12.5
    assert sample.theta_m / ANGLE_LSB_PER_REV == pytest.approx((measured_rad / 2.0 / math.pi - 0.3) / ratio, abs=1e-6)
    ticks(drive, 57, 1, answers=lambda _: answer(torque=3071))
    current_A = drive.take_samples()[-1].current * CURRENT_LSB_A
    assert current_A == pytest.approx(math.copysign(20.0 * (2.0 * 3071.5 / 4095.0 - 1.0), ratio), abs=2e-4)


def test_a_measured_zero_is_zero() -> None:
    """Drives cut off: they send 2047 of 4095 for it."""
    drive = running()
    ticks(drive, 56, 1)
    assert drive.take_samples()[-1].current == 0


def test_a_sample_is_stamped_half_way_between_question_and_answer() -> None:
    drive = running()
    ticks(drive, 56, 2)
    stamps = [(sample.stamp_ns, sample.received_ns) for sample in drive.take_samples()]
    assert stamps == [(56 * MS + MS // 4, 56 * MS + MS // 2), (57 * MS + MS // 4, 57 * MS + MS // 2)]


@pytest.mark.parametrize("call", ["enable", "reset_fault"])
def test_calls_at_the_wrong_time_raise(call: str) -> None:
    with pytest.raises(ValueError, match=r"can't be enabled|no fault"):
        getattr(Mit(CONFIG), call)()


@pytest.mark.parametrize(
    "change",
    [
        {"node": 0},
        {"node": 127},
        {"reply_id": 0x800},
        {"rev_per_pulley_rev": 0.0},
        {"ranges": RANGES._replace(torque_N_m=0.0)},
        {"kp_N_m_per_rad": 501.0},
        {"kd_N_m_s_per_rad": -0.1},
    ],
)
def test_what_is_no_mini_cheetah_drive(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"no mini cheetah|is beyond"):
        Mit(CONFIG._replace(**change))


def test_every_phase_but_the_first_can_be_left() -> None:
    for phase in set(HostPhase) - {HostPhase.DISCONNECTED}:
        assert any(source is phase for source, _ in TRANSITIONS)


@pytest.mark.parametrize("config", [CONFIG, DAMIAO, CUBEMARS])
@given(
    frames=st.lists(
        st.tuples(
            st.one_of(st.integers(0, 0x7FF), st.sampled_from((0, NODE, 0x15))),
            st.one_of(st.binary(max_size=8), st.binary(min_size=7, max_size=7).map(lambda data: bytes((NODE,)) + data)),
            st.integers(-5, 20 * MS),
        ),
        max_size=40,
    )
)
def test_whatever_comes_nothing_raises_and_nothing_but_exit_is_sent_unasked(
    config: MitConfig, frames: list[tuple[int, bytes, int]]
) -> None:
    drive = Mit(config)
    drive.connect(0)
    now_ns = 10 * MS
    for arbitration_id, data, step_ns in frames:
        now_ns += step_ns
        assert all(frame == EXIT for frame in drive.poll(now_ns))
        drive.receive(Frame(arbitration_id, data), now_ns)
        assert drive.setpoint(0) is None
    stamps = [sample.stamp_ns for sample in drive.take_samples()]
    assert stamps == sorted(set(stamps))


@given(st.lists(st.tuples(st.binary(max_size=8), st.booleans()), min_size=1, max_size=40))
def test_whatever_is_answered_while_it_runs_nothing_raises(answers: list[tuple[bytes, bool]]) -> None:
    drive = running()
    for n, (data, has_reference) in enumerate(answers):
        ticks(drive, 56 + n, 1, raw=n if has_reference else None, answers=lambda _, data=data: Frame(0, data))  # type: ignore[misc]
    assert len(drive.take_samples()) <= 2 * len(answers)
