"""The mini cheetah profile while it runs: references, lost answers, samples with gear, sign and stamp."""

import math

import pytest

from firmware_protocol.scales import ANGLE_LSB_PER_REV, CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from hil_forceps.drives.mit import messages as wire
from hil_forceps.drives.mit.machine import RESTART_NS, Mit
from tests.unit.drives.mit.bench import CONFIG, EXIT, MS, POSITION, answer, codes, nobody, running, ticks


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


@pytest.mark.parametrize("code", [0, wire.MAX_POSITION_CODE])
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


@pytest.mark.parametrize("ratio", [1.0, -1.0, 7.5, -0.5])
def test_gear_sign_and_zero_are_those_of_the_rig(ratio: float) -> None:
    config = CONFIG._replace(rev_per_pulley_rev=ratio, zero_rev=0.3, current_range_A=math.copysign(20.0, ratio))
    drive = running(config)
    raw = 1 << 20
    sent = codes(ticks(drive, 56, 1, raw=raw)[0][0])
    asked_rad = wire.value_of(sent.position, -12.5, 12.5, wire.MAX_POSITION_CODE)
    assert asked_rad == pytest.approx(2.0 * math.pi * (0.3 + ratio / 16.0), abs=12.5 / wire.MAX_POSITION_CODE)
    (sample,) = drive.take_samples()
    measured_rad = (POSITION + 0.5) * 25.0 / wire.MAX_POSITION_CODE - 12.5
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
