"""The truth plant: two inertias and an elastic wire, equations (1) to (3) of the paper, integrated by RK4.

One kernel per piece of physics, so that an effect (slack, hysteresis, ripple, ...) changes the piece it sits in. An
effect with memory adds a field to `PlantState`, its derivative to `state_rate` and its line to `moved`.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.rig.plant import PlantParameters
from virtual_bus.kernel import kernel, subroutine
from virtual_bus.plant.friction import coulomb_torque, smoothing_speed
from virtual_bus.plant.load import load_at, segment_of

# RK4 on a pole λ is stable up to |λ|·h = 2.78 and has a relative error of (|λ|·h)^5/120 a step: below 1 % at 1.
MAX_POLE_TIMES_STEP = 1.0


class TruthParameters(NamedTuple):
    """What the truth plant is made of; SI floats, symbols of Table I."""

    motor_pulley_radius_m: float  # r_m
    jaw_pulley_radius_m: float  # r_j
    motor_inertia_kg_m2: float  # I_m
    jaw_inertia_kg_m2: float  # I_j
    motor_viscous_N_m_s_per_rad: float  # D_m
    motor_coulomb_N_m: float  # τ_Fm
    jaw_coulomb_N_m: float  # τ_Fj
    wire_stiffness_N_per_m: float  # k
    torque_constant_N_m_per_A: float  # K_t
    motor_smoothing_rad_per_s: float
    jaw_smoothing_rad_per_s: float


class PlantState(NamedTuple):
    """The state of the truth plant, or its rate of change; rad and rad/s."""

    theta_m: float
    omega_m: float
    theta_j: float
    omega_j: float


def truth_parameters(plant: PlantParameters, step_s: float) -> TruthParameters:
    """Make the truth plant of a rig's numbers for steps up to `step_s`; ValueError when that is too coarse."""
    if not all(math.isfinite(number) for number in plant):
        raise ValueError("the truth plant needs finite parameters")
    if not (math.isfinite(step_s) and step_s > 0.0):
        raise ValueError(f"the plant step must be positive, not {step_s} s")
    smoothing = (
        smoothing_speed(plant.motor_coulomb_N_m, plant.motor_inertia_kg_m2, step_s),
        smoothing_speed(plant.jaw_coulomb_N_m, plant.jaw_inertia_kg_m2, step_s),
    )
    parameters = TruthParameters._make(map(float, (*plant, *smoothing)))  # ints would be another type to the compiler
    fastest = float(np.abs(np.linalg.eigvals(smooth_dynamics(parameters))).max())
    if fastest * step_s > MAX_POLE_TIMES_STEP:
        raise ValueError(
            f"a plant step of {step_s:g} s is too coarse for a mode at {fastest:.4g} 1/s; "
            f"use {MAX_POLE_TIMES_STEP / fastest:.2g} s or less"
        )
    return parameters


def smooth_dynamics(p: TruthParameters) -> NDArray[np.float64]:
    """Return the 4x4 matrix of the plant without Coulomb friction, in the order of `PlantState`."""
    r_m, r_j, k = p.motor_pulley_radius_m, p.jaw_pulley_radius_m, p.wire_stiffness_N_per_m
    I_m, I_j = p.motor_inertia_kg_m2, p.jaw_inertia_kg_m2
    return np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-k * r_m**2 / I_m, -p.motor_viscous_N_m_s_per_rad / I_m, k * r_m * r_j / I_m, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [k * r_m * r_j / I_j, 0.0, -k * r_j**2 / I_j, 0.0],
        ]
    )


def rest_state(p: TruthParameters, theta_j_rad: float) -> NDArray[np.float64]:
    """Return the state at rest, the jaw at `theta_j_rad`, the wire without tension: the array that `advance` moves."""
    return np.array([p.jaw_pulley_radius_m * theta_j_rad / p.motor_pulley_radius_m, 0.0, theta_j_rad, 0.0])


@kernel
def elongation(theta_m: float, theta_j: float, p: TruthParameters) -> float:
    """Wire elongation x in m (3)."""
    return p.motor_pulley_radius_m * theta_m - p.jaw_pulley_radius_m * theta_j


@kernel
def wire_tension(x_m: float, p: TruthParameters) -> float:
    """Tension f = k x in N; a taut pair of wires, so both signs pull."""
    return p.wire_stiffness_N_per_m * x_m


@kernel
def motor_torque(current_A: float, p: TruthParameters) -> float:
    """Electromagnetic torque of the motor, K_t·i, in N m."""
    return p.torque_constant_N_m_per_A * current_A


@kernel
def motor_friction(state: PlantState, p: TruthParameters) -> float:
    """All that brakes the motor pulley, N m: D_m·ω_m + τ_Fm."""
    return p.motor_viscous_N_m_s_per_rad * state.omega_m + coulomb_torque(
        state.omega_m, p.motor_coulomb_N_m, p.motor_smoothing_rad_per_s
    )


@kernel
def jaw_friction(state: PlantState, p: TruthParameters) -> float:
    """All that brakes the jaw, N m: τ_Fj."""
    return coulomb_torque(state.omega_j, p.jaw_coulomb_N_m, p.jaw_smoothing_rad_per_s)


@subroutine
def state_rate(state: PlantState, p: TruthParameters, current_A: float, tau_w_N_m: float) -> PlantState:
    """Time derivative of the state, (1) and (2); the interference torque τ_int of (1) is nought here."""
    tension = wire_tension(elongation(state.theta_m, state.theta_j, p), p)
    torque_m = motor_torque(current_A, p) - motor_friction(state, p) - p.motor_pulley_radius_m * tension
    torque_j = p.jaw_pulley_radius_m * tension - jaw_friction(state, p) - tau_w_N_m
    return PlantState(state.omega_m, torque_m / p.motor_inertia_kg_m2, state.omega_j, torque_j / p.jaw_inertia_kg_m2)


@kernel
def moved(state: PlantState, rate: PlantState, time_s: float) -> PlantState:
    """Return the state after `time_s` at a constant rate."""
    return PlantState(
        state.theta_m + time_s * rate.theta_m,
        state.omega_m + time_s * rate.omega_m,
        state.theta_j + time_s * rate.theta_j,
        state.omega_j + time_s * rate.omega_j,
    )


@kernel
def rk4_step(
    state: PlantState, p: TruthParameters, current_A: float, tau_w_N_m: float, tau_w_slope: float, step_s: float
) -> PlantState:
    """One classical Runge-Kutta step under a constant current and a load that grows by `tau_w_slope` N m/s."""
    half = 0.5 * step_s
    tau_mid = tau_w_N_m + tau_w_slope * half
    tau_end = tau_w_N_m + tau_w_slope * step_s
    k1 = state_rate(state, p, current_A, tau_w_N_m)
    k2 = state_rate(moved(state, k1, half), p, current_A, tau_mid)
    k3 = state_rate(moved(state, k2, half), p, current_A, tau_mid)
    k4 = state_rate(moved(state, k3, step_s), p, current_A, tau_end)
    sixth = step_s / 6.0
    state = moved(moved(state, k1, sixth), k2, 2.0 * sixth)
    return moved(moved(state, k3, 2.0 * sixth), k4, sixth)


@kernel
def advance(
    state: NDArray[np.float64],
    p: TruthParameters,
    current_A: float,
    load_time_ns: NDArray[np.int64],
    load_N_m: NDArray[np.float64],
    start_ns: int,
    end_ns: int,
    max_step_s: float,
) -> None:
    """Move `state` (array in the order of `PlantState`) in place from `start_ns` to `end_ns` of the load's own time.

    Between two breakpoints of the load the steps are equal and no longer than `max_step_s`; none crosses a
    breakpoint, so a step of the load acts at its instant and the order of the integrator survives it.
    """
    s = PlantState(state[0], state[1], state[2], state[3])
    left_ns = start_ns
    while left_ns < end_ns:
        segment = segment_of(load_time_ns, left_ns)
        right_ns = end_ns if segment == load_time_ns.size else min(end_ns, load_time_ns[segment])
        span_s = (right_ns - left_ns) * 1.0e-9
        load = load_at(load_time_ns, load_N_m, segment, left_ns)
        slope = (load_at(load_time_ns, load_N_m, segment, right_ns) - load) / span_s
        steps = max(math.ceil(span_s / max_step_s - 1.0e-6), 1)  # 1e-3/5e-5 is 20, whatever the last bit says
        step_s = span_s / steps
        for i in range(steps):
            s = rk4_step(s, p, current_A, load + slope * (i * step_s), slope, step_s)
        left_ns = right_ns
    state[0], state[1], state[2], state[3] = s.theta_m, s.omega_m, s.theta_j, s.omega_j
