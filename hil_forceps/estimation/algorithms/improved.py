"""The improved algorithm (the paper's section IV), literally as published and in a stable form.

RFOB on (5), whose inertia is that of motor and jaw together, gives τ̂_ex (11); x̂ is (13). A model of the wire (15)
with a free acceleration α runs in parallel, and α descends the gradient of ½(x̂ − x_n)² (16), (19); τ̂_w is (20).

As published, (15) is integrated by explicit Euler (17) with h = T/2, and α is updated twice a sample. Each step
multiplies the undamped oscillation by √(1 + h²A) > 1, so x_n, α and τ̂_w overflow; x̂ doesn't depend on them.

In the stable form only the integration differs: first the velocity is updated, then the position with the new velocity
(symplectic Euler), in as many steps as keep h√A ≤ 1. The update of α is the published one: no h makes it matter
(docs/estimators.md).
"""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.estimation.algorithms.rfob import observe, sign
from hil_forceps.estimation.interface import Algorithm, Estimator, State, estimator_of_kernels
from hil_forceps.estimation.kernel import kernel, subroutine
from hil_forceps.model.linear.two_inertia import total_inertia_kg_m2, wire_mode_squared
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.schema import Rig

TIME, ANGLE, LOW_PASS = range(3)  # then TAU_W and ELONGATION of `interface`
MODEL_X, MODEL_V, ALPHA = range(5, 8)
_RM, _RJ, _IM, _IJ, _DM, _FM, _FJ, _A, _CORNER, _INERTIA, _STABLE = range(11)

# 0 < η ≤ 1 in (19): the largest step that the paper allows.
_ETA = 1.0
# After a longer gap the model of the wire starts again at x̂. Bounds the steps of a sample.
_MAX_GAP_S = 0.1


def constants(plant: PlantParameters, corner_rad_per_s: float, *, as_published: bool) -> NDArray[np.float64]:
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
            total_inertia_kg_m2(plant),
            0.0 if as_published else 1.0,
        ]
    )


@subroutine
def _elongation(c: NDArray[np.float64], known_N_m: float, tau_ex_N_m: float, jaw_friction_N_m: float) -> float:
    """Return x̂ = (B + C τ̂_ex)/A, (13)."""
    b = c[_RM] / c[_IM] * known_N_m + c[_RJ] / c[_IJ] * jaw_friction_N_m
    return float((b + c[_RJ] * c[_RJ] / (c[_RM] * c[_IJ]) * tau_ex_N_m) / c[_A])


@subroutine
def _run_published(x_hat: float, x: float, v: float, alpha: float, a: float, dt_s: float) -> tuple[float, float, float]:
    """Return x_n, ẋ_n and α after a sample: (15), (17), (19), twice with h = T/2."""
    h = 0.5 * dt_s
    for _ in range(2):
        # B + C τ̂_ex of (15) is A x̂ by (13).
        acceleration = a * (x_hat - x) + alpha
        x = x + h * v
        v = v + h * acceleration
        alpha = alpha + _ETA * h * h * (x_hat - x)
    return x, v, alpha


@subroutine
def _run_stable(x_hat: float, x: float, v: float, alpha: float, a: float, dt_s: float) -> tuple[float, float, float]:
    """Return x_n, ẋ_n and α after a sample, by symplectic Euler."""
    if dt_s > _MAX_GAP_S:
        return x_hat, 0.0, alpha
    steps = max(2, math.ceil(dt_s * math.sqrt(a)))
    h = dt_s / steps
    for _ in range(steps):
        v = v + h * (a * (x_hat - x) + alpha)
        x = x + h * v
        alpha = alpha + _ETA * h * h * (x_hat - x)
    return x, v, alpha


@kernel
def start(c: NDArray[np.float64], time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """Return the state of a forceps at rest: the wire carries the motor's torque."""
    x_hat = _elongation(c, motor_torque_N_m, motor_torque_N_m, 0.0)
    tau_w = c[_RJ] / c[_RM] * motor_torque_N_m
    return np.array([float(time_ns), theta_m_rad, motor_torque_N_m, tau_w, x_hat, x_hat, 0.0, 0.0])


@kernel
def step(state: State, c: NDArray[np.float64], time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """Return the state after a sample; the same state when its stamp isn't later than the last."""
    dt_s = (time_ns - state[TIME]) * 1e-9
    if dt_s <= 0.0:
        return state
    velocity = (theta_m_rad - state[ANGLE]) / dt_s
    direction = sign(velocity)
    known = motor_torque_N_m - c[_DM] * velocity - c[_FM] * direction
    jaw_friction = c[_FJ] * direction
    low_pass, tau_ex = observe(
        state[LOW_PASS], known - c[_RM] / c[_RJ] * jaw_friction, velocity, c[_INERTIA], c[_CORNER], dt_s
    )
    x_hat = _elongation(c, known, tau_ex, jaw_friction)
    if c[_STABLE] > 0.0:
        x, v, alpha = _run_stable(x_hat, state[MODEL_X], state[MODEL_V], state[ALPHA], c[_A], dt_s)
    else:
        x, v, alpha = _run_published(x_hat, state[MODEL_X], state[MODEL_V], state[ALPHA], c[_A], dt_s)
    tau_w = c[_RJ] / c[_RM] * tau_ex + c[_IJ] / c[_RJ] * alpha
    return np.array([float(time_ns), theta_m_rad, low_pass, tau_w, x_hat, x, v, alpha])


def _make(rig: Rig, sample_time_s: float, over_wire: bool) -> Estimator:  # noqa: ARG001 - what `Algorithm.make` takes
    corner_rad_per_s = 2.0 * math.pi * rig.estimators.rfob_cutoff_Hz
    numbers = constants(rig.plant(), corner_rad_per_s, as_published=False)
    return estimator_of_kernels("improved", start, step, numbers)


def _make_as_published(rig: Rig, sample_time_s: float, over_wire: bool) -> Estimator:  # noqa: ARG001 - as above
    corner_rad_per_s = 2.0 * math.pi * rig.estimators.rfob_cutoff_Hz
    numbers = constants(rig.plant(), corner_rad_per_s, as_published=True)
    return estimator_of_kernels("improved_as_published", start, step, numbers)


ALGORITHMS = (
    Algorithm("improved_as_published", _make_as_published),
    Algorithm("improved", _make, corrected=True),
)
