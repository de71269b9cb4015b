"""Where the truth plant with effects begins: the state at rest, and whether a step is fine enough."""

import numpy as np
from numpy.typing import NDArray

from virtual_bus.effects.numbers import EffectNumbers
from virtual_bus.effects.physics import elongation_of
from virtual_bus.plant.plant import MAX_POLE_TIMES_STEP, TruthParameters, smooth_dynamics

STATE = (
    "theta_m", "omega_m", "theta_j", "omega_j", "creep", "presliding", "hysteresis", "side_m", "side_j",
    "target_A", "current_A", "behind", "loaded", "gripped",
)  # fmt: skip


def rest_with_effects(p: TruthParameters, e: EffectNumbers, theta_j_rad: float) -> NDArray[np.float64]:
    """Return the state at rest, the jaw at `theta_j_rad`, the wire without tension, nothing remembered."""
    theta_m = (p.jaw_pulley_radius_m * theta_j_rad + e.stretch) / p.motor_pulley_radius_m
    for _ in range(50):  # the radius varies by far less than itself, so this converges
        theta_m -= (elongation_of(theta_m, theta_j_rad, p, e) - e.stretch) / p.motor_pulley_radius_m
    state = np.zeros(len(STATE))
    state[0], state[2] = theta_m, theta_j_rad
    return state


def check_step(p: TruthParameters, e: EffectNumbers, current_limit_A: float, step_s: float) -> None:
    """ValueError when a step is too coarse for what effects add to stiffness and damping, up to the drive's limit.

    Memories and the lag of the current are exact at any step; what has a time constant of 10 ms or more is no matter.
    """
    force = p.torque_constant_N_m_per_A * current_limit_A / p.motor_pulley_radius_m
    linear = force / p.wire_stiffness_N_per_m
    stretches = np.roots([e.beta, 0.0, 1.0, -linear]) if e.beta > 0.0 else np.array([linear])
    stretch = float(np.abs(stretches[np.abs(stretches.imag).argmin()]))
    stiffness = p.wire_stiffness_N_per_m * (1.0 + 3.0 * e.beta * stretch**2)
    stiffness += e.hysteresis_force / e.hysteresis_stretch
    matrix = smooth_dynamics(p._replace(wire_stiffness_N_per_m=stiffness))
    matrix[1, 0] -= e.presliding_level / e.presliding_angle / p.motor_inertia_kg_m2
    pulled = e.loaded_mu * p.torque_constant_N_m_per_A * current_limit_A
    matrix[1, 0] -= pulled / e.loaded_angle / p.motor_inertia_kg_m2
    matrix[1, 1] -= (abs(e.viscous_asymmetry) + e.film_level / e.film_speed) / p.motor_inertia_kg_m2
    held = e.grip_level + e.grip_mu * p.jaw_pulley_radius_m * force
    matrix[3, 3] -= e.jaw_viscous / p.jaw_inertia_kg_m2
    matrix[3, 2] -= (e.coupling_stiffness + held / e.grip_angle) / p.jaw_inertia_kg_m2
    ways = np.array([p.motor_pulley_radius_m, -p.jaw_pulley_radius_m])
    inertias = np.array([p.motor_inertia_kg_m2, p.jaw_inertia_kg_m2])
    matrix[np.ix_([1, 3], [1, 3])] -= e.damping * np.outer(ways, ways) / inertias[:, np.newaxis]
    fastest = float(np.abs(np.linalg.eigvals(matrix)).max())
    if fastest * step_s > MAX_POLE_TIMES_STEP:
        raise ValueError(
            f"a plant step of {step_s:g} s is too coarse for the effects, which make a mode at {fastest:.4g} 1/s; "
            f"use {MAX_POLE_TIMES_STEP / fastest:.2g} s or less"
        )
