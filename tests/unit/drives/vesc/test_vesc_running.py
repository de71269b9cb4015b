"""The VESC profile's references: the first is the measured angle; what feeds the timeout, and how torque ends."""

import pytest

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV
from firmware_protocol.states import HostPhase
from tests.unit.drives.vesc.bench import MS, SET_CURRENT, SET_POS, Bench, answer, command, position_deg


def test_the_first_reference_is_the_measured_angle_and_stays_until_it_is_taken() -> None:
    bench = Bench().ready()
    bench.drive.enable()
    frames: list[Frame] = []
    states = []
    for n in range(7):
        bench.raw = round(0.1 * ANGLE_LSB_PER_REV) + 1000 * n  # a load pushes the motor away
        frames += bench.tick()
        states.append(bench.drive.drive_state)
    enabling = states.count(DriveState.ARMED) + 1
    assert enabling >= 3
    assert len({frame.data for frame in frames[:enabling]}) == 1
    assert position_deg(frames[0]) == pytest.approx(36.0, abs=1e-4)
    assert bench.drive.phase.name == "RUNNING"
    assert position_deg(frames[-1]) == pytest.approx(36.0 + 6000 / ANGLE_LSB_PER_REV * 360.0, abs=1e-4)
    assert states == [DriveState.ARMED] * (enabling - 1) + [DriveState.OPERATIONAL] * (8 - enabling)


def test_answers_that_say_timeout_do_not_count_as_taken() -> None:
    bench = Bench().ready()
    bench.says = lambda: answer(status=1)
    bench.drive.enable()
    bench.raw = round(0.1 * ANGLE_LSB_PER_REV)
    bench.tick(100)
    assert bench.drive.phase is HostPhase.ENABLING


def test_enabling_begins_anew_where_its_references_stayed_away() -> None:
    bench = Bench().ready()
    bench.drive.enable()
    bench.says = lambda: answer(status=1)
    bench.raw = 1_000_000
    assert [round(position_deg(frame), 4) for frame in bench.tick(3)] == [21.4577] * 3
    bench.raw = None
    bench.tick(60)
    bench.raw = 1_010_000  # where the motor is by now
    assert [round(position_deg(frame), 4) for frame in bench.tick(3)] == [21.6722] * 3


def test_torque_by_another_word_is_released_before_the_first_reference() -> None:
    bench = Bench().ready()
    bench.drive.enable()
    bench.says = lambda: answer(current=20, status=bench.has_timeout())
    bench.tick()
    bench.raw = 1_000_000
    assert [command(frame) for frame in bench.tick(40)] == [SET_CURRENT] * 2  # 50 ms apart
    bench.says = lambda: answer(status=bench.has_timeout())
    assert SET_POS in [command(frame) for frame in bench.tick(20)]


def test_nothing_but_references_feeds_the_timeout_of_a_running_drive() -> None:
    bench = Bench().running()
    assert {command(frame) for frame in bench.tick(100)} == {SET_POS}
    bench.raw = None
    assert bench.tick(40) == []


def test_references_that_stay_away_end_it_and_do_not_begin_again() -> None:
    bench = Bench().running()
    bench.raw = None
    bench.tick(60)
    assert bench.drive.phase is HostPhase.FAULT
    assert "timeout" in bench.drive.fault_words()
    bench.raw = 1_000_000  # a VESC would take it and go on
    assert bench.tick(50) == []


def test_a_host_that_stood_still_knows_it_by_its_own_clock() -> None:
    bench = Bench().running()
    bench.now_ms += 300
    bench.drive.poll(bench.now_ms * MS)
    assert bench.drive.phase is not HostPhase.RUNNING


def test_disabling_orders_the_release_until_answers_from_behind_it_have_no_current() -> None:
    bench = Bench().running()
    bench.says = lambda: answer(current=15, status=bench.has_timeout())
    bench.tick(2)
    bench.drive.disable()
    states = [bench.drive.drive_state]
    assert bench.drive.setpoint(0) is None
    sent = bench.tick(80)
    assert [command(frame) for frame in sent] == [SET_CURRENT] * 4
    bench.says = lambda: answer(status=bench.has_timeout())
    bench.tick(2)
    states.append(bench.drive.drive_state)  # two answers may be chance
    bench.tick()
    states.append(bench.drive.drive_state)
    assert states == [None, DriveState.ARMED, DriveState.DISABLED]
    assert bench.tick(100) == []


def test_answers_from_before_the_release_do_not_confirm_it() -> None:
    bench = Bench().running()  # its motor holds nothing: no current flows
    late = list(answer())  # to a request from before
    bench.drive.disable()
    states = []
    for _ in range(3):
        bench.hear(*late)
        bench.tick()
        states.append(bench.drive.drive_state)
    assert states == [None, None, DriveState.DISABLED]


@pytest.mark.parametrize("raw", [round(0.61 * ANGLE_LSB_PER_REV), round(-0.41 * ANGLE_LSB_PER_REV)])
def test_half_a_turn_away_the_vesc_would_go_the_other_way_round(raw: int) -> None:
    bench = Bench().running()
    bench.raw = raw
    assert bench.tick() == []
    assert bench.drive.phase is HostPhase.REFUSED
    assert "shorter way" in bench.drive.refusal
