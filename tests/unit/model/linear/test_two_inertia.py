"""The plant as a linear system, against scipy and against the figures of the paper."""

import math

import numpy as np
import pytest
import scipy.linalg

from hil_forceps.model.linear import two_inertia as model
from hil_forceps.rig.plant import PlantParameters

PAPER = PlantParameters(2.0e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)


@pytest.mark.parametrize("size", [1, 2, 4, 6])
@pytest.mark.parametrize("norm", [0.0, 1e-12, 0.3, 0.5, 0.500001, 3.0, 40.0])
def test_expm_is_that_of_scipy(size: int, norm: float) -> None:
    random = np.random.default_rng(size)
    matrix = random.standard_normal((size, size))
    matrix *= norm / np.linalg.norm(matrix, np.inf)
    expected = scipy.linalg.expm(matrix)
    assert np.max(np.abs(model.expm(matrix) - expected)) <= 1e-13 * np.max(np.abs(expected))


def test_expm_of_nan_is_nan() -> None:
    assert np.isnan(model.expm(np.full((2, 2), math.nan))).all()


@pytest.mark.parametrize("dt_s", [1e-7, 5e-5, 1e-4, 1e-3, 1.001e-3, 1e-2])
def test_discretisation_is_that_of_scipy(dt_s: float) -> None:
    a, b = model.continuous(PAPER)
    joint = np.zeros((6, 6))
    joint[:4, :4], joint[:4, 4:] = a, b
    expected = scipy.linalg.expm(joint * dt_s)
    transition, gain = model.discretise(PAPER, dt_s)
    # Balanced: speeds in units of the wire's mode, so that every entry weighs alike.
    units = np.array([1.0, 2000.0, 1.0, 2000.0])
    assert np.max(np.abs(transition - expected[:4, :4]) * units[None, :] / units[:, None]) < 1e-12
    assert np.max(np.abs(gain / expected[:4, 4:] - 1.0)) < 1e-9


def test_discretisation_of_no_time_changes_nothing() -> None:
    transition, gain = model.discretise(PAPER, 0.0)
    assert np.array_equal(transition, np.eye(4))
    assert not gain.any()


def test_two_steps_are_one_of_twice_the_time() -> None:
    once, gain_once = model.discretise(PAPER, 3e-4)
    twice, gain_twice = model.discretise(PAPER, 6e-4)
    np.testing.assert_allclose(once @ once, twice, rtol=1e-12)
    np.testing.assert_allclose(once @ gain_once + gain_once, gain_twice, rtol=1e-12)


def test_after_a_long_time_only_what_the_motor_coasted_is_left() -> None:
    transition, _ = model.discretise(PAPER, 10.0)
    # Momentum over D_m is how far each mass's speed carries the motor; the wire has come to rest.
    ratio = 2.0e-3 / 1.4e-3
    coasted = np.array([PAPER.motor_inertia_kg_m2, ratio * PAPER.jaw_inertia_kg_m2]) / PAPER.motor_viscous_N_m_s_per_rad
    np.testing.assert_allclose(transition[0], [1.0, coasted[0], 0.0, coasted[1]], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(transition[2], ratio * transition[0], rtol=1e-9, atol=1e-9)
    assert np.max(np.abs(transition[[1, 3]])) < 1e-9


@pytest.mark.parametrize("dt_s", [-1e-9, math.nan, math.inf])
def test_nonsense_time_is_refused(dt_s: float) -> None:
    with pytest.raises(ValueError, match="dt_s"):
        model.discretise(PAPER, dt_s)


def test_figures_of_the_paper() -> None:
    assert model.wire_mode_rad_per_s(PAPER) == pytest.approx(2003.6, abs=0.05)
    poles = model.poles_per_s(PAPER)
    expected = [-2466.0, complex(-591.0, 867.0), complex(-591.0, -867.0), 0.0]
    assert np.max(np.abs(poles - np.array(expected))) < 0.5
    assert model.steady_elongation_m(PAPER, 2e-3) == pytest.approx(54.9e-6, abs=0.05e-6)
    assert math.degrees(model.steady_jaw_error_rad(PAPER, 2e-3)) == pytest.approx(-2.249, abs=5e-4)
    assert model.steady_current_A(PAPER, 2e-3) == pytest.approx(0.212, abs=5e-4)
    assert model.total_inertia_kg_m2(PAPER) == pytest.approx(3.18e-8 + 6.85e-8 * 4.0e-6 / 1.96e-6)


def test_steady_figures_are_a_fixed_point_of_the_plant() -> None:
    tau_w, theta_m = 2e-3, 0.3
    jaw = (2.0e-3 * theta_m - model.steady_elongation_m(PAPER, tau_w)) / 1.4e-3
    state = np.array([theta_m, 0.0, jaw, 0.0])
    torque = PAPER.torque_constant_N_m_per_A * model.steady_current_A(PAPER, tau_w)
    transition, gain = model.discretise(PAPER, 1e-3)
    after = transition @ state + gain @ np.array([torque, tau_w])
    np.testing.assert_allclose(after, state, atol=1e-11)
