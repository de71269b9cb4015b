"""What counts that no row shows make of the filter's state until the next row, and how that answers to a change of it.

`unseen_counts.py` tells of the counts there. Here are the directions of the state that they hang on, and the collapse
of what they leave open into one mean and covariance.
"""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.drive.sample import derivative_left
from hil_forceps.diagnosis.state_space.drive.unseen_counts import (
    UNKNOWNS,
    Samples,
    expected_counts,
    is_open,
    shows_counts,
    unseen_counts,
)
from hil_forceps.diagnosis.state_space.kernel import (
    as_its_caller,
    inlined,
    returning_arrays,
    subroutine,
    with_work_arrays,
)
from hil_forceps.diagnosis.state_space.layout import (
    BETWEEN,
    COMMAND_ERROR,
    COMMANDS_BETWEEN,
    COUNT_ERROR,
    COUPLED,
    CURRENT,
    CURRENT_NOISE,
    DERIVATIVE_ERROR,
    INTEGRAL_ERROR,
    LAW_STATES,
    MADE_BETWEEN,
    NOT_CONDITIONED,
    THETA_M,
    Between,
    Series,
)
from hil_forceps.diagnosis.state_space.measurement import white_variance
from hil_forceps.model.composition import Physics

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_LINE_DEVIATION_SHARE = 1e-3  # of a deviation: the angles behind a row hang together, and one direction says all of it


@with_work_arrays
def collapse(
    p: Physics,
    d: Series,
    row: int,
    f: Matrix,
    counts_rad: Vector,
    angles_rad: Vector,
    shown_A: float,
    edge_variance: float,
    x: Vector,
    covariance: Matrix,
    made: Vector,
    out: Between,
) -> None:
    """Change state and covariance by what is told of the counts behind a row; fill `made` by these, on the mean.

    `f`: F of a sample of the drive; `counts_rad` and `angles_rad`: of the nominal course, and `shown_A` what the next
    row's current is beyond it. `out`: the row's part is filled.
    """
    last, at = d.samples - 1, row * d.samples
    begin = 0 if math.isnan(d.counted_rad[row]) else 1
    ways = _ways(f, d.samples)
    answers_rad = np.zeros(COMMANDS_BETWEEN)
    for sample in range(last):
        answers_rad[sample] = _times(ways[sample], f[:, COMMAND_ERROR])
    first, second = _along(covariance, ways[begin]), _along(covariance, ways[last])
    root = math.sqrt(max(_times(ways[begin], first), 0.0) + edge_variance)
    first /= root
    shared = _times(ways[last], first)
    rest = math.sqrt(max(_times(ways[last], second) + edge_variance - shared * shared, 0.0))
    # Of one sample there is one angle, and one direction.
    share = 1.0 / rest if last > begin and rest > _LINE_DEVIATION_SHARE * root else 0.0
    second = (second - shared * first) * share
    spread_rad = np.zeros((d.samples, 2))
    for sample in range(begin, d.samples):
        spread_rad[sample, 0], spread_rad[sample, 1] = _times(ways[sample], first), _times(ways[sample], second)
    spread_rad[begin, 0] = root
    references_rad = d.references_rad[at : at + d.samples] - d.reference_rad[at : at + d.samples].reshape((-1, 1))
    deviation_A = _current_deviation(p, d, covariance)
    v = Samples(
        d.law,
        begin,
        d.samples,
        d.count_rad,
        counts_rad,
        angles_rad,
        spread_rad,
        answers_rad,
        references_rad,
        d.timing[row],
        shown_A,
        deviation_A,
    )
    out.timing[row] = d.timing[row]
    mean, found = np.zeros(UNKNOWNS), np.zeros((UNKNOWNS, UNKNOWNS))
    if is_open(v):
        if shows_counts(v):
            out.prior_variance[row] = unseen_counts(v, mean, found, out.timing[row])
        else:
            expected_counts(v, mean, found)
            out.prior_variance[row] = NOT_CONDITIONED
        out.directions[row, 0] = ways[begin] / root
        out.directions[row, 1] = (ways[last] - shared * ways[begin] / root) * share
        _mixed(first, second, mean, found, x, covariance)
        for a in range(2):
            out.made[row, a] = found[a, 2:]
            out.pull[row, a] = (first if a == 0 else second)[:LAW_STATES]
            out.pull[row, a] -= found[0, a] * first[:LAW_STATES] + found[1, a] * second[:LAW_STATES]
    made[:] = mean[2:]


@subroutine
def _mixed(first: Vector, second: Vector, mean: Vector, found: Matrix, x: Vector, covariance: Matrix) -> None:
    """Replace what state and covariance have of two directions by their moments, and add what counts make of them."""
    for i in range(LAW_STATES):
        x[i] += first[i] * mean[0] + second[i] * mean[1]
        along = (
            (found[0, 0] - 1.0) * first[i] + found[0, 1] * second[i],
            (found[1, 1] - 1.0) * second[i] + found[0, 1] * first[i],
        )
        for j in range(LAW_STATES):
            covariance[i, j] += along[0] * first[j] + along[1] * second[j]
        for k in range(MADE_BETWEEN):
            covariance[i, BETWEEN + k] = first[i] * found[0, 2 + k] + second[i] * found[1, 2 + k]
            covariance[BETWEEN + k, i] = covariance[i, BETWEEN + k]
    for i in range(MADE_BETWEEN):
        for j in range(MADE_BETWEEN):
            covariance[BETWEEN + i, BETWEEN + j] = found[2 + i, 2 + j]


@returning_arrays
def _ways(f: Matrix, samples: int) -> Matrix:
    """Return how the angle at each sample behind a row follows from the state at the row (samples × 9)."""
    ways = np.zeros((samples, COUPLED))
    ways[0, THETA_M] = 1.0
    for sample in range(1, samples):
        for j in range(COUPLED):
            ways[sample, j] = _times(ways[sample - 1], f[:, j])
    return ways


@returning_arrays
def _along(covariance: Matrix, way: Vector) -> Vector:
    """Return the covariance of each state and what follows from the state along `way`."""
    along = np.zeros(covariance.shape[0])
    for i in range(along.size):
        along[i] = _times(way, covariance[i])
    return along


@inlined
def _times(way: Vector, column: Vector) -> float:
    total = 0.0
    for j in range(COUPLED):
        total += way[j] * column[j]
    return total


@subroutine
def _current_deviation(p: Physics, d: Series, covariance: Matrix) -> float:
    """Return the deviation of the next row's current where all counts are known."""
    coloured = d.noise_variance[2] * (1.0 - d.noise_correlation[2] ** 2) if d.noise_correlation[2] != 0.0 else 0.0
    gain = 1.0 + p.current_gain_relative_error
    kept = derivative_left(d.law, d.samples - 1)
    variance = covariance[INTEGRAL_ERROR, INTEGRAL_ERROR] + kept * kept * covariance[DERIVATIVE_ERROR, DERIVATIVE_ERROR]
    variance += 2.0 * kept * covariance[INTEGRAL_ERROR, DERIVATIVE_ERROR]
    variance = gain * gain * max(variance, 0.0) + max(covariance[CURRENT_NOISE, CURRENT_NOISE], 0.0)
    return math.sqrt(variance + coloured + white_variance(d, CURRENT) + d.resolution[2] ** 2 / 12.0)


@as_its_caller
def answered(b: Between, row: int, shift_rad: float | Vector, x: Vector | Matrix) -> None:
    """Carry a change of the state over what is told of the counts behind a row; fill what these make of it.

    `shift_rad`: by which the encoder shows another angle of the same state. Many changes have a column each.
    """
    first, second = b.directions[row, 0, THETA_M] * shift_rad, b.directions[row, 1, THETA_M] * shift_rad
    for j in range(COUPLED):
        first = first + b.directions[row, 0, j] * x[j]
        second = second + b.directions[row, 1, j] * x[j]
    for i in range(LAW_STATES):
        x[i] -= b.pull[row, 0, i] * first + b.pull[row, 1, i] * second
    for k in range(MADE_BETWEEN):
        x[BETWEEN + k] = b.made[row, 0, k] * first + b.made[row, 1, k] * second


@as_its_caller
def ended(x: Vector | Matrix) -> None:
    """Let a change of what counts make go on in the drive's law behind the last sample."""
    x[INTEGRAL_ERROR] += x[BETWEEN + COMMANDS_BETWEEN]
    x[DERIVATIVE_ERROR] += x[BETWEEN + COMMANDS_BETWEEN + 1]
    x[COUNT_ERROR] = x[BETWEEN + COMMANDS_BETWEEN + 2]


@inlined
def added(covariance: Matrix, to: int, state: int) -> None:
    """Add a state to another one, in their covariance."""
    for j in range(covariance.shape[0]):
        covariance[to, j] += covariance[state, j]
    for j in range(covariance.shape[0]):
        covariance[j, to] += covariance[j, state]
