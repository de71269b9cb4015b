"""What the sensors show of a state, and how a measurement changes state and covariance."""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.interval import interval_likelihood
from hil_forceps.diagnosis.state_space.kernel import inlined, subroutine
from hil_forceps.diagnosis.state_space.layout import (
    COMMAND_ERROR,
    CURRENT,
    CURRENT_NOISE,
    ENCODER,
    JAW,
    JAW_NOISE,
    JAW_ZERO,
    LOAD,
    LOAD_CELL,
    LOAD_NOISE,
    LOAD_SLOPE,
    OMEGA_J,
    OMEGA_M,
    RECORDED_STATES,
    THETA_J,
    THETA_M,
    Series,
)
from hil_forceps.model.composition import Physics, encoder_rad

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Flags = NDArray[np.bool_]

WHITE_SHARE = 0.01  # of coloured noise


@inlined
def late_s(p: Physics, d: Series, channel: int) -> float:
    """Return what whole rows leave of a channel's skew: how late its values are at their rows."""
    if channel == ENCODER:
        skew_s: float = p.channel_skew_theta_m_s
    elif channel == JAW:
        skew_s = p.channel_skew_theta_j_s
    elif channel == LOAD_CELL:
        skew_s = p.channel_skew_tau_w_s
    else:
        skew_s = p.channel_skew_current_s
    left: float = skew_s - d.shifted_s[channel]
    return left


@inlined
def predicted(p: Physics, d: Series, channel: int, x: Vector, current_A: float, before_A: float) -> float:
    """Return what a channel shows of state `x`; `current_A`: in the motor at the row, `before_A`: a row earlier.

    A skewed channel shows what was, to first order in what whole rows leave of its skew.
    """
    late = late_s(p, d, channel)
    if channel == ENCODER:
        shown: float = encoder_rad(p, x[THETA_M]) - late * x[OMEGA_M]
    elif channel == JAW:
        shown = x[THETA_J] + x[JAW_ZERO] + x[JAW_NOISE] - late * x[OMEGA_J]
    elif channel == LOAD_CELL:
        shown = x[LOAD] + x[LOAD_NOISE] - late * x[LOAD_SLOPE]
    else:
        recorded_A = current_A - late / d.period_s * (current_A - before_A)
        shown = (1.0 + p.current_gain_relative_error) * recorded_A + p.current_offset_offset_A + x[CURRENT_NOISE]
    return shown


@inlined
def measured(d: Series, channel: int, row: int) -> float:
    """Return what a channel showed; NaN where it was not measured."""
    if channel == ENCODER:
        value: float = d.encoder_rad[row]
    elif channel == JAW:
        value = d.jaw_rad[row]
    elif channel == LOAD_CELL:
        value = d.load_N_m[row]
    else:
        value = d.current_A[row]
    return value


@subroutine
def direction(channel: int, late: float, covariance: Matrix, out: Vector) -> float:
    """Fill `out` with the covariance of the state and what a channel shows; return the variance of the latter.

    `late`: as of `late_s`; the current has a function of its own.
    """
    first, second, third, slope = THETA_M, THETA_M, THETA_M, OMEGA_M
    if channel == JAW:
        first, second, third, slope = THETA_J, JAW_ZERO, JAW_NOISE, OMEGA_J
    elif channel == LOAD_CELL:
        first, second, third, slope = LOAD, LOAD_NOISE, LOAD_NOISE, LOAD_SLOPE
    for i in range(out.size):
        value = covariance[i, first]
        if channel != ENCODER:
            value += covariance[i, second]
        if channel == JAW:
            value += covariance[i, third]
        if late != 0.0:
            value -= late * covariance[i, slope]
        out[i] = value
    variance: float = out[first]
    if channel != ENCODER:
        variance += out[second]
    if channel == JAW:
        variance += out[third]
    if late != 0.0:
        variance -= late * out[slope]
    return variance


@inlined
def white_variance(d: Series, channel: int) -> float:
    """Return the variance of what is white of a sensor's noise.

    Of coloured noise it is a hundredth: the filter's division needs some.
    """
    white: float = d.noise_variance[channel - 1] * (1.0 if d.noise_correlation[channel - 1] == 0.0 else WHITE_SHARE)
    return white


@inlined
def new_current_variance(p: Physics, d: Series) -> float:
    """Return the variance [A²] of what is new of the current sensor's noise at a row, as an error of the current."""
    coloured = d.noise_variance[2] * (1.0 - d.noise_correlation[2] ** 2) if d.noise_correlation[2] != 0.0 else 0.0
    gain = 1.0 + p.current_gain_relative_error
    variance: float = (coloured + white_variance(d, CURRENT) + d.resolution[2] ** 2 / 12.0) / (gain * gain)
    return variance


@inlined
def evidence(d: Series, channel: int, row: int, shown: float, variance: float) -> tuple[float, float, float]:
    """Return log likelihood of a measurement, its score in what was predicted, and its information about that."""
    value = measured(d, channel, row)
    if channel == ENCODER:
        total = max(0.0, variance) + d.encoder_variance[row]
        if d.count_rad > 0.0:
            half = 0.5 * d.count_rad
            return interval_likelihood(value - half, value + half, shown, math.sqrt(total))
    else:
        total = max(0.0, variance) + white_variance(d, channel)
        half = 0.5 * d.resolution[channel - 1]
        if half > 0.0:
            return interval_likelihood(value - half, value + half, shown, math.sqrt(total))
    error = value - shown
    return -0.5 * (error * error / total + math.log(total)), error / total, 1.0 / total


@subroutine
def current_direction(covariance: Matrix, gain: float, out: Vector) -> float:
    """Fill `out` as `direction` does for the measured current: the error of the command, and the sensor's noise."""
    for i in range(out.size):
        out[i] = gain * covariance[i, COMMAND_ERROR] + covariance[i, CURRENT_NOISE]
    variance: float = gain * out[COMMAND_ERROR] + out[CURRENT_NOISE]
    return variance


@subroutine
def corrected(x: Vector, covariance: Matrix, along: Vector, score: float, information: float) -> None:
    """Change state and covariance by a measurement."""
    if x.size == RECORDED_STATES:  # of a size that the compiler knows, in half the time
        _corrected(x, covariance, along, score, information, RECORDED_STATES)
    else:
        _corrected(x, covariance, along, score, information, x.size)


@inlined
def _corrected(x: Vector, covariance: Matrix, along: Vector, score: float, information: float, states: int) -> None:
    for i in range(states):
        x[i] += along[i] * score
        weighed = along[i] * information
        for j in range(i, states):
            covariance[i, j] -= weighed * along[j]
            covariance[j, i] = covariance[i, j]


@subroutine
def corrected_but(
    considered: Flags,
    x: Vector,
    covariance: Matrix,
    along: Vector,
    score: float,
    information: float,
    gain: NDArray[np.float32],
) -> None:
    """Change state and covariance by a measurement, and set the gain of states that are only considered to 0.

    Their means and what they have in common with each other stay, while what they have in common with other states
    changes as ever (Schmidt's suboptimal gain in Joseph's form).
    """
    for i in range(x.size):
        if considered[i]:
            gain[i] = 0.0
        else:
            x[i] += along[i] * score
        weighed = along[i] * information
        for j in range(i, x.size):
            if not (considered[i] and considered[j]):
                covariance[i, j] -= weighed * along[j]
                covariance[j, i] = covariance[i, j]
