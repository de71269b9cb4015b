"""A whole record through an estimator: the kernels of single steps in a compiled loop, with the same results."""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.estimation.interface import ELONGATION, TAU_W, Estimator, Sample
from hil_forceps.estimation.kernel import kernel
from hil_forceps.estimation.kernel_function import KernelFunction

Vector = NDArray[np.float64]


@kernel
def _run(
    start: KernelFunction,
    step: KernelFunction,
    c: Vector,
    time_ns: NDArray[np.int64],
    theta_m_rad: Vector,
    motor_torque_N_m: Vector,
) -> tuple[Vector, Vector]:
    samples = time_ns.shape[0]
    tau_w = np.empty(samples)
    elongation = np.empty(samples)
    state = start(c, time_ns[0], theta_m_rad[0], motor_torque_N_m[0])
    for n in range(samples):
        if n > 0:
            state = step(state, c, time_ns[n], theta_m_rad[n], motor_torque_N_m[n])
        tau_w[n] = state[TAU_W]
        elongation[n] = state[ELONGATION]
    return tau_w, elongation


def run(
    estimator: Estimator, time_ns: NDArray[np.int64], theta_m_rad: Vector, motor_torque_N_m: Vector
) -> tuple[Vector, Vector]:
    """Return τ̂_w [N m] and x̂ [m] at each sample, bit for bit as by single steps.

    All arrays are n long, n ≥ 1; ValueError otherwise.
    """
    if not time_ns.shape == theta_m_rad.shape == motor_torque_N_m.shape or time_ns.ndim != 1 or not time_ns.size:
        raise ValueError(
            f"time, angle and torque must be of one length above 0, got {time_ns.shape}, {theta_m_rad.shape}, "
            f"{motor_torque_N_m.shape}"
        )
    times = np.ascontiguousarray(time_ns, dtype=np.int64)
    angles = np.ascontiguousarray(theta_m_rad, dtype=np.float64)
    torques = np.ascontiguousarray(motor_torque_N_m, dtype=np.float64)
    if estimator.compiled is not None:
        return _run(*estimator.compiled, times, angles, torques)
    if estimator.record is not None:
        return estimator.record(times, angles, torques)
    samples = map(Sample, times.tolist(), angles.tolist(), torques.tolist())
    state = estimator.start(next(samples))
    estimates = [estimator.estimate(state)]
    for sample in samples:
        state = estimator.step(state, sample)
        estimates.append(estimator.estimate(state))
    tau_w, elongation = np.array(estimates).T
    return tau_w, elongation
