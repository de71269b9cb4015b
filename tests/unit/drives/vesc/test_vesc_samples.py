"""The VESC profile's samples: angle and current of one answer, turns counted, gear and sign of the rig."""

import math

import pytest

from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV, ANGLE_LSB_RAD, CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from tests.unit.drives.vesc.bench import CONFIG, MS, SET_POS, TURNS, Bench, answer, command, position_deg


def test_a_sample_has_angle_and_current_of_one_answer() -> None:
    bench = Bench().running()
    bench.drive.take_samples()
    bench.says = lambda: answer(position_deg=37.0, current=-21)
    bench.tick()
    (sample,) = bench.drive.take_samples()
    assert sample.theta_m * ANGLE_LSB_RAD == pytest.approx(math.radians(37.0), abs=1e-6)
    assert sample.current * CURRENT_LSB_A == pytest.approx(-0.215, abs=2e-4)
    assert (sample.stamp_ns, sample.received_ns) == (bench.now_ms * MS, (bench.now_ms + 1) * MS)
    assert sample.state == DriveState.OPERATIONAL


@pytest.mark.parametrize("ratio", [1.0, -1.0, 2.5, -0.5])
def test_gear_sign_and_zero_are_those_of_the_rig(ratio: float) -> None:
    ends = sorted((0.3 - 0.1 * ratio, 0.3 + 0.25 * ratio))
    bench = Bench(
        CONFIG._replace(rev_per_pulley_rev=ratio, zero_rev=0.3, turns=TURNS._replace(low_rev=ends[0], high_rev=ends[1]))
    )
    raw = round(0.125 * ANGLE_LSB_PER_REV)
    told_deg = (0.3 + 0.125 * ratio) % 1.0 * 360.0
    bench.says = lambda: answer(position_deg=told_deg, status=bench.has_timeout())
    bench.ready()
    bench.drive.enable()
    bench.raw = raw
    (frame,) = bench.tick()
    assert position_deg(frame) == pytest.approx(told_deg, abs=1e-5)
    bench.says = lambda: answer(position_deg=told_deg, current=20)
    bench.tick()
    sample = bench.drive.take_samples()[-1]
    assert sample.theta_m == pytest.approx(raw, abs=20)
    assert sample.current * CURRENT_LSB_A == pytest.approx(math.copysign(0.205, ratio), abs=2e-4)


def test_turns_are_counted_past_the_wrap_and_references_go_with_them() -> None:
    bench = Bench(CONFIG._replace(turns=TURNS._replace(low_rev=0.5, high_rev=1.4)))
    bench.says = lambda: answer(position_deg=350.0, status=bench.has_timeout())
    bench.ready()
    angle = 350.0
    for _ in range(20):
        angle += 1.0
        bench.says = lambda angle=angle: answer(position_deg=angle % 360.0)  # type: ignore[misc]
        bench.tick()
    assert bench.drive.take_samples()[-1].theta_m * ANGLE_LSB_RAD == pytest.approx(math.radians(370.0), abs=1e-6)
    assert bench.drive.counters["jumps"] == 0


def test_a_jump_is_counted_and_refused() -> None:
    bench = Bench().running()
    bench.drive.take_samples()
    bench.says = lambda: answer(position_deg=126.0)
    bench.tick()
    assert bench.drive.take_samples() == []
    assert bench.drive.counters["jumps"] == 1
    bench.says = answer
    bench.tick()
    assert len(bench.drive.take_samples()) == 1


def test_turns_that_can_not_be_counted_any_more_end_it() -> None:
    bench = Bench().running()
    bench.says = list
    bench.tick(25)  # half a turn, at 10 turns a second
    assert bench.drive.phase.name == "RUNNING"
    bench.says = answer
    bench.tick()
    assert bench.drive.phase is HostPhase.DISCONNECTED


def test_lost_answers_are_counted_and_cost_nothing_else() -> None:
    bench = Bench().running()
    before = dict(bench.drive.counters)
    bench.says = lambda: answer()[1:]
    bench.tick(3)
    assert bench.drive.counters["torn_answers"] > before["torn_answers"]
    bench.says = list
    bench.tick(3)
    bench.says = answer
    bench.tick(3)
    assert bench.drive.counters["unanswered"] == before["unanswered"] + 6
    assert bench.drive.phase is HostPhase.RUNNING
    assert {command(frame) for frame in bench.sent} == {SET_POS}
