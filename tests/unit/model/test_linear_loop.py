"""The mind's own simulation: the drive's law by hand, the plant against another integrator, friction's manners."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from hil_forceps.model import linear_loop
from hil_forceps.model.linear.two_inertia import continuous
from hil_forceps.model.linear_loop import DriveParameters, make_loop, rest_state, rollout
from hil_forceps.rig.plant import PlantParameters

PAPER = PlantParameters(2.0e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)
SMOOTH = PAPER._replace(motor_coulomb_N_m=0.0, jaw_coulomb_N_m=0.0)
DRIVE = DriveParameters(1e-3, 1.2, 15.0, 0.006, 150.0, 1.0)


def test_drive_law_by_hand() -> None:
    loop = make_loop(PAPER, DRIVE)
    share = 1.0 - math.exp(-2.0 * math.pi * 150.0 * 1e-3)
    first = linear_loop.drive_step(np.zeros(5), 0.1, 0.02, loop.drive)
    assert first[linear_loop.DRIVE_VELOCITY] == 0.0  # nothing to take a difference with
    assert first[linear_loop.DRIVE_CURRENT] == pytest.approx(1.2 * 0.08 + 15.0 * 0.08e-3)
    second = linear_loop.drive_step(first, 0.1, 0.03, loop.drive)
    velocity = share * 0.01 / 1e-3
    assert second[linear_loop.DRIVE_VELOCITY] == pytest.approx(velocity)
    assert second[linear_loop.DRIVE_CURRENT] == pytest.approx(1.2 * 0.07 + 15.0 * 0.15e-3 - 0.006 * velocity)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_drive_limits_current_and_integral(sign: float) -> None:
    loop = make_loop(PAPER, DRIVE)
    state = np.zeros(5)
    for _ in range(1000):
        state = linear_loop.drive_step(state, sign * 10.0, 0.0, loop.drive)
        assert state[linear_loop.DRIVE_CURRENT] == sign * 1.0
    assert state[linear_loop.DRIVE_INTEGRAL] * 15.0 == pytest.approx(sign * 1.0)


def test_drive_without_integral_gain() -> None:
    loop = make_loop(PAPER, DRIVE._replace(ki_A_per_rad_s=0.0))
    assert linear_loop.drive_step(np.zeros(5), 0.1, 0.0, loop.drive)[linear_loop.DRIVE_CURRENT] == pytest.approx(0.12)


@pytest.mark.parametrize(("value", "expected"), [(0.24, 0.2), (0.251, 0.3), (-0.24, -0.2), (-0.26, -0.3), (0.0, 0.0)])
def test_rounding_to_quanta(value: float, expected: float) -> None:
    assert linear_loop.quantise(value, 0.1) == pytest.approx(expected)
    assert linear_loop.quantise(value, 0.0) == value


def _open_loop(plant: PlantParameters, steps: int, step_s: float) -> NDArray[np.float64]:
    loop = make_loop(plant, DRIVE._replace(sample_time_s=step_s * steps), plant_step_s=step_s)
    return linear_loop.interval(rest_state(plant, 0.5), 0.3, np.full(steps, 1e-3), loop)


def test_plant_is_that_of_another_integrator() -> None:
    a, b = continuous(SMOOTH)
    inputs = np.array([0.3 * SMOOTH.torque_constant_N_m_per_A, 1e-3])
    other = solve_ivp(
        lambda _, x: a @ x + b @ inputs, (0.0, 0.02), rest_state(SMOOTH, 0.5), method="DOP853", rtol=1e-11, atol=1e-13
    )
    np.testing.assert_allclose(_open_loop(SMOOTH, 400, 5e-5), other.y[:, -1], rtol=1e-8, atol=1e-10)
    # Without friction the step is exact whatever its length.
    np.testing.assert_allclose(_open_loop(SMOOTH, 1, 0.02), other.y[:, -1], rtol=1e-8, atol=1e-10)


def test_friction_converges_as_the_step_shrinks() -> None:
    sticky = PAPER._replace(motor_coulomb_N_m=5e-4, jaw_coulomb_N_m=5e-4)

    def rung(steps: int) -> NDArray[np.float64]:
        loop = make_loop(sticky, DRIVE._replace(sample_time_s=5e-3), plant_step_s=5e-3 / steps)
        return linear_loop.interval(np.array([0.0, 5.0, 0.0, -5.0]), 0.0, np.zeros(steps), loop)

    fine = rung(64_000)
    errors = [np.max(np.abs(rung(steps) - fine)[[0, 2]]) for steps in (100, 800, 6400)]
    assert errors[0] > 3.0 * errors[1] > 9.0 * errors[2]
    assert errors[0] < 0.02 * np.max(np.abs(fine[[0, 2]]))


def test_friction_holds_what_is_below_its_level_and_lets_go_above() -> None:
    sticky = PAPER._replace(motor_coulomb_N_m=1e-3)
    loop = make_loop(sticky, DRIVE)
    start = rest_state(sticky, 0.5)
    for torque_N_m, moves in ((0.99e-3, False), (-0.99e-3, False), (1.2e-3, True)):
        state = linear_loop.interval(start, torque_N_m / sticky.torque_constant_N_m_per_A, np.zeros(20), loop)
        assert bool(abs(state[0] - start[0]) > 1e-4) == moves, torque_N_m


@pytest.mark.parametrize(("sample_time_s", "plant_step_s"), [(1e-3, 3e-4), (1e-4, 1e-3)])
def test_steps_must_fit_the_sample(sample_time_s: float, plant_step_s: float) -> None:
    with pytest.raises(ValueError, match="whole number"):
        make_loop(PAPER, DRIVE._replace(sample_time_s=sample_time_s), plant_step_s=plant_step_s)


def test_rollout_holds_the_jaw_but_for_the_stretch() -> None:
    loop = make_loop(PAPER, DRIVE)
    samples = 3000
    references = np.full(samples, 0.7 * 0.5)
    load = np.where(np.arange(samples * 20) >= 1000 * 20, 2e-3, 0.0)
    run = rollout(loop, rest_state(PAPER, 0.5), references, load)
    assert abs(run.states[999, 2] - 0.5) < 1e-6
    assert math.degrees(run.states[-1, 2] - 0.5) == pytest.approx(-2.249, abs=0.01)
    assert run.current_A[-1] == pytest.approx(0.2116, abs=1e-3)
    assert run.current_A[0] == 0.0
    assert np.array_equal(run.theta_m_rad, run.states[:, 0])


def test_rollout_through_a_coarse_encoder_stays_within_a_count() -> None:
    loop = make_loop(PAPER, DRIVE, counts_per_rev=4096)
    references = np.full(2000, 0.7 * 0.5)
    run = rollout(loop, rest_state(PAPER, 0.5), references, np.zeros(2000 * 20))
    quantum = 2.0 * math.pi / 4096
    assert np.max(np.abs(run.theta_m_rad - run.states[:, 0])) <= 0.5 * quantum * (1 + 1e-12)
    assert np.max(np.abs(run.theta_m_rad / quantum - np.round(run.theta_m_rad / quantum))) < 1e-9
    assert np.max(np.abs(run.states[:, 0] - references)) < quantum


def test_rollout_refuses_what_does_not_fit() -> None:
    loop = make_loop(PAPER, DRIVE)
    with pytest.raises(ValueError, match="40 values"):
        rollout(loop, rest_state(PAPER, 0.5), np.zeros(2), np.zeros(39))
    with pytest.raises(ValueError, match="must have 4"):
        rollout(loop, np.zeros(3), np.zeros(2), np.zeros(40))
