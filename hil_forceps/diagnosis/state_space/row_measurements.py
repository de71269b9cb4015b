"""A row's measurements, one after the other: what each changes of state and covariance, and its innovation."""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.covariance import spread
from hil_forceps.diagnosis.state_space.drive.row import measured_command_gain
from hil_forceps.diagnosis.state_space.drive.unseen_counts import count_current_A
from hil_forceps.diagnosis.state_space.interval import share_kept
from hil_forceps.diagnosis.state_space.kernel import inlined, subroutine
from hil_forceps.diagnosis.state_space.layout import (
    BETWEEN,
    CHANNELS,
    COMMAND_ERROR,
    CURRENT,
    CURRENT_NOISE,
    ENCODER,
    FRICTION_M,
    INTEGRAL_ERROR,
    JAW_ZERO,
    LAW_STATES,
    LOAD,
    LOAD_CELL,
    LOAD_SLOPE,
    RECORDED_STATES,
    Filtered,
    Series,
    Work,
)
from hil_forceps.diagnosis.state_space.measurement import (
    corrected,
    corrected_but,
    current_direction,
    direction,
    evidence,
    late_s,
    measured,
    new_current_variance,
    predicted,
    white_variance,
)
from hil_forceps.diagnosis.state_space.row_plant import may_hold
from hil_forceps.model.composition import Physics

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Flags = NDArray[np.bool_]

SURPRISE_DEVIATIONS = 4.5  # deviations of an innovation: 1 in 150 000 by chance
SEPARATE_COUNT_DEVIATIONS = 10.0  # of a current: a count further off is chosen for a noise of 5 deviations only
SURE_SHARE = 0.01  # of the variance of a current: what counts leave open of it is then a tenth of its deviation


@inlined
def sticks_at(d: Series, row: int, doubtful: bool) -> bool:
    """Tell whether dry friction may hold a mass, or did so a row before."""
    before = max(row - 1, 0)
    return doubtful or _either(d, row) or _either(d, before)


@inlined
def _either(d: Series, row: int) -> bool:
    return may_hold(d, row, 0) or may_hold(d, row, 1)


@inlined
def _considered(d: Series, row: int, channel: int, sticks: bool, calm: bool, out: Flags) -> bool:
    """Mark the states of which a measurement is no evidence; tell whether there are any.

    Friction that holds a mass is the same for seconds, and wanders within its level by name only: what constants it
    seems to tell would be its own mean. The same holds of the load, which its own sensor tells, until the wire is
    calm again. So they are considered there, not estimated (Schmidt's filter).
    """
    load = not calm and channel != LOAD_CELL and not math.isnan(d.load_N_m[row])
    out[COMMAND_ERROR], out[JAW_ZERO] = sticks and channel != CURRENT, sticks
    if d.states > RECORDED_STATES:
        out[INTEGRAL_ERROR] = out[COMMAND_ERROR]
    out[LOAD], out[LOAD_SLOPE] = load, load
    return sticks or load


@inlined
def take_measurements(
    p: Physics,
    d: Series,
    row: int,
    now_A: float,
    before_A: float,
    x: Vector,
    covariance: Matrix,
    f: Matrix,
    sticks: bool,
    calm: bool,
    considered: Flags,
    work: Work,
    out: Filtered,
) -> bool:
    """Take a row's measurements in, one after the other; tell whether one of them was a surprise.

    A current that was not commanded leaves open how much of it drove the motor since the row before.
    """
    along = work.along
    surprise = False
    for place in range(CHANNELS):
        channel = (place + CURRENT) % CHANNELS  # the current first: what else moved the motor, is known by it
        if math.isnan(measured(d, channel, row)):
            continue
        shown = predicted(p, d, channel, x, now_A, before_A)
        if channel == CURRENT and d.states > LAW_STATES:
            _considered(d, row, channel, sticks, calm, considered)
            _current_between(p, d, row, shown, considered, x, covariance, work, out)
            continue
        if channel == CURRENT:
            variance = current_direction(covariance, measured_command_gain(p, d, row, out), along)
        else:
            variance = direction(channel, late_s(p, d, channel), covariance, along)
        log_likelihood, score, information = evidence(d, channel, row, shown, variance)
        root = math.sqrt(information)
        # Far within a count both are next to nothing, and their quotient is noise of rounding.
        telling = channel != ENCODER or information * (variance + d.encoder_variance[row]) > 1e-12
        residual = score / root if telling else 0.0
        out.weight[row, channel], out.residual[row, channel] = root, residual
        out.log_likelihood[row, channel] = log_likelihood
        for i in range(d.states):
            out.gain[row, channel, i] = along[i] * information
        taken = information
        if channel == ENCODER and d.count_rad > 0.0:
            taken *= share_kept(d.count_rad / math.sqrt(max(0.0, variance) + d.encoder_variance[row]))
        if _considered(d, row, channel, sticks, calm, considered):
            corrected_but(considered, x, covariance, along, score, taken, out.gain[row, channel])
        else:
            corrected(x, covariance, along, score, taken)
        if channel == CURRENT and abs(residual) > SURPRISE_DEVIATIONS:
            error_A = residual / root / (1.0 + p.current_gain_relative_error)
            spread(covariance, f, FRICTION_M, (p.K_t * error_A) ** 2)
        surprise = surprise or (abs(residual) > SURPRISE_DEVIATIONS and channel != CURRENT)
    return surprise


@subroutine
def _current_between(
    p: Physics,
    d: Series,
    row: int,
    shown_A: float,
    considered: Flags,
    x: Vector,
    covariance: Matrix,
    work: Work,
    out: Filtered,
) -> None:
    """Take in the current behind counts that no row shows: between rows, or at rows whose encoder is recorded late."""
    prior_variance = out.between.prior_variance[row - 1] if row > 0 else 0.0
    if prior_variance > 0.0:
        _current_behind_counts(p, d, row, shown_A, prior_variance, x, covariance, out)
        return
    gain, along, shown = measured_command_gain(p, d, row, out), work.along, work.shown
    for i in range(d.states):
        shown[i] = gain * covariance[i, COMMAND_ERROR] + covariance[i, CURRENT_NOISE]
    variance = gain * shown[COMMAND_ERROR] + shown[CURRENT_NOISE]
    white = white_variance(d, CURRENT) + d.resolution[2] ** 2 / 12.0
    total, error = max(0.0, variance) + white, d.current_A[row] - shown_A
    out.weight[row, CURRENT], out.residual[row, CURRENT] = 1.0 / math.sqrt(total), error / math.sqrt(total)
    out.log_likelihood[row, CURRENT] = -0.5 * (error * error / total + math.log(total))
    for i in range(d.states):
        along[i] = 0.0 if considered[i] or i >= BETWEEN else shown[i] / total
        out.gain[row, CURRENT, i] = along[i]
        x[i] += along[i] * error
    for i in range(d.states):
        for j in range(d.states):
            covariance[i, j] += (variance + white) * along[i] * along[j] - along[i] * shown[j] - shown[i] * along[j]


@inlined
def _current_behind_counts(
    p: Physics,
    d: Series,
    row: int,
    shown_A: float,
    prior_variance: float,
    x: Vector,
    covariance: Matrix,
    out: Filtered,
) -> None:
    """Take in a current by which the counts before it, and errors of the law, have been weighed already.

    What is left is the noise that is new at this row. The current is evidence of the parameters where counts are known
    without it, or where none but one comes near it: chosen among some that do, they fit it too well. An innovation s²
    of which n² is noise has left n²/s² of itself behind the weighing.
    """
    gain = 1.0 + p.current_gain_relative_error
    new, total = gain * gain * new_current_variance(p, d), gain * gain * out.between.current_variance[row - 1]
    error, deviation = d.current_A[row] - shown_A, math.sqrt(total)
    apart = gain * count_current_A(d.law, d.count_rad) > SEPARATE_COUNT_DEVIATIONS * deviation
    if prior_variance < SURE_SHARE * total or apart:
        weight = deviation / new
        out.weight[row, CURRENT], out.residual[row, CURRENT] = weight, weight * error
        out.log_likelihood[row, CURRENT] = -0.5 * ((weight * error) ** 2 + math.log(total))
    if d.noise_correlation[2] != 0.0:
        coloured = d.noise_variance[2] * (1.0 - d.noise_correlation[2] ** 2)
        out.gain[row, CURRENT, CURRENT_NOISE] = coloured / new
        x[CURRENT_NOISE] += coloured / new * error
        covariance[CURRENT_NOISE, CURRENT_NOISE] -= coloured * coloured / total
