"""The mini cheetah profile before and while it is enabled; what it claims without a drive's word."""

import math

from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV
from firmware_protocol.states import HostPhase
from hil_forceps.drives.mit import messages as wire
from hil_forceps.drives.mit.exchange import FLIGHT_NS
from hil_forceps.drives.mit.machine import FIRST_REFERENCES, Mit
from tests.unit.drives.mit.bench import (
    CONFIG,
    DAMIAO,
    DISABLED,
    ENABLED,
    ENTER,
    EXIT,
    MS,
    POSITION,
    Motor,
    answer,
    codes,
    damiao,
    nobody,
    ready,
    running,
    ticks,
)


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
    held = wire.code_of(2.0 * math.pi * 1000 / ANGLE_LSB_PER_REV, -12.5, 12.5, wire.MAX_POSITION_CODE)
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
