"""The truth plant against linear algebra, against its own order and against the figures derived from the paper."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from hil_forceps.rig.plant import PlantParameters
from virtual_bus.plant.load import LoadProfile, paper_load, piecewise_linear
from virtual_bus.plant.plant import (
    PlantState,
    TruthParameters,
    advance,
    elongation,
    rest_state,
    rk4_step,
    smooth_dynamics,
    truth_parameters,
)

TABLE_I = PlantParameters(2.00e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.60e4, 1.35e-2)
SMOOTH = TABLE_I._replace(motor_coulomb_N_m=0.0, jaw_coulomb_N_m=0.0)
NO_LOAD = paper_load(0)
SECOND_NS = 1_000_000_000


def run(
    plant: PlantParameters, start: NDArray[np.float64], current_A: float, load: LoadProfile, end_ns: int, step_s: float
) -> NDArray[np.float64]:
    """Return the state at `end_ns`, the whole way in one call."""
    state = start.copy()
    p = truth_parameters(plant, min(step_s, 1.0e-4))
    advance(state, p, current_A, load.time_ns, load.torque_N_m, 0, end_ns, step_s)
    return state


def exact(start: NDArray[np.float64], current_A: float, tau_w_N_m: float, time_s: float) -> NDArray[np.float64]:
    """Solve the smooth plant under constant inputs by the matrix exponential."""
    p = truth_parameters(SMOOTH, 1.0e-5)
    augmented = np.zeros((5, 5))
    augmented[:4, :4] = smooth_dynamics(p)
    augmented[1, 4] = p.torque_constant_N_m_per_A * current_A / p.motor_inertia_kg_m2
    augmented[3, 4] = -tau_w_N_m / p.jaw_inertia_kg_m2
    solution: NDArray[np.float64] = (expm(augmented * time_s) @ np.append(start, 1.0))[:4]
    return solution


def test_derived_poles_and_wire_mode_are_those_of_the_paper() -> None:
    damped = np.linalg.eigvals(smooth_dynamics(truth_parameters(TABLE_I, 5.0e-5)))
    real = sorted(damped[np.abs(damped.imag) < 1.0].real)
    pair = damped[damped.imag > 1.0]
    assert real == pytest.approx([-2466.0, 0.0], abs=1.0)
    assert pair == pytest.approx([-591.0 + 867.0j], abs=1.0)
    undamped = np.linalg.eigvals(
        smooth_dynamics(truth_parameters(TABLE_I._replace(motor_viscous_N_m_s_per_rad=0.0), 5.0e-5))
    )
    assert np.abs(undamped.imag).max() == pytest.approx(2003.6, abs=0.1)
    assert np.abs(undamped.imag).max() / (2.0 * math.pi) == pytest.approx(319.0, abs=0.5)


def test_undamped_wire_mode_swings_at_319_hz() -> None:
    free = SMOOTH._replace(motor_viscous_N_m_s_per_rad=0.0)
    p = truth_parameters(free, 1.0e-5)
    state = rest_state(p, 0.0)
    state[2] = -0.01
    stretches = []
    for k in range(20_000):  # 0.2 s in steps of 10 us
        advance(state, p, 0.0, NO_LOAD.time_ns, NO_LOAD.torque_N_m, k * 10_000, (k + 1) * 10_000, 1.0e-5)
        stretches.append(elongation(state[0], state[2], p))
    x = np.array(stretches)
    rising = np.flatnonzero((x[:-1] < 0.0) & (x[1:] >= 0.0))
    crossings = (rising + x[rising] / (x[rising] - x[rising + 1])) * 1.0e-5
    period_s = np.diff(crossings).mean()
    assert 1.0 / period_s == pytest.approx(2003.6 / (2.0 * math.pi), rel=1.0e-4)
    assert np.abs(x[-400:]).max() == pytest.approx(1.4e-3 * 0.01, rel=1.0e-3)  # nothing damps it


def test_held_load_stretches_the_wire_and_turns_the_jaw_as_derived() -> None:
    """Hold the motor by the current that balances 2 mN m; friction brings the rest to stand."""
    tau = 2.0e-3
    current = (2.0 / 1.4) * tau / 1.35e-2
    assert current == pytest.approx(0.212, abs=5.0e-4)
    start = rest_state(truth_parameters(TABLE_I, 5.0e-5), 0.0)
    state = run(TABLE_I, start, current, piecewise_linear([0.0], [tau]), SECOND_NS, 5.0e-5)
    stretch = elongation(state[0], state[2], truth_parameters(TABLE_I, 5.0e-5))
    assert stretch == pytest.approx(54.9e-6, abs=0.1e-6)
    jaw_lag_deg = math.degrees(state[2] - 2.0e-3 / 1.4e-3 * state[0])
    assert jaw_lag_deg == pytest.approx(-2.249, abs=0.001)


@pytest.mark.parametrize(("current_A", "tau_w_N_m"), [(0.3, 0.0), (0.0, 2.0e-3), (-0.2, 1.0e-3)])
def test_agrees_with_matrix_exponential(current_A: float, tau_w_N_m: float) -> None:
    start = np.array([0.1, 3.0, 0.1, -5.0])
    state = run(SMOOTH, start, current_A, piecewise_linear([0.0], [tau_w_N_m]), 10_000_000, 1.0e-5)
    np.testing.assert_allclose(state, exact(start, current_A, tau_w_N_m, 0.01), rtol=1.0e-8, atol=1.0e-9)


def test_default_step_is_accurate_to_a_thousandth_of_an_encoder_count() -> None:
    start = np.array([0.1, 3.0, 0.1, -5.0])
    state = run(SMOOTH, start, 0.3, piecewise_linear([0.0], [2.0e-3]), 10_000_000, 5.0e-5)
    error = np.abs(state - exact(start, 0.3, 2.0e-3, 0.01))
    assert error[0] < 1.0e-3 * 2.0 * math.pi / 65536


def test_order_of_convergence_is_four() -> None:
    start = np.array([0.1, 3.0, 0.1, -5.0])
    truth = exact(start, 0.3, 2.0e-3, 0.004)
    steps_s = [2.0e-4, 1.0e-4, 5.0e-5, 2.5e-5]
    errors = [
        np.abs(run(SMOOTH, start, 0.3, piecewise_linear([0.0], [2.0e-3]), 4_000_000, h) - truth).max() for h in steps_s
    ]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert orders[-1] == pytest.approx(4.0, abs=0.2)
    assert errors[0] > errors[1] > errors[2] > errors[3]


def test_order_survives_a_load_step_between_substeps() -> None:
    """A step at 1.23456 ms, on no grid; the reference is two exact solutions joined at the edge."""
    start = np.array([0.1, 3.0, 0.1, -5.0])
    edge_ns, end_ns = 1_234_560, 4_000_000
    load = piecewise_linear([edge_ns * 1e-9] * 2, [0.0, 2.0e-3])
    truth = exact(exact(start, 0.3, 0.0, edge_ns * 1e-9), 0.3, 2.0e-3, (end_ns - edge_ns) * 1e-9)
    errors = [np.abs(run(SMOOTH, start, 0.3, load, end_ns, h) - truth).max() for h in (1.0e-4, 5.0e-5, 2.5e-5)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert orders.min() > 3.5


def test_ramp_of_the_load_is_followed_inside_a_step() -> None:
    """A load that grows linearly is a forcing that RK4 takes at its stages; no staircase."""
    start = np.zeros(4)
    ramp = piecewise_linear([0.0, 0.004], [0.0, 2.0e-3])
    coarse = run(SMOOTH, start, 0.0, ramp, 4_000_000, 1.0e-4)
    fine = run(SMOOTH, start, 0.0, ramp, 4_000_000, 2.0e-6)
    held = run(SMOOTH, start, 0.0, piecewise_linear([0.0], [1.0e-3]), 4_000_000, 2.0e-6)
    assert np.abs(coarse - fine).max() < 1.0e-3 * np.abs(held - fine).max()


def test_advancing_in_pieces_is_advancing_at_once() -> None:
    start = np.array([0.1, 0.0, 0.1, 0.0])
    load = paper_load(2)
    p = truth_parameters(TABLE_I, 5.0e-5)
    whole = start.copy()
    advance(whole, p, 0.1, load.time_ns, load.torque_N_m, 10 * SECOND_NS, 10 * SECOND_NS + 20_000_000, 5.0e-5)
    pieces = start.copy()
    for k in range(20):
        at = 10 * SECOND_NS + k * 1_000_000
        advance(pieces, p, 0.1, load.time_ns, load.torque_N_m, at, at + 1_000_000, 5.0e-5)
    np.testing.assert_allclose(pieces, whole, rtol=1.0e-9)


def test_period_that_is_no_multiple_of_the_step_is_filled_by_equal_shorter_steps() -> None:
    p = truth_parameters(TABLE_I, 5.0e-5)
    state = np.array([0.1, 1.0, 0.1, 0.0])
    expected = PlantState(*state)
    advance(state, p, 0.1, NO_LOAD.time_ns, NO_LOAD.torque_N_m, 0, 125_000, 5.0e-5)
    for _ in range(3):
        expected = rk4_step(expected, p, 0.1, 0.0, 0.0, 125.0e-6 / 3)
    np.testing.assert_allclose(state, expected, rtol=1.0e-12)


def test_no_time_moves_nothing() -> None:
    p = truth_parameters(TABLE_I, 5.0e-5)
    state = np.array([0.1, 1.0, 0.1, 0.0])
    advance(state, p, 0.1, NO_LOAD.time_ns, NO_LOAD.torque_N_m, 5, 5, 5.0e-5)
    assert state.tolist() == [0.1, 1.0, 0.1, 0.0]


def test_rest_state_has_a_wire_without_tension() -> None:
    p = truth_parameters(TABLE_I, 5.0e-5)
    state = rest_state(p, math.pi / 2.0)
    assert elongation(state[0], state[2], p) == pytest.approx(0.0, abs=1.0e-18)
    advance(state, p, 0.0, NO_LOAD.time_ns, NO_LOAD.torque_N_m, 0, SECOND_NS, 5.0e-5)
    assert state[2] == pytest.approx(math.pi / 2.0, abs=1.0e-12)


def test_too_coarse_a_step_is_refused_with_the_step_that_would_do() -> None:
    with pytest.raises(ValueError, match=r"too coarse .* use 0\.00041 s or less"):
        truth_parameters(TABLE_I, 1.0e-3)
    with pytest.raises(ValueError, match="positive"):
        truth_parameters(TABLE_I, 0.0)
    with pytest.raises(ValueError, match="finite"):
        truth_parameters(TABLE_I._replace(wire_stiffness_N_per_m=math.nan), 5.0e-5)


def test_strong_friction_on_a_light_inertia_stays_stable_at_the_default_step() -> None:
    sticky = TABLE_I._replace(motor_coulomb_N_m=1.0e-3, jaw_coulomb_N_m=5.0e-4)
    p: TruthParameters = truth_parameters(sticky, 5.0e-5)
    state = np.array([0.0, 10.0, 0.0, 0.0])
    for k in range(1000):
        advance(state, p, 0.0, NO_LOAD.time_ns, NO_LOAD.torque_N_m, k * 1_000_000, (k + 1) * 1_000_000, 5.0e-5)
    assert np.abs(state[[1, 3]]).max() < 1.0e-6  # at rest, not chattering
