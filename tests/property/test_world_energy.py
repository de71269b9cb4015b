"""Energy in the world: friction takes and never gives; what goes in is stored or dissipated."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_forceps.rig.plant import PlantParameters
from virtual_bus.plant.friction import SMOOTHING_SPEED_RAD_PER_S, coulomb_torque, smoothing_speed
from virtual_bus.plant.load import piecewise_linear
from virtual_bus.plant.plant import (
    PlantState,
    TruthParameters,
    advance,
    elongation,
    jaw_friction,
    motor_friction,
    motor_torque,
    truth_parameters,
    wire_tension,
)

TABLE_I = PlantParameters(2.00e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.60e4, 1.35e-2)
NO_LOAD = piecewise_linear([0.0], [0.0])
SPEEDS = st.floats(-1.0e6, 1.0e6)
LEVELS = st.floats(0.0, 10.0)
SMOOTHINGS = st.floats(1.0e-6, 10.0)


def energy_J(state: PlantState, p: TruthParameters) -> float:
    """Kinetic energy of both inertias and the elastic energy of the wire."""
    x = elongation(state.theta_m, state.theta_j, p)
    kinetic = p.motor_inertia_kg_m2 * state.omega_m**2 + p.jaw_inertia_kg_m2 * state.omega_j**2
    return 0.5 * (kinetic + wire_tension(x, p) * x)


@given(SPEEDS, LEVELS, SMOOTHINGS)
def test_friction_opposes_motion_and_never_exceeds_its_level(speed: float, level: float, smoothing: float) -> None:
    torque = coulomb_torque(speed, level, smoothing)
    assert torque * speed >= 0.0
    assert abs(torque) <= level * (1.0 + 1.0e-12)
    assert coulomb_torque(-speed, level, smoothing) == -torque


@given(st.floats(0.2, 1.0e6), LEVELS)
def test_friction_is_full_at_the_speeds_of_the_paper(speed: float, level: float) -> None:
    assert coulomb_torque(speed, level, SMOOTHING_SPEED_RAD_PER_S) == pytest.approx(level, rel=2.0e-5)


@given(st.floats(1.0e-9, 10.0), st.floats(1.0e-9, 1.0e-2), st.floats(1.0e-6, 1.0e-3))
def test_smoothing_keeps_the_friction_pole_within_the_step(level: float, inertia: float, step: float) -> None:
    slope_per_s = level / (inertia * smoothing_speed(level, inertia, step))
    assert slope_per_s * step <= 1.0 + 1.0e-12


STATES = st.builds(
    PlantState, st.floats(-1.0, 1.0), st.floats(-50.0, 50.0), st.floats(-1.0, 1.0), st.floats(-50.0, 50.0)
)


@given(STATES, st.floats(0.0, 1.0e-4), st.floats(0.0, 1.0e-4))
def test_all_friction_of_the_plant_takes_power(state: PlantState, motor_N_m: float, jaw_N_m: float) -> None:
    p = truth_parameters(TABLE_I._replace(motor_coulomb_N_m=motor_N_m, jaw_coulomb_N_m=jaw_N_m), 5.0e-5)
    assert motor_friction(state, p) * state.omega_m >= 0.0
    assert jaw_friction(state, p) * state.omega_j >= 0.0


@settings(max_examples=40, deadline=None)
@given(STATES, st.floats(0.0, 1.0e-4), st.floats(0.0, 1.0e-4))
def test_a_forceps_left_alone_never_gains_energy(start: PlantState, motor_N_m: float, jaw_N_m: float) -> None:
    plant = TABLE_I._replace(motor_coulomb_N_m=motor_N_m, jaw_coulomb_N_m=jaw_N_m, motor_viscous_N_m_s_per_rad=1.0e-6)
    p = truth_parameters(plant, 5.0e-5)
    state = np.array(start)
    before = first = energy_J(start, p)
    for k in range(200):
        advance(state, p, 0.0, NO_LOAD.time_ns, NO_LOAD.torque_N_m, k * 50_000, (k + 1) * 50_000, 5.0e-5)
        after = energy_J(PlantState(*state.tolist()), p)
        assert after <= before + 1.0e-9 * first
        before = after


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.5, 0.5), st.floats(-2.0e-3, 2.0e-3), st.floats(0.0, 1.0e-5), STATES)
def test_work_put_in_is_stored_or_dissipated(
    current_A: float, tau_w_N_m: float, coulomb_N_m: float, start: PlantState
) -> None:
    """dE/dt = τ_m ω_m − τ_w ω_j − (all friction)·ω, integrated by Simpson's rule over 5 ms of fine steps."""
    p = truth_parameters(TABLE_I._replace(motor_coulomb_N_m=coulomb_N_m, jaw_coulomb_N_m=coulomb_N_m), 5.0e-6)
    load = piecewise_linear([0.0], [tau_w_N_m])
    step_ns, steps = 5_000, 1000
    state = np.array(start)
    power_W = []
    for k in range(steps + 1):
        s = PlantState(*state.tolist())
        dissipated = motor_friction(s, p) * s.omega_m + jaw_friction(s, p) * s.omega_j
        power_W.append(motor_torque(current_A, p) * s.omega_m - tau_w_N_m * s.omega_j - dissipated)
        if k < steps:
            advance(state, p, current_A, load.time_ns, load.torque_N_m, k * step_ns, (k + 1) * step_ns, 5.0e-6)
    weights = np.ones(steps + 1)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    work_J = float(np.dot(weights, power_W)) * step_ns * 1.0e-9 / 3.0
    stored_J = energy_J(s, p) - energy_J(start, p)
    scale_J = energy_J(start, p) + float(np.abs(power_W).max()) * steps * step_ns * 1.0e-9
    assert math.isclose(stored_J, work_J, abs_tol=1.0e-6 * scale_J + 1.0e-15)
