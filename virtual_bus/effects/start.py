"""Where the truth plant with effects begins: the state at rest, and whether a step is fine enough."""

import numpy as np
from numpy.typing import NDArray

from virtual_bus.effects.composition import EffectNumbers
from virtual_bus.effects.physics import elongation_of
from virtual_bus.plant.plant import MAX_POLE_TIMES_STEP, TruthParameters, smooth_dynamics

STATE = (
    "theta_m", "omega_m", "theta_j", "omega_j", "creep", "presliding", "hysteresis", "side_m", "side_j",
    "target_A", "current_A", "behind", "loaded", "gripped",
)  # fmt: skip


def rest_with_effects(p: TruthParameters, e: EffectNumbers, theta_j_rad: float) -> NDArray[np.float64]:
    """Return the state at rest, the jaw at `theta_j_rad`, the wire without tension, nothing remembered."""
    theta_m = (p.jaw_pulley_radius_m * theta_j_rad + e.wire_permanent_stretch_stretch_m) / p.motor_pulley_radius_m
    for _ in range(50):  # the radius varies by far less than itself, so this converges
        theta_m -= (
            elongation_of(theta_m, theta_j_rad, p, e) - e.wire_permanent_stretch_stretch_m
        ) / p.motor_pulley_radius_m
    state = np.zeros(len(STATE))
    state[0], state[2] = theta_m, theta_j_rad
    return state


def check_step(p: TruthParameters, e: EffectNumbers, current_limit_A: float, step_s: float) -> None:
    """ValueError when a step is too coarse for what effects add to stiffness and damping, up to the drive's limit.

    Memories and the lag of the current are exact at any step; what has a time constant of 10 ms or more is no matter.
    """
    force = p.torque_constant_N_m_per_A * current_limit_A / p.motor_pulley_radius_m
    linear = force / p.wire_stiffness_N_per_m
    stretches = (
        np.roots([e.wire_hardening_beta_per_m2, 0.0, 1.0, -linear])
        if e.wire_hardening_beta_per_m2 > 0.0
        else np.array([linear])
    )
    stretch = float(np.abs(stretches[np.abs(stretches.imag).argmin()]))
    stiffness = p.wire_stiffness_N_per_m * (1.0 + 3.0 * e.wire_hardening_beta_per_m2 * stretch**2)
    stiffness += e.wire_hysteresis_force_N / e.wire_hysteresis_stretch_m
    matrix = smooth_dynamics(p._replace(wire_stiffness_N_per_m=stiffness))
    matrix[1, 0] -= e.presliding_friction_level_N_m / e.presliding_friction_angle_rad / p.motor_inertia_kg_m2
    pulled = e.loaded_presliding_mu * p.torque_constant_N_m_per_A * current_limit_A
    matrix[1, 0] -= pulled / e.loaded_presliding_angle_rad / p.motor_inertia_kg_m2
    matrix[1, 1] -= (
        abs(e.viscous_asymmetry_difference_N_m_s_per_rad) + e.film_friction_level_N_m / e.film_friction_speed_rad_per_s
    ) / p.motor_inertia_kg_m2
    held = e.jaw_presliding_level_N_m + e.jaw_presliding_mu * p.jaw_pulley_radius_m * force
    matrix[3, 3] -= e.jaw_viscous_friction_viscosity_N_m_s_per_rad / p.jaw_inertia_kg_m2
    matrix[3, 2] -= (e.jaw_coupling_stiffness_N_m_per_rad + held / e.jaw_presliding_angle_rad) / p.jaw_inertia_kg_m2
    ways = np.array([p.motor_pulley_radius_m, -p.jaw_pulley_radius_m])
    inertias = np.array([p.motor_inertia_kg_m2, p.jaw_inertia_kg_m2])
    matrix[np.ix_([1, 3], [1, 3])] -= e.wire_damping_damping_N_s_per_m * np.outer(ways, ways) / inertias[:, np.newaxis]
    fastest = float(np.abs(np.linalg.eigvals(matrix)).max())
    if fastest * step_s > MAX_POLE_TIMES_STEP:
        raise ValueError(
            f"a plant step of {step_s:g} s is too coarse for the effects, which make a mode at {fastest:.4g} 1/s; "
            f"use {MAX_POLE_TIMES_STEP / fastest:.2g} s or less"
        )
