"""Single steps of the estimators by number, for loops that run compiled."""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.estimation import improved, kalman, previous
from hil_forceps.estimation.interface import State
from hil_forceps.model.kernel import kernel

Vector = NDArray[np.float64]

PREVIOUS, IMPROVED, KALMAN = range(3)


@kernel
def start_kind(kind: int, c: Vector, time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """Return the state after the first sample, of the kernels that `kind` names."""
    if kind == PREVIOUS:
        return previous.start(c, time_ns, theta_m_rad, motor_torque_N_m)
    if kind == IMPROVED:
        return improved.start(c, time_ns, theta_m_rad, motor_torque_N_m)
    return kalman.start(c, time_ns, theta_m_rad, motor_torque_N_m)


@kernel
def step_kind(state: State, kind: int, c: Vector, time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """Return the state after a further sample, of the kernels that `kind` names."""
    if kind == PREVIOUS:
        return previous.step(state, c, time_ns, theta_m_rad, motor_torque_N_m)
    if kind == IMPROVED:
        return improved.step(state, c, time_ns, theta_m_rad, motor_torque_N_m)
    return kalman.step(state, c, time_ns, theta_m_rad, motor_torque_N_m)
