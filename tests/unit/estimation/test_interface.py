"""What every estimator keeps to: pure steps, odd stamps, the same numbers in a compiled loop, names."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A
from hil_forceps.estimation import batch, wire
from hil_forceps.estimation.interface import Estimate, Estimator, Sample
from hil_forceps.estimation.registry import ESTIMATOR_IDS, make_estimator
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError

RIG = load_rig(Path(__file__).parents[3] / "configs" / "paper.yaml")
PERIOD_NS = 1_000_000
each = pytest.mark.parametrize("estimator_id", ESTIMATOR_IDS)


def record(samples: int, irregular: bool = False) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """A motor that swings under a torque that it didn't come from; with jitter, gaps, repeated and backward stamps."""
    random = np.random.default_rng(7)
    time_ns = np.arange(samples, dtype=np.int64) * PERIOD_NS
    if irregular:
        time_ns += random.integers(-200_000, 200_000, samples)
        time_ns[samples // 3 :] += 5 * PERIOD_NS
        time_ns[samples // 2 :] += 300 * PERIOD_NS
        time_ns[samples // 4] = time_ns[samples // 4 - 1]
        time_ns[samples // 5] = time_ns[samples // 5 - 1] - 17
    theta = 0.5 + 0.1 * np.sin(time_ns * 2e-8) + 1e-5 * random.standard_normal(samples)
    return time_ns, theta, 1e-3 * np.cos(time_ns * 2e-8) + 1e-5 * random.standard_normal(samples)


@each
@pytest.mark.parametrize("irregular", [False, True])
def test_compiled_loop_gives_the_bits_of_single_steps(estimator_id: str, irregular: bool) -> None:
    estimator = make_estimator(estimator_id, RIG, 1e-3)
    time_ns, theta, torque = record(600, irregular)
    tau_w, elongation = batch.run(estimator, time_ns, theta, torque)
    samples = [Sample(*values) for values in zip(time_ns.tolist(), theta.tolist(), torque.tolist(), strict=True)]
    state = estimator.start(samples[0])
    stepped = [estimator.estimate(state)]
    for sample in samples[1:]:
        state = estimator.step(state, sample)
        stepped.append(estimator.estimate(state))
    np.testing.assert_array_equal(tau_w, [estimate.tau_w_N_m for estimate in stepped])
    np.testing.assert_array_equal(elongation, [estimate.elongation_m for estimate in stepped])


@each
def test_states_are_never_changed_in_place(estimator_id: str) -> None:
    estimator = make_estimator(estimator_id, RIG, 1e-3)
    state = estimator.start(Sample(0, 0.5, 1e-3))
    before = state.copy()
    after = estimator.step(state, Sample(PERIOD_NS, 0.51, 2e-3))
    np.testing.assert_array_equal(state, before)
    assert not np.array_equal(after, before)
    again = estimator.step(state, Sample(PERIOD_NS, 0.51, 2e-3))
    np.testing.assert_array_equal(after, again)


@each
@pytest.mark.parametrize("stamp_ns", [PERIOD_NS, PERIOD_NS - 1, 0, -5])
def test_a_stamp_that_is_not_later_leaves_the_state(estimator_id: str, stamp_ns: int) -> None:
    estimator = make_estimator(estimator_id, RIG, 1e-3)
    state = estimator.step(estimator.start(Sample(0, 0.5, 1e-3)), Sample(PERIOD_NS, 0.5, 1e-3))
    np.testing.assert_array_equal(estimator.step(state, Sample(stamp_ns, 0.9, 0.1)), state)


@each
def test_at_rest_under_load_all_agree_with_statics(estimator_id: str) -> None:
    estimator = make_estimator(estimator_id, RIG, 1e-3)
    torque = 2e-3 * 2.0 / 1.4  # holds 2 mN m
    state = estimator.start(Sample(0, 0.5, torque))
    for n in range(200):
        tau_w, elongation = estimator.estimate(state)
        assert tau_w == pytest.approx(2e-3, rel=1e-9), n
        assert elongation == pytest.approx(54.945e-6, rel=1e-5), n
        state = estimator.step(state, Sample((n + 1) * PERIOD_NS, 0.5, torque))


@each
@pytest.mark.parametrize("speed", [-2.0, 2.0])
def test_at_constant_speed_all_torque_is_friction(estimator_id: str, speed: float) -> None:
    rig = RIG.with_changes({"forceps.motor_coulomb_N_m": 2e-4, "forceps.jaw_coulomb_N_m": 3e-4})
    plant = rig.plant()
    estimator = make_estimator(estimator_id, rig, 1e-3)
    direction = math.copysign(1.0, speed)
    torque = plant.motor_viscous_N_m_s_per_rad * speed + direction * (2e-4 + 2.0 / 1.4 * 3e-4)
    state = estimator.start(Sample(0, 0.0, torque))
    for n in range(1, 401):
        state = estimator.step(state, Sample(n * PERIOD_NS, speed * n * 1e-3, torque))
    tau_w, elongation = estimator.estimate(state)
    # The wire carries the jaw's friction.
    assert elongation == pytest.approx(direction * 3e-4 / (2.6e4 * 1.4e-3), abs=1e-9)
    if estimator_id != "improved_as_published":  # its x̂ is right, its τ̂_w already rings
        assert abs(tau_w) < 1e-6


@each
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_is_not_finite_shows(estimator_id: str, bad: float) -> None:
    estimator = make_estimator(estimator_id, RIG, 1e-3)
    rest = estimator.start(Sample(0, 0.5, 1e-3))
    for theta, torque in ((bad, 1e-3), (0.5, bad)):
        state = estimator.step(rest, Sample(PERIOD_NS, theta, torque))
        assert not math.isfinite(estimator.estimate(state).elongation_m)
        state = estimator.step(state, Sample(2 * PERIOD_NS, 0.5, 1e-3))
        # What has a memory of it keeps it; the Kalman filter starts anew.
        assert math.isfinite(estimator.estimate(state).elongation_m) == (estimator_id == "kalman")


@each
def test_large_stamps_lose_nothing(estimator_id: str) -> None:
    estimator = make_estimator(estimator_id, RIG, 1e-3)
    time_ns, theta, torque = record(300)
    late = time_ns + 90 * 24 * 3600 * 10**9
    np.testing.assert_array_equal(
        batch.run(estimator, time_ns, theta, torque)[0], batch.run(estimator, late, theta, torque)[0]
    )


def test_batch_runs_estimators_of_others_too() -> None:
    def add(state: NDArray[np.float64], sample: Sample) -> NDArray[np.float64]:
        return state + sample.theta_m_rad

    other = Estimator("sum", lambda s: np.array([s.theta_m_rad]), add, lambda s: Estimate(float(s[0]), 0.0))
    time_ns, theta, torque = record(20)
    tau_w, elongation = batch.run(other, time_ns, theta, torque)
    np.testing.assert_allclose(tau_w, np.cumsum(theta))
    assert not elongation.any()


@pytest.mark.parametrize("lengths", [(0, 0, 0), (3, 2, 3), (3, 3, 4)])
def test_batch_refuses_what_does_not_fit(lengths: tuple[int, int, int]) -> None:
    estimator = make_estimator("kalman", RIG, 1e-3)
    with pytest.raises(ValueError, match="one length"):
        batch.run(estimator, np.zeros(lengths[0], np.int64), np.zeros(lengths[1]), np.zeros(lengths[2]))


def test_names() -> None:
    assert ESTIMATOR_IDS == ("previous", "improved_as_published", "improved", "kalman")
    assert [make_estimator(name, RIG, 1e-3).id for name in ESTIMATOR_IDS] == list(ESTIMATOR_IDS)
    with pytest.raises(ValueError, match=r"unknown estimator 'luenberger'; known: previous, .*kalman"):
        make_estimator("luenberger", RIG, 1e-3)


@pytest.mark.parametrize("sample_time_s", [0.0, -1e-3, math.nan, math.inf])
def test_sample_time_must_be_positive(sample_time_s: float) -> None:
    with pytest.raises(ValueError, match="sample_time_s"):
        make_estimator("kalman", RIG, sample_time_s)


@each
def test_a_value_that_is_not_known_is_the_users_error(estimator_id: str) -> None:
    rig = RIG.with_changes({"forceps.wire_stiffness_N_per_m": "unknown"})
    with pytest.raises(UserError, match="wire_stiffness"):
        make_estimator(estimator_id, rig, 1e-3)


def test_a_rig_without_a_drive_has_estimators() -> None:
    assert make_estimator("kalman", RIG.with_changes({"drive": None}), 1e-3).compiled is not None


def test_the_wire_rounds_as_the_protocol_says() -> None:
    assert wire.WIRE_ANGLE_RAD == ANGLE_LSB_RAD
    assert wire.WIRE_CURRENT_A == CURRENT_LSB_A
