"""The previous algorithm (the paper's section III): RFOB on (1) for the wire's tension, then (8) and (9).

It assumes that τ_m and τ_w are constant while the wire settles. When the load steps, it multiplies the transient of the
tension by (r_m²/r_j)(I_j/I_m) + r_j, which causes its spikes.
"""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.estimation.algorithms.rfob import observe, sign
from hil_forceps.estimation.interface import Algorithm, Estimator, State, estimator_of_kernels
from hil_forceps.estimation.kernel import kernel
from hil_forceps.model.linear.two_inertia import wire_mode_squared
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.schema import Rig

TIME, ANGLE, LOW_PASS = range(3)  # then TAU_W and ELONGATION of `interface`
_RM, _RJ, _IM, _IJ, _DM, _FM, _FJ, _A, _CORNER = range(9)


def constants(plant: PlantParameters, corner_rad_per_s: float) -> NDArray[np.float64]:
    """Return the constants of `step`."""
    return np.array(
        [
            plant.motor_pulley_radius_m,
            plant.jaw_pulley_radius_m,
            plant.motor_inertia_kg_m2,
            plant.jaw_inertia_kg_m2,
            plant.motor_viscous_N_m_s_per_rad,
            plant.motor_coulomb_N_m,
            plant.jaw_coulomb_N_m,
            wire_mode_squared(plant),
            corner_rad_per_s,
        ]
    )


@kernel
def _estimate(
    c: NDArray[np.float64], known_N_m: float, reaction_N_m: float, jaw_friction_N_m: float
) -> tuple[float, float]:
    """Return τ̂_w by (8) and x̂ by (9); `reaction_N_m` is r_m f̂."""
    r_m, r_j, I_m, I_j = c[_RM], c[_RJ], c[_IM], c[_IJ]
    tension = reaction_N_m / r_m
    inertia_ratio = I_j / I_m
    tau_w = tension * (r_m * r_m / r_j * inertia_ratio + r_j) - jaw_friction_N_m - r_m / r_j * inertia_ratio * known_N_m
    elongation = (r_m / I_m * known_N_m + r_j / I_j * (jaw_friction_N_m + tau_w)) / c[_A]
    return tau_w, elongation


@kernel
def start(c: NDArray[np.float64], time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """Return the state of a forceps at rest: the wire carries the motor's torque."""
    tau_w, elongation = _estimate(c, motor_torque_N_m, motor_torque_N_m, 0.0)
    return np.array([float(time_ns), theta_m_rad, motor_torque_N_m, tau_w, elongation])


@kernel
def step(state: State, c: NDArray[np.float64], time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """Return the state after a sample; the same state when its stamp isn't later than the last."""
    dt_s = (time_ns - state[TIME]) * 1e-9
    if dt_s <= 0.0:
        return state
    velocity = (theta_m_rad - state[ANGLE]) / dt_s
    direction = sign(velocity)
    known = motor_torque_N_m - c[_DM] * velocity - c[_FM] * direction
    low_pass, reaction = observe(state[LOW_PASS], known, velocity, c[_IM], c[_CORNER], dt_s)
    tau_w, elongation = _estimate(c, known, reaction, c[_FJ] * direction)
    return np.array([float(time_ns), theta_m_rad, low_pass, tau_w, elongation])


def _make(rig: Rig, sample_time_s: float, over_wire: bool) -> Estimator:  # noqa: ARG001 - what `Algorithm.make` takes
    corner_rad_per_s = 2.0 * math.pi * rig.estimators.rfob_cutoff_Hz
    return estimator_of_kernels("previous", start, step, constants(rig.plant(), corner_rad_per_s))


ALGORITHMS = (Algorithm("previous", _make),)
