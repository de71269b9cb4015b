"""The Dynamixel profile's torque: asked for, refused, taken away, and no longer claimed before that was read."""

import pytest

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV
from firmware_protocol.states import HostPhase
from hil_forceps.drives.dynamixel.enabling import FIRST_REFERENCES
from tests.unit.drives.dynamixel.bench import MS, NODE, READ, SYNC_WRITE, WRITE, Bench, ready, running, written


def state(bench: Bench) -> DriveState | None:
    return bench.drive.drive_state


def test_no_current_before_the_goal_is_the_measured_angle_under_torque() -> None:
    bench = ready()
    before = len(bench.sent)
    bench.drive.enable()
    seen: list[tuple[int, int]] = []  # torque, goal current at each goal position that arrives

    def watch(frame: Frame) -> list[Frame]:
        if frame.data[0] == SYNC_WRITE:
            seen.append((bench.get(64), bench.get(102)))
        return [frame]

    bench.to_servo = watch
    bench.until(HostPhase.RUNNING)
    assert seen == [(0, 0)] * FIRST_REFERENCES + [(1, 0)] * FIRST_REFERENCES
    goals = {frame.data[-4:] for frame in bench.sent[before:] if frame.data[0] == SYNC_WRITE}
    assert len(goals) == 1  # the angle when it began
    assert written(bench.sent[before:], 64) == [1]
    assert written(bench.sent[before:], 102) == [0, 372]  # 1 A in units of 2.69 mA
    bench.tick(3)
    assert bench.drive.drive_state is DriveState.OPERATIONAL
    assert bench.samples[-1].state == DriveState.OPERATIONAL


@pytest.mark.parametrize("goal_follows", [True, False])
def test_enabling_moves_nothing_whatever_the_servo_makes_of_its_goal(goal_follows: bool) -> None:
    bench = ready(goal_follows=goal_follows)
    bench.servo.table.put(116, 3000)  # of before
    start = bench.samples[-1].theta_m
    bench.drive.enable()
    bench.until(HostPhase.RUNNING)
    bench.tick(50, raw=start)
    assert max(abs(sample.theta_m - start) for sample in bench.samples) <= ANGLE_LSB_PER_REV // 4096


def test_torque_is_asked_for_again_where_the_servo_does_not_have_it() -> None:
    bench = ready()
    bench.drive.enable()
    lost = [2]

    def forget(frame: Frame) -> list[Frame]:
        if frame.data == bytes((0x55, 0)) and bench.get(64) and lost[0]:
            lost[0] -= 1
            bench.servo.table.put(64, 0)
        return [frame]

    bench.to_host = forget
    bench.until(HostPhase.RUNNING)
    assert written(bench.sent, 64) == [0, 1, 1, 1]


def test_torque_that_somebody_took_away_ends_the_run() -> None:
    bench = running()
    bench.servo.table.put(64, 0)
    bench.tick(2)
    assert bench.drive.phase is HostPhase.READY
    assert bench.drive.drive_state is DriveState.DISABLED


def test_no_torque_is_asked_for_until_it_is_read() -> None:
    bench = running()
    held = [3]

    def stubborn(frame: Frame) -> list[Frame]:
        if frame.data[:3] == bytes((WRITE, 64, 0)) and held[0]:
            held[0] -= 1
            bench.drive.receive(Frame(NODE, b"\x55\x00"), bench.now_ns)  # taken, it says
            return []
        return [frame]

    bench.to_servo = stubborn
    bench.drive.disable()
    assert state(bench) is None
    bench.tick(2)
    assert state(bench) not in {DriveState.DISABLED, DriveState.FAULT}
    bench.tick(20)
    assert state(bench) is DriveState.DISABLED
    assert held == [0]
    assert bench.get(64) == 0


def test_disabling_while_torque_is_asked_for_ends_without() -> None:
    for ticks in range(1, 14):
        bench = ready()
        bench.drive.enable()
        bench.tick(ticks)
        first = len(bench.sent)
        bench.drive.disable()
        bench.tick(10)
        assert (bench.get(64), bench.drive.drive_state) == (0, DriveState.DISABLED), ticks
        assert [frame for frame in bench.sent[first:] if frame.data[:3] == bytes((READ, 64, 0))], ticks


def test_the_servo_refuses_torque() -> None:
    bench = ready()
    bench.drive.enable()
    bench.to_servo = lambda frame: [frame]
    bench.servo._is_shut_down = True
    bench.until(HostPhase.REFUSED)
    assert bench.drive.refusal == "servo 5 refuses Torque Enable (64) = 1: result fail"


def test_the_emergency_stop_is_an_order_that_is_not_answered() -> None:
    bench = running()
    bench.servo.wake(bench.now_ns + MS)
    bench.servo.take_outbox()
    bench.servo.receive(bench.drive.estop_frame(), bench.now_ns + MS)
    assert bench.get(64) == 0
    assert bench.servo._answers == bench.servo._answers.__class__()
