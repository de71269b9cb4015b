"""The pure part: what may leave, and when nothing may."""

import math

import numpy as np
import pytest

from firmware_protocol.host.samples import RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A
from hil_forceps.bridge.pipeline import PEAK_TO_MEAN_SPEED_RATIO, VERDICT_NAMES, Approach, Pipeline, Verdict
from hil_forceps.control.gate import Gate
from hil_forceps.estimation.interface import Estimate, Estimator, Sample, State
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import Limits

PLANT = PlantParameters(2.0e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)
LIMITS = Limits(position_min_rad=-1.0, position_max_rad=3.0, speed_max_rad_per_s=1e4, acceleration_max_rad_per_s2=1e9)
MS = 1_000_000
START_RAW = round(0.7 / ANGLE_LSB_RAD)
START_RAD = START_RAW * ANGLE_LSB_RAD
START_JAW_RAD = START_RAD * PLANT.motor_pulley_radius_m / PLANT.jaw_pulley_radius_m


def recording_estimator(taken: list[Sample], elongation_m: float = 0.0) -> Estimator:
    """Remember what came; the estimate is the torque and a fixed elongation."""

    def start(sample: Sample) -> State:
        taken.append(sample)
        return np.array([sample.motor_torque_N_m])

    def step(_: State, sample: Sample) -> State:
        return start(sample)

    return Estimator("fixed", start, step, lambda state: Estimate(float(state[0]), elongation_m))


def pipeline(
    taken: list[Sample] | None = None,
    elongation_m: float = 0.0,
    jaw_rad: float = START_JAW_RAD,
    compensate: bool = True,
    max_sample_age_s: float = 3e-3,
    same_clock: bool = False,
) -> Pipeline:
    estimator = recording_estimator([] if taken is None else taken, elongation_m)
    return Pipeline(
        estimator,
        lambda t_s: jaw_rad - 0.1 * max(t_s, 0.0),
        PLANT,
        Gate(LIMITS),
        compensate,
        max_sample_age_s,
        same_clock=same_clock,
    )


def raw(k: int, state: DriveState = DriveState.OPERATIONAL, theta_m: int = START_RAW, delay_ns: int = 0) -> RawSample:
    return RawSample(k % 256, k * MS, theta_m, 1000, state, 0, 0, k * MS + delay_ns)


def test_raw_becomes_si_at_the_wires_scale() -> None:
    taken: list[Sample] = []
    line = pipeline(taken)
    assert line.feed(raw(3))
    assert taken == [line.sample]
    assert line.sample == pytest.approx((3 * MS, START_RAD, PLANT.torque_constant_N_m_per_A * 1000 * CURRENT_LSB_A))


def test_before_operation_the_reference_is_the_measured_angle_to_the_last_bit() -> None:
    line = pipeline(elongation_m=1e-4, jaw_rad=0.0)
    for k, state in enumerate((DriveState.DISABLED, DriveState.ARMED, DriveState.ARMED)):
        line.feed(raw(k, state, START_RAW + 17 * k))
        assert line.reference(k * MS).reference_raw == START_RAW + 17 * k
    assert line.zero_ns is None


def test_the_zero_is_the_first_operational_sample_also_when_it_is_not_the_newest() -> None:
    line = pipeline()
    line.feed(raw(1, DriveState.ARMED))
    line.reference(MS)
    line.feed(raw(2))
    line.feed(raw(3))
    reference = line.reference(3 * MS)
    assert line.zero_ns == 2 * MS
    assert reference.trajectory_ns == MS
    assert reference.theta_j_ref_rad == START_JAW_RAD - 0.1 * 1e-3


def test_compensation_is_equation_10_and_uncompensated_takes_the_elongation_as_zero() -> None:
    for compensate in (True, False):
        line = pipeline(elongation_m=1e-5, compensate=compensate)
        line.feed(raw(0))
        reference = line.reference(0)
        x = 1e-5 if compensate else 0.0
        expected = (PLANT.jaw_pulley_radius_m * START_JAW_RAD + x) / PLANT.motor_pulley_radius_m
        assert reference.requested_rad == pytest.approx(expected, rel=1e-15)
        assert reference.elongation_used_m == x
        assert reference.reference_raw == round(reference.passed_rad / ANGLE_LSB_RAD)


def test_every_sample_is_estimated_and_one_reference_leaves_a_tick() -> None:
    taken: list[Sample] = []
    line = pipeline(taken)
    arrivals = [1, 0, 2, 1, 0, 0, 3, 1]  # samples a tick, as two clocks drift past each other
    k = 0
    for tick, count in enumerate(arrivals):
        for _ in range(count):
            line.feed(raw(k, delay_ns=0))
            k += 1
        reference = line.reference(max(k - 1, 0) * MS)
        assert (reference.reference_raw is not None) == (count > 0), tick
        assert line.reference(max(k - 1, 0) * MS).verdict == Verdict.NOTHING_NEW, "never twice from the same sample"
    assert [sample.time_ns for sample in taken] == [n * MS for n in range(k)]
    assert line.counters["samples"] == k


def test_nothing_leaves_when_the_newest_sample_is_stale() -> None:
    line = pipeline(max_sample_age_s=3e-3)
    line.feed(raw(0))
    assert line.reference(3 * MS).reference_raw is not None
    line.feed(raw(1))
    late = line.reference(4 * MS + 1)
    assert (late.reference_raw, late.verdict) == (None, Verdict.STALE)
    assert line.counters["stale"] == 1


def test_a_sample_held_up_on_its_way_is_stale_although_it_has_just_come_where_the_clock_is_known() -> None:
    line = pipeline(same_clock=True)
    for k in range(10):
        line.feed(raw(k))
        assert line.reference(k * MS).reference_raw is not None
    line.feed(raw(10, delay_ns=5 * MS))
    assert line.reference(15 * MS).verdict == Verdict.STALE


def test_a_sample_that_arrived_before_the_clock_was_set_back_is_as_old_as_its_arrival() -> None:
    line = pipeline(same_clock=True)
    line.feed(raw(100, delay_ns=-80 * MS))  # asked for at 100 ms; by the time of its arrival it was 20 ms
    assert line.reference(101 * MS).verdict == Verdict.STALE


def test_a_step_of_a_drives_own_clock_does_not_stop_the_references() -> None:
    line = pipeline()
    for k in range(20):
        line.feed(raw(k, delay_ns=0 if k < 10 else 15 * MS))
        assert line.reference(k * MS + (0 if k < 10 else 15 * MS)).reference_raw is not None


def test_stamps_that_do_not_increase_are_dropped_and_counted() -> None:
    taken: list[Sample] = []
    line = pipeline(taken)
    line.feed(raw(5))
    assert not line.feed(raw(5))
    assert not line.feed(raw(4))
    assert len(taken) == 1
    assert line.counters["not_increasing"] == 2


def test_an_estimate_that_is_not_finite_lets_nothing_leave() -> None:
    line = pipeline(elongation_m=math.nan)
    for k in range(4):
        line.feed(raw(k))
        reference = line.reference(k * MS)
        assert reference.reference_raw is None
        assert math.isnan(reference.passed_rad)
        assert reference.verdict in VERDICT_NAMES
        assert line.denied_in_a_row == k + 1
    uncompensated = pipeline(elongation_m=math.nan, compensate=False)
    uncompensated.feed(raw(0))
    assert uncompensated.reference(0).reference_raw is not None


@pytest.mark.parametrize("wild_m", [1.0, -1e300, 1e300])
def test_a_wild_first_estimate_is_denied_and_shifts_nothing_that_follows(wild_m: float) -> None:
    elongation_m = [wild_m]
    estimator = Estimator("x", lambda _: np.zeros(1), lambda s, _: s, lambda _: Estimate(0.0, elongation_m[0]))
    line = Pipeline(estimator, lambda _: START_JAW_RAD, PLANT, Gate(LIMITS), True, 3e-3)
    line.feed(raw(0))
    first = line.reference(0)
    assert (first.reference_raw, first.verdict) == (None, Verdict.DENIED_TOO_FAR)
    assert abs(first.requested_rad) > 100.0, "what was asked for is recorded"
    assert math.isnan(first.passed_rad)
    assert (line.denied_in_a_row, line.counters["denied"]) == (1, 1)
    elongation_m[0] = 0.0
    for k in range(1, 10):
        line.feed(raw(k))
        assert line.reference(k * MS).passed_rad == pytest.approx(START_RAD, abs=1e-3)
    assert line.denied_in_a_row == 0


def test_one_reference_that_passes_ends_a_row_of_denied_ones() -> None:
    elongation_m = [math.nan]
    estimator = Estimator("x", lambda _: np.zeros(1), lambda s, _: s, lambda _: Estimate(0.0, elongation_m[0]))
    line = Pipeline(estimator, lambda _: START_JAW_RAD, PLANT, Gate(LIMITS), True, 3e-3)
    rows = []
    for k in range(6):
        elongation_m[0] = 1e-6 if k == 3 else math.nan
        line.feed(raw(k))
        line.reference(k * MS)
        rows.append(line.denied_in_a_row)
    assert rows == [1, 2, 3, 0, 1, 2]


def test_a_drive_that_leaves_operation_is_held_where_it_is() -> None:
    line = pipeline()
    line.feed(raw(0))
    line.reference(0)
    line.feed(raw(1, DriveState.DISABLED, START_RAW + 999))
    assert line.reference(MS).reference_raw == START_RAW + 999
    assert line.zero_ns == 0


@pytest.mark.parametrize("ahead_rad", [0.5, -0.5])
def test_a_jaw_that_is_elsewhere_is_led_to_the_trajectory_without_a_kick(ahead_rad: float) -> None:
    speed = Approach().speed_rad_per_s
    line = pipeline(jaw_rad=START_JAW_RAD + ahead_rad * PLANT.motor_pulley_radius_m / PLANT.jaw_pulley_radius_m)
    fades_ns = round(PEAK_TO_MEAN_SPEED_RATIO * abs(ahead_rad) / speed * 1e9)
    last = START_RAD
    for k in range(fades_ns // MS + 50):
        line.feed(raw(k))
        reference = line.reference(k * MS)
        plain = PLANT.jaw_pulley_radius_m * reference.theta_j_ref_rad / PLANT.motor_pulley_radius_m
        assert abs(reference.passed_rad - last) <= 1.001 * (speed + 0.1) * 1e-3
        last = reference.passed_rad
        if k == 0:
            assert reference.passed_rad == pytest.approx(START_RAD, abs=1e-12)
        if k * MS >= fades_ns:
            assert reference.requested_rad == pytest.approx(plain, abs=1e-15)
    assert line.zero_ns == 0


def test_a_jaw_that_is_there_has_no_approach() -> None:
    line = pipeline(jaw_rad=START_JAW_RAD + 0.001)
    line.feed(raw(0))
    reference = line.reference(0)
    plain = PLANT.jaw_pulley_radius_m * reference.theta_j_ref_rad / PLANT.motor_pulley_radius_m
    assert reference.requested_rad == plain


def test_warming_up_leaves_no_trace() -> None:
    cold, warm = pipeline(), pipeline()
    warm.warm_up()
    for line in (cold, warm):
        line.feed(raw(0))
    assert cold.reference(0) == warm.reference(0)
    assert cold.counters == warm.counters


def test_wrong_settings_raise() -> None:
    with pytest.raises(ValueError, match="positive"):
        pipeline(max_sample_age_s=0.0)
