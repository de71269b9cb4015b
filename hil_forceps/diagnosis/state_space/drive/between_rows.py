"""What counts that no row shows make of the filter's state until the next row, and how that answers to a change of it.

`unseen_counts.py` tells of the counts there. Here are the directions of the state that they hang on, and the collapse
of what they leave open into one mean and covariance.
"""

import math
from typing import NamedTuple

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
    with_work_arrays,
)
from hil_forceps.diagnosis.state_space.layout import (
    BETWEEN,
    COMMAND_ERROR,
    COMMANDS_BETWEEN,
    COUNT_ERROR,
    COUPLED,
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
from hil_forceps.diagnosis.state_space.measurement import new_current_variance
from hil_forceps.model.composition import Physics

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_REST_SHARE = 1e-9  # of a variance: less is rounding
_LINE_DEVIATION_SHARE = 1e-3  # of a deviation: the angles behind a row hang together, and one direction says all of it


@with_work_arrays
def collapse(
    p: Physics,
    d: Series,
    row: int,
    f: Matrix,
    reacts: bool,
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

    `f`: F of a sample of the drive; `reacts`: the last command is within its limit; `counts_rad` and `angles_rad`: of
    the nominal course, and `shown_A` what the next row's current is beyond it. `out`: the row's part is filled.
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
    errors = _command_errors(p, d, reacts, covariance, first, second)
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
        errors.along_A,
        shown_A,
        math.sqrt(errors.variance + new_current_variance(p, d)),
    )
    out.timing[row], out.current_variance[row] = d.timing[row], v.deviation_A**2
    mean, found = np.zeros(UNKNOWNS + 1), np.zeros((UNKNOWNS + 1, UNKNOWNS + 1))
    if is_open(v):
        if shows_counts(v):
            out.prior_variance[row] = unseen_counts(v, mean, found, out.timing[row])
            _with_command_errors(v, errors, mean, found)
        else:
            expected_counts(v, mean, found)
            found[-1, -1] = errors.variance
            out.prior_variance[row] = NOT_CONDITIONED
        out.directions[row, 0] = ways[begin] / root
        out.directions[row, 1] = (ways[last] - shared * ways[begin] / root) * share
        basis = np.stack((first, second, errors.per_A))
        _mixed(basis, errors.variance, mean, found, x, covariance)
        _note_answers(v, basis, errors, found, row, out)
    made[:] = mean[2:-1]


class _CommandErrors(NamedTuple):
    """What the state tells of the last command before the next row, beside unseen counts."""

    along_A: Vector  # 2: of it by each direction
    variance: float  # [A²]: of the rest
    per_A: Vector  # states: how they go with the rest


@returning_arrays
def _command_errors(
    p: Physics, d: Series, reacts: bool, covariance: Matrix, first: Vector, second: Vector
) -> _CommandErrors:
    """Return errors of the last command by those of integral and derivative, and by its sensor's coloured noise."""
    gain, left = 1.0 + p.current_gain_relative_error, derivative_left(d.law, d.samples - 1)
    acts, noise = 1.0 if reacts else 0.0, d.noise_correlation[2] / gain
    along, by = np.zeros(covariance.shape[0]), np.zeros(2)
    for i in range(along.size):
        along[i] = _in_command(acts, left, noise, covariance[i])
    by[0], by[1] = _in_command(acts, left, noise, first), _in_command(acts, left, noise, second)
    whole = _in_command(acts, left, noise, along)
    rest = whole - by[0] * by[0] - by[1] * by[1]
    if not rest > _REST_SHARE * whole:
        return _CommandErrors(by, 0.0, np.zeros(along.size))
    return _CommandErrors(by, rest, (along - by[0] * first - by[1] * second) / rest)


@inlined
def _in_command(acts: float, left: float, noise: float, x: Vector) -> float:
    """Return what errors of the law and the sensor's noise make of the last command as it is shown."""
    shown: float = acts * (x[INTEGRAL_ERROR] + left * x[DERIVATIVE_ERROR]) + noise * x[CURRENT_NOISE]
    return shown


@inlined
def _with_command(v: Samples, found: Matrix, i: int) -> float:
    """Return the covariance of an unknown and the last command, as far as directions and counts make that."""
    covariance: float = v.along_A[0] * found[0, i] + v.along_A[1] * found[1, i] + found[1 + v.samples, i]
    return covariance


@with_work_arrays
def _with_command_errors(v: Samples, errors: _CommandErrors, mean: Vector, found: Matrix) -> None:
    """Fill the last of the unknowns, the rest of the command's error: given the current, it hangs on the counts."""
    last = found.shape[0] - 1
    found[last, last] = errors.variance
    if math.isnan(v.shown_A) or errors.variance == 0.0:
        return
    by_current = errors.variance / v.deviation_A**2
    command = np.zeros(last)
    for i in range(last):
        command[i] = _with_command(v, found, i)
    expected = v.along_A[0] * mean[0] + v.along_A[1] * mean[1] + mean[1 + v.samples]
    variance = v.along_A[0] * command[0] + v.along_A[1] * command[1] + command[1 + v.samples]
    mean[last] = by_current * (v.shown_A - expected)
    found[last, last] = errors.variance * (1.0 - by_current) + by_current * by_current * variance
    for i in range(last):
        found[last, i] = -by_current * command[i]
        found[i, last] = found[last, i]


@with_work_arrays
def _mixed(basis: Matrix, error_variance: float, mean: Vector, found: Matrix, x: Vector, covariance: Matrix) -> None:
    """Replace what state and covariance have of the unknowns by their moments, and add what counts make of them.

    `basis` (3 × states): of both directions, and of the rest of the command's error, whose variance was that.
    """
    places, before = (0, 1, found.shape[0] - 1), (1.0, 1.0, error_variance)
    change = np.zeros(3)
    for i in range(LAW_STATES):
        for b in range(3):
            x[i] += basis[b, i] * mean[places[b]]
            change[b] = -before[b] * basis[b, i]
            for a in range(3):
                change[b] += found[places[a], places[b]] * basis[a, i]
        for j in range(LAW_STATES):
            for b in range(3):
                covariance[i, j] += change[b] * basis[b, j]
        for k in range(MADE_BETWEEN):
            covariance[i, BETWEEN + k] = 0.0
            for b in range(3):
                covariance[i, BETWEEN + k] += basis[b, i] * found[places[b], 2 + k]
            covariance[BETWEEN + k, i] = covariance[i, BETWEEN + k]
    for i in range(MADE_BETWEEN):
        for j in range(MADE_BETWEEN):
            covariance[BETWEEN + i, BETWEEN + j] = found[2 + i, 2 + j]


@with_work_arrays
def _note_answers(v: Samples, basis: Matrix, errors: _CommandErrors, found: Matrix, row: int, out: Between) -> None:
    """Note how the state behind the collapse answers to a change before it, and to the next row's current.

    Points are weighed by a normal likelihood of the last command. So the derivative of a mean by the current is its
    covariance with that command, over the current's variance; and by the mean of a unit normal value, that with it.
    """
    places, last = (0, 1, found.shape[0] - 1), found.shape[0] - 1
    per_A = np.zeros(found.shape[0])
    if out.prior_variance[row] != NOT_CONDITIONED and not math.isnan(v.shown_A):
        for i in range(last + 1):
            per_A[i] = _with_command(v, found, i) / v.deviation_A**2
        per_A[last] += errors.variance / v.deviation_A**2
    for i in range(LAW_STATES):
        out.by_current[row, i] = 0.0
        for b in range(3):
            out.by_current[row, i] += per_A[places[b]] * basis[b, i]
    for k in range(MADE_BETWEEN):
        out.by_current[row, BETWEEN + k] = per_A[2 + k]
    for a in range(2):
        for i in range(LAW_STATES):
            out.pull[row, a, i] = basis[a, i] - v.along_A[a] * out.by_current[row, i]
            for b in range(3):
                out.pull[row, a, i] -= found[a, places[b]] * basis[b, i]
        for k in range(MADE_BETWEEN):
            out.made[row, a, k] = found[a, 2 + k] + v.along_A[a] * out.by_current[row, BETWEEN + k]


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


@as_its_caller
def answered(b: Between, row: int, shift_rad: float | Vector, more_A: float | Vector, x: Vector | Matrix) -> None:
    """Carry a change of the state over what is told of the counts behind a row; fill what these make of it.

    `shift_rad`: by which the encoder shows another angle of the same state; `more_A`: by which the next row's current
    is more than what is commanded then. Many changes have a column each.
    """
    first, second = b.directions[row, 0, THETA_M] * shift_rad, b.directions[row, 1, THETA_M] * shift_rad
    for j in range(COUPLED):
        first = first + b.directions[row, 0, j] * x[j]
        second = second + b.directions[row, 1, j] * x[j]
    for i in range(LAW_STATES):
        x[i] += b.by_current[row, i] * more_A - b.pull[row, 0, i] * first - b.pull[row, 1, i] * second
    for k in range(MADE_BETWEEN):
        x[BETWEEN + k] = b.made[row, 0, k] * first + b.made[row, 1, k] * second
        x[BETWEEN + k] += b.by_current[row, BETWEEN + k] * more_A


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
