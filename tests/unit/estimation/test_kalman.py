"""The Kalman filter's parts against textbook answers: exact stretches, steady gain, gaps, weights."""

import math
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray

from hil_forceps.estimation.algorithms import kalman, kalman_model
from hil_forceps.estimation.interface import ELONGATION, TAU_W
from hil_forceps.model.linear.two_inertia import continuous, discretise
from hil_forceps.rig import load_rig

RIG = load_rig(Path(__file__).parents[3] / "configs" / "paper.yaml")
PLANT = RIG.plant()
SENSORS = kalman_model.Sensors(2.0 * math.pi / 16384, 2.0 * math.pi / 2**24, 1e-3, 2e-4)
TUNING = kalman_model.Tuning()
NS = 10**9
UNITS = np.array([1.0, 2000.0, 1.0, 2000.0, 0.3])


def constants(tuning: kalman_model.Tuning = TUNING, period_s: float = 1e-3, hold_s: float = 1.0) -> NDArray[np.float64]:
    return kalman_model.constants(PLANT, SENSORS, period_s, hold_s, tuning)


def hypotheses(state: NDArray[np.float64]) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    blocks = state[6:].reshape(3, 30)  # quiet, fresh, settling
    return [(block[:5], block[5:].reshape(5, 5)) for block in blocks]


def stepped(state: NDArray[np.float64]) -> float:
    return float(state[kalman.FRESH_WEIGHT] + state[kalman.SETTLING_WEIGHT])


def rates() -> NDArray[np.float64]:
    a, b = continuous(PLANT)
    joint = np.zeros((6, 6))
    joint[:4, :4], joint[:4, 4], joint[:4, 5] = a, b[:, 1], b[:, 0]
    return joint


@pytest.mark.parametrize("dt_s", [1e-5, 1e-4, 9.7e-4, 1e-3, 7e-3])
def test_stretch_is_exact(dt_s: float) -> None:
    over = kalman_model.stretch(constants(), dt_s)
    expected = scipy.linalg.expm(rates() * dt_s)[:5]
    scale = np.append(UNITS, 0.13)
    assert np.max(np.abs(over[:, :6] - expected) * scale[None, :] / UNITS[:, None]) < 1e-12


@pytest.mark.parametrize("dt_s", [1e-4, 1e-3, 3e-3])
def test_covariance_of_a_step_somewhere_within(dt_s: float) -> None:
    over = kalman_model.stretch(constants(), dt_s)
    places = (np.arange(4000) + 0.5) / 4000 * dt_s
    columns = [scipy.linalg.expm(rates() * place)[:5, 4] for place in places[::20]]
    within = np.mean([np.outer(column, column) for column in columns], axis=0)
    at_start = scipy.linalg.expm(rates() * dt_s)[:5, 4]
    expected = 0.5 * (np.outer(at_start, at_start) + within)
    sizes = np.sqrt(np.diag(expected))
    assert np.max(np.abs(over[:, 6:] - expected) / np.outer(sizes, sizes)) < 0.02


@pytest.mark.parametrize("period_s", [1e-4, 1e-3])
def test_without_steps_it_is_the_steady_kalman_filter(period_s: float) -> None:
    c = constants(TUNING._replace(step_rate_per_s=1e-9, restep_rate_per_s=0.0, drift_per_s=1.0), period_s)
    state = kalman.start(c, 0, 0.5, 0.0)
    for n in range(1, 3000):
        state = kalman.step(state, c, round(n * period_s * NS), 0.5, 0.0)
    assert stepped(state) < 1e-6
    covariance = hypotheses(state)[0][1] / np.outer(UNITS, UNITS)

    over = kalman_model.stretch(c, period_s)
    transition = over[:, :5] * UNITS[None, :] / UNITS[:, None]
    noise = c[kalman_model.DRIFT] * period_s * over[:, 6:] + c[kalman_model.TORQUE_VAR] * np.outer(
        over[:, 5], over[:, 5]
    )
    noise = noise / np.outer(UNITS, UNITS)
    row = np.array([[1.0, 0.0, 0.0, 0.0, 0.0]])
    variance = np.array([[c[kalman_model.ANGLE_VAR]]])
    predicted = scipy.linalg.solve_discrete_are(transition.T, row.T, noise, variance)
    gain = predicted @ row.T / (predicted[0, 0] + variance)
    expected = predicted - gain @ row @ predicted
    np.testing.assert_allclose(covariance, expected, rtol=1e-3, atol=1e-5 * np.max(np.abs(expected)))


def test_follows_the_plant_it_models_without_error() -> None:
    """From the right start, fed with exact samples at irregular times, the estimate is the truth."""
    smooth = PLANT._replace(motor_coulomb_N_m=0.0, jaw_coulomb_N_m=0.0)
    c = kalman_model.constants(smooth, SENSORS, 1e-3, 1.0, TUNING)
    random = np.random.default_rng(3)
    state = kalman.start(c, 0, 0.5, 0.0)
    truth = np.array([0.5, 0.0, 0.5 * 2.0 / 1.4, 0.0])
    time_ns = 0
    for n in range(300):
        wait_ns = int(random.integers(200_000, 1_400_000))
        torque = 1e-3 * math.sin(0.05 * n)
        time_ns += wait_ns
        transition, gain = discretise(smooth, wait_ns * 1e-9)
        truth = transition @ truth + gain @ np.array([torque, 0.0])
        state = kalman.step(state, c, time_ns, float(truth[0]), torque)
        assert abs(state[TAU_W]) < 1e-12
        assert abs(state[ELONGATION] - (2.0e-3 * truth[0] - 1.4e-3 * truth[2])) < 1e-12


def test_torque_before_the_last_hold_is_taken_halfway() -> None:
    """A drive that holds for 0.5 ms and reports every 1 ms: the unseen half is bridged, and more so after a loss."""
    c = constants(hold_s=5e-4)
    state = kalman.start(c, 0, 0.5, 0.0)
    smooth = PLANT._replace(motor_coulomb_N_m=0.0, jaw_coulomb_N_m=0.0)
    for gap_s in (1e-3, 3e-3):
        lead, gain_lead = discretise(smooth, gap_s - 5e-4)
        held, gain_held = discretise(smooth, 5e-4)
        begin = np.array([0.5, 0.0, 0.5 * 2.0 / 1.4, 0.0])
        middle = lead @ begin + gain_lead @ np.array([1e-3, 0.0])
        end = held @ middle + gain_held @ np.array([2e-3, 0.0])
        after = kalman.step(state, c, round(gap_s * NS), float(end[0]), 2e-3)
        # Friction of 4.6e-7 N m isn't in the expectation.
        assert abs(hypotheses(after)[0][0][0] - end[0]) < 2e-3 * abs(end[0] - 0.5)
        assert abs(after[TAU_W]) < 3e-6
        variances = np.diag(hypotheses(after)[0][1])
        assert (variances > 0.0).all()


def test_a_step_of_the_load_moves_the_weight_and_then_it_comes_back() -> None:
    smooth = PLANT._replace(motor_coulomb_N_m=0.0, jaw_coulomb_N_m=0.0)
    c = kalman_model.constants(smooth, SENSORS, 1e-3, 1.0, TUNING)
    transition, gain = discretise(smooth, 1e-3)
    truth = np.array([0.5, 0.0, 0.5 * 2.0 / 1.4, 0.0])
    state = kalman.start(c, 0, 0.5, 0.0)
    weights, loads = [], []
    for n in range(1, 400):
        load = 2e-3 if n > 200 else 0.0
        truth = transition @ truth + gain @ np.array([0.0, load])
        state = kalman.step(state, c, n * 1_000_000, float(truth[0]), 0.0)
        weights.append(stepped(state))
        loads.append(float(state[TAU_W]))
    assert weights[198] < 0.02
    assert max(weights[200:204]) > 0.99
    assert weights[-1] < 0.05
    assert loads[203] == pytest.approx(2e-3, rel=0.05)
    assert loads[-1] == pytest.approx(2e-3, rel=0.01)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_friction_over_a_stretch(sign: float) -> None:
    over = kalman_model.stretch(constants(), 1e-3)
    response = np.array([[over[1, 5], -over[1, 4]], [over[3, 5], -over[3, 4]]])

    def after(speeds: NDArray[np.float64], levels: tuple[float, float]) -> tuple[NDArray[np.float64], float, float]:
        motor, jaw = kalman_model.frictions_N_m(speeds[0], speeds[1], over, *levels)
        assert abs(motor) <= levels[0]
        assert abs(jaw) <= levels[1]
        return speeds - response @ np.array([motor, jaw]), motor, jaw

    fast = sign * np.array([50.0, 70.0])
    assert after(fast, (1e-3, 2e-3))[1:] == (sign * 1e-3, sign * 2e-3)
    slow = sign * np.array([0.02, 0.03])
    held, motor, jaw = after(slow, (1e-3, 2e-3))
    assert np.max(np.abs(held)) < 0.1 * np.max(np.abs(slow))
    assert motor * sign >= 0.0 or jaw * sign >= 0.0
    assert after(slow, (0.0, 0.0))[1:] == (0.0, 0.0)


def test_mixing_keeps_mean_and_covariance_of_the_two() -> None:
    random = np.random.default_rng(2)
    means = random.standard_normal((2, 5))
    roots = random.standard_normal((2, 5, 5))
    covariances = [root @ root.T for root in roots]
    blocks = [np.concatenate((mean, covariance.ravel())) for mean, covariance in zip(means, covariances, strict=True)]
    mixed = np.empty_like(blocks[0])
    kalman.mix(mixed, 0.3, blocks[0], 0.7, blocks[1])
    mean = 0.3 * means[0] + 0.7 * means[1]
    second = sum(w * (c + np.outer(m, m)) for w, m, c in zip((0.3, 0.7), means, covariances, strict=True)) - np.outer(
        mean, mean
    )
    np.testing.assert_allclose(mixed[:5], mean, rtol=1e-12)
    np.testing.assert_allclose(mixed[5:].reshape(5, 5), second, rtol=1e-10, atol=1e-12)


def test_an_unseen_torque_that_differs_at_both_ends_is_trusted_less() -> None:
    c = constants(hold_s=5e-4)
    variances = []
    for before in (2e-3, -2e-3):
        state = kalman.start(c, 0, 0.5, 2e-3)
        state[kalman.TORQUE] = before
        after = kalman.step(state, c, 1_000_000, 0.5, 2e-3)
        variances.append(hypotheses(after)[0][1][1, 1])
    assert variances[1] > 1.5 * variances[0]


def test_what_an_angle_is_off_by() -> None:
    quantum, wire = SENSORS.encoder_quantum_rad, SENSORS.transport_quantum_rad
    expected = (quantum**2 + wire**2) / 12.0 + (TUNING.count_share * quantum) ** 2
    assert constants()[kalman_model.ANGLE_VAR] == pytest.approx(expected, rel=1e-9)
    assert constants()[kalman_model.TORQUE_VAR] == pytest.approx(
        1.35e-2**2 * (1e-6 + 4e-8 / 12.0) + (TUNING.friction_share * 4.62e-7) ** 2, rel=1e-9
    )


def test_after_a_very_long_gap_it_starts_again() -> None:
    c = constants()
    state = kalman.step(kalman.start(c, 0, 0.5, 0.0), c, 1_000_000, 0.6, 2e-3)
    bridged = kalman.step(state, c, 1_000_000 + 250_000_000, 0.7, 1e-3)
    assert not np.array_equal(bridged, kalman.start(c, 251_000_000, 0.7, 1e-3))
    after = kalman.step(state, c, 1_000_000 + 250_000_001, 0.7, 1e-3)
    np.testing.assert_array_equal(after, kalman.start(c, 251_000_001, 0.7, 1e-3))


def test_an_angle_that_jumps_as_no_forceps_does_starts_it_again() -> None:
    c = constants()
    state = kalman.start(c, 0, 0.5, 1e-3)
    for n in range(1, 100):
        state = kalman.step(state, c, n * 1_000_000, 0.5, 1e-3)
    after = kalman.step(state, c, 100_000_000, -9.5, 1e-3)
    np.testing.assert_array_equal(after, kalman.start(c, 100_000_000, -9.5, 1e-3))
    # A load thirty times the expected step is a load still.
    transition, gain = discretise(PLANT, 1e-3)
    truth = transition @ np.array([0.5, 0.0, (1e-3 - 1e-3 / (2.0e-3 * 2.6e4)) / 1.4e-3, 0.0]) + gain @ [1e-3, 60e-3]
    after = kalman.step(state, c, 100_000_000, float(truth[0]), 1e-3)
    assert after[TAU_W] > 5e-3


def test_the_load_may_step_again_while_a_step_is_told_apart() -> None:
    c = constants()
    state = kalman.start(c, 0, 0.5, 0.0)
    for was_settling, rate_per_s in ((0.0, TUNING.step_rate_per_s), (1.0, TUNING.restep_rate_per_s)):
        state[kalman.FRESH_WEIGHT], state[kalman.SETTLING_WEIGHT] = 1e-12, was_settling * (1.0 - 2e-12)
        weights, new_part = kalman._age(np.empty_like(state), state, 1e-5, np.empty(kalman._SIZE), c)
        assert weights[1] == pytest.approx(rate_per_s * 1e-5, rel=1e-2)
        assert new_part == pytest.approx(1.0, rel=1e-6)
        assert sum(weights) == pytest.approx(1.0, rel=1e-12)
