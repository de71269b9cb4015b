"""The covariance of the state a row on."""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.kernel import inlined, subroutine
from hil_forceps.diagnosis.state_space.layout import (
    COMMAND_ERROR,
    CURRENT_NOISE,
    FRICTION_M,
    INTEGRAL_ERROR,
    JAW_NOISE,
    LOAD,
    LOAD_NOISE,
    LOAD_SLOPE,
    OMEGA_J,
    OMEGA_M,
    PLANT_STATES,
    RECORDED_STATES,
    STATES,
    Series,
)

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@subroutine
def moved(f: Matrix, covariance: Matrix, kept: Vector, current_slope: float, work: Matrix) -> None:
    """Replace a covariance by F P Fᵀ.

    `kept`: how much of each state beyond the plant's is kept meanwhile; `current_slope` as in `Filtered`.
    """
    if covariance.shape[0] == RECORDED_STATES:  # of a size that the compiler knows, in half the time
        _moved(f, covariance, kept, current_slope, work, RECORDED_STATES)
    elif covariance.shape[0] == STATES:
        _moved(f, covariance, kept, current_slope, work, STATES)
    else:
        _moved(f, covariance, kept, current_slope, work, covariance.shape[0])


@inlined
def _moved(f: Matrix, covariance: Matrix, kept: Vector, current_slope: float, work: Matrix, states: int) -> None:
    for j in range(states):
        for i in range(states):
            work[i, j] = _carried(f, covariance[j], i, kept, current_slope)
    for i in range(states):
        for j in range(i, states):
            covariance[i, j] = _carried(f, work[i], j, kept, current_slope)
            covariance[j, i] = covariance[i, j]


@subroutine
def _carried(f: Matrix, x: Vector, i: int, kept: Vector, current_slope: float) -> float:
    """Return entry i of F x."""
    if i <= LOAD:
        total: float = current_slope * f[i, COMMAND_ERROR] * x[COMMAND_ERROR]
        for m in range(COMMAND_ERROR):  # it is the last coupled state
            total += f[i, m] * x[m]
        return total
    value: float = kept[i] * x[i]
    return value


@inlined
def spread(covariance: Matrix, f: Matrix, column: int, variance: float) -> None:
    """Add what an input of this variance, held over a row, does to the plant."""
    for i in range(PLANT_STATES):
        for j in range(PLANT_STATES):
            covariance[i, j] += variance * f[i, column] * f[j, column]


@inlined
def disturbed(covariance: Matrix, d: Series, row: int, f: Matrix, jump: Matrix, torque_constant: float) -> None:
    """Add the process noise of a row: integration, command, load, sensors' coloured noise."""
    covariance[OMEGA_M, OMEGA_M] += d.speed_variance[0]
    covariance[OMEGA_J, OMEGA_J] += d.speed_variance[1]
    covariance[LOAD_SLOPE, LOAD_SLOPE] += d.load_slope_variance[row]
    integral = COMMAND_ERROR if d.states == RECORDED_STATES else INTEGRAL_ERROR
    covariance[integral, integral] += d.integral_variance[row]
    if d.command_variance[row] > 0.0:
        spread(covariance, f, FRICTION_M, d.command_variance[row] * torque_constant * torque_constant)
    if d.load_jump_variance[row] > 0.0:
        for i in range(LOAD + 1):
            for j in range(LOAD + 1):
                covariance[i, j] += d.load_jump_variance[row] * jump[i, j]
    states = (JAW_NOISE, LOAD_NOISE, CURRENT_NOISE)
    for channel in range(3):
        kept = d.noise_correlation[channel]
        if kept != 0.0:
            covariance[states[channel], states[channel]] += d.noise_variance[channel] * (1.0 - kept * kept)


@subroutine
def forgotten(covariance: Matrix, state: int) -> None:
    """Take a state as known: nothing is left open of it."""
    covariance[state, :] = 0.0
    covariance[:, state] = 0.0


@inlined
def freed(covariance: Matrix, state: int, level_N_m: float, kept: float) -> None:
    """Add what a friction torque may change by over a row: it wanders within about ± its level."""
    covariance[state, state] += level_N_m * level_N_m * (1.0 - kept * kept)
