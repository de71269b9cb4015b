"""The mini cheetah profile's faults, two drives with one id, and answers that are none; nothing from outside raises."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.states import HostPhase
from hil_forceps.drives.mit.exchange import MAX_FRAMES_IN_FLIGHT
from hil_forceps.drives.mit.machine import TRANSITIONS, Mit, MitConfig
from hil_forceps.drives.mit.messages import Special
from tests.unit.drives.mit.bench import (
    CONFIG,
    DAMIAO,
    DISABLED,
    EXIT,
    MS,
    NODE,
    OVER_CURRENT,
    POSITION,
    RANGES,
    Motor,
    answer,
    damiao,
    nobody,
    running,
    ticks,
)

CUBEMARS = CONFIG._replace(variant="cubemars", reply_id=NODE)


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
    assert Mit(CUBEMARS).fault_words() == "no error reported"


def test_only_a_damiaos_errors_can_be_cleared() -> None:
    drive = running(CUBEMARS, lambda _: answer(extra=bytes((40, 0)), reply_id=NODE))
    ticks(drive, 56, 1, answers=lambda _: answer(extra=bytes((40, 1)), reply_id=NODE))
    drive.reset_fault()
    assert ticks(drive, 57, 3, answers=nobody) == [[EXIT]] * 3


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
    for n in range(MAX_FRAMES_IN_FLIGHT + 5):
        drive.receive(answer(), 56 * MS + n)
    assert drive.take_samples() == []
    assert drive.counters["unasked"] == MAX_FRAMES_IN_FLIGHT + 5


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (answer(reply_id=0x15), "answers have the id 015h, not 000h; set motor_driver.reply_id"),
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
