"""What a drive counted where no row shows it, weighed by the filter's angle and by the current that the next row shows.

That is between rows, and at rows of an encoder that is recorded late or early.

A count follows from the angle, and a count more or less makes the command that moves the angle on. Where a count is
coarse against what is known of the angle, no normal distribution is near that. So angle and speed are tried at points
of their distribution (quadrature), the law goes on from each, and each is weighed by how well its last command fits the
measured current. The filter goes on with mean and covariance of them all: a mixture is collapsed at each row (Blom and
Bar-Shalom, IEEE Trans. Automat. Contr. 33, 1988).

Where a count more or less doesn't show in the current, mean and covariance of counts are enough, and the current is a
measurement as any.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.drive.sample import expected_count, law_errors
from hil_forceps.diagnosis.state_space.kernel import inlined, subroutine, with_work_arrays
from hil_forceps.diagnosis.state_space.layout import COMMANDS_BETWEEN, MADE_BETWEEN

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

REACH_DEVIATIONS = 4.2  # deviations: 1.5e-4 of two normal ones lies beyond
ANGLES, SPEEDS = np.linspace(-4.0, 4.0, 25), np.linspace(-3.0, 3.0, 5)  # moments of both are right to 1e-3
MAX_EDGE_DEVIATIONS = 4.5  # deviations: an edge of a count further away is not met
MAX_MISFIT_CHI2 = 100.0  # χ²: a blow to the current sensor is no proof of a count
MIN_TIMING_SHARE = 0.01  # of a reference's share, below which it isn't tried
VISIBLE_COUNT_DEVIATIONS = (
    0.5  # of the current's deviation: two values so far apart beside its noise are a normal distribution to 1 %
)
SAME_REFERENCE_DEVIATIONS = 0.05  # of the current's deviation: references that differ by less are one
UNKNOWNS = 2 + MADE_BETWEEN  # both directions, and what is made of them
MEAN_REFERENCE = -1
_MOMENTS = 6  # of points: their weight, means of two deviations, mean squares
_LEAST_VARIANCE = 1e-30  # [A²]: 0 says that nothing was open


def _grid(angles: Vector, speeds: Vector) -> Matrix:
    """Return points of two independent normal deviations, and the share of each (m × 3): the trapezoidal rule."""
    first, second = (axis.ravel() for axis in np.meshgrid(angles, speeds, indexing="ij"))
    near = first**2 + second**2 < REACH_DEVIATIONS**2
    share = np.exp(-0.5 * (first[near] ** 2 + second[near] ** 2))
    return np.column_stack((first[near], second[near], share / share.sum()))


GRID, LINE = _grid(ANGLES, SPEEDS), _grid(ANGLES, np.zeros(1))


class Samples(NamedTuple):
    """The drive's samples from a row to the next, as they go on the mean."""

    law: Vector
    first: int  # the first of them whose count no row shows: 0 or 1
    samples: int  # how many
    quantum_rad: float
    counts_rad: Vector  # at each sample, as nominally counted
    angles_rad: Vector  # at each sample, by the encoder
    spread_rad: Matrix  # samples × 2: of them by each direction
    answers_rad: Vector  # of the angle one, two and three samples behind, per ampere over one
    references_rad: Matrix  # samples × 3: off the mean reference
    timing: Vector  # 3: how likely each is
    along_A: Vector  # 2: of the last command by each direction, through errors of the law's integral and derivative
    shown_A: float  # what the next row shows beyond the nominal course; NaN: nothing
    deviation_A: float  # of that


@subroutine
def is_open(v: Samples) -> bool:
    """Tell whether anything of them is open: a count, or a reference."""
    open_ = not _same_references(v)
    for sample in range(v.first, v.samples):
        spread = math.hypot(v.spread_rad[sample, 0], v.spread_rad[sample, 1])
        away = 0.5 * v.quantum_rad - abs(v.angles_rad[sample] - v.counts_rad[sample])
        open_ = open_ or away < MAX_EDGE_DEVIATIONS * spread
    return open_


@inlined
def _same_references(v: Samples) -> bool:
    """Tell whether only one reference is worth trying."""
    same, per_rad = True, law_errors(v.law, 0.0, 0.0, 0.0, 1.0, 0.0)[3]
    for kind in range(3):
        far_rad = 0.0
        for sample in range(v.samples):
            far_rad = max(far_rad, abs(v.references_rad[sample, kind]))
        same = same and (
            v.timing[kind] < MIN_TIMING_SHARE or far_rad * per_rad <= SAME_REFERENCE_DEVIATIONS * v.deviation_A
        )
    return same


@subroutine
def shows_counts(v: Samples) -> bool:
    """Tell whether the next current shows which of two neighbouring counts there was, or which reference."""
    return count_current_A(v.law, v.quantum_rad) > VISIBLE_COUNT_DEVIATIONS * v.deviation_A or not _same_references(v)


@subroutine
def count_current_A(law: Vector, quantum_rad: float) -> float:
    """Return by how much one count less raises the command at once."""
    at_once: float = law_errors(law, 0.0, 0.0, 0.0, 1.0, -1.0)[3]
    return at_once * quantum_rad


@with_work_arrays
def expected_counts(v: Samples, mean: Vector, covariance: Matrix) -> None:
    """Fill mean and covariance of both directions and of what counts make, whatever the next current is.

    Both may hold more behind that, which stays.
    """
    made = np.zeros((v.samples, UNKNOWNS))
    covariance[:], mean[:] = 0.0, 0.0
    covariance[0, 0], covariance[1, 1] = 1.0, 1.0
    for sample in range(v.first, v.samples):
        deviation = math.hypot(v.spread_rad[sample, 0], v.spread_rad[sample, 1])
        count = expected_count(v.angles_rad[sample], deviation, v.quantum_rad)
        after = (0.0, 0.0, 0.0, 0.0)
        for other in range(v.first, v.samples):
            one = 1.0 if other == sample else 0.0
            after = law_errors(v.law, after[0], after[1], after[2], -one, one)
            made[sample, 2 + other] = after[3]
        _at_end(after, made[sample, 2:])
        mean[:UNKNOWNS] += (count.mean_rad - v.counts_rad[sample]) * made[sample]
        for i in range(2, UNKNOWNS):
            for a in range(2):
                covariance[a, i] += count.slope * v.spread_rad[sample, a] * made[sample, i]
            for j in range(2, UNKNOWNS):
                covariance[i, j] += count.variance * made[sample, i] * made[sample, j]
    for i in range(2, UNKNOWNS):
        for j in range(2, UNKNOWNS):
            covariance[i, j] += covariance[0, i] * covariance[0, j] + covariance[1, i] * covariance[1, j]
        covariance[i, 0], covariance[i, 1] = covariance[0, i], covariance[1, i]


@inlined
def _made(v: Samples, kind: int, first: float, second: float, away_rad: Vector, made: Vector) -> None:
    """Fill in what the counts of a point make beyond the nominal course; `kind` −1: mean references.

    `away_rad`: by how much the angles of the distribution's mean are beyond these counts.
    """
    after = (0.0, 0.0, 0.0, 0.0)
    for sample in range(v.first, v.samples):
        mean_rad = v.angles_rad[sample]
        for earlier in range(v.first, sample):
            mean_rad += v.answers_rad[sample - earlier - 1] * made[earlier]
        angle = mean_rad + v.spread_rad[sample, 0] * first + v.spread_rad[sample, 1] * second
        if v.quantum_rad > 0.0:
            angle = math.floor(angle / v.quantum_rad + 0.5) * v.quantum_rad
        count = angle - v.counts_rad[sample]
        error = (0.0 if kind == MEAN_REFERENCE else v.references_rad[sample, kind]) - count
        after = law_errors(v.law, after[0], after[1], after[2], error, count)
        away_rad[sample], made[sample] = mean_rad - angle, after[3]
    _at_end(after, made)


@inlined
def _counts_alike(v: Samples, first: float, second: float, away_rad: Vector) -> bool:
    """Tell whether a point has the counts that `away_rad` is of."""
    alike = True
    for sample in range(v.first, v.samples):
        away = away_rad[sample] + v.spread_rad[sample, 0] * first + v.spread_rad[sample, 1] * second
        alike = alike and abs(away) < 0.5 * v.quantum_rad
    return alike


@inlined
def _at_end(after: tuple[float, float, float, float], out: Vector) -> None:
    """Fill in integral, derivative and count behind the last sample."""
    for i in range(3):
        out[COMMANDS_BETWEEN + i] = after[i]


@inlined
def _fits(v: Samples, command_A: float) -> float:
    """Return the likelihood of the current that the next row shows."""
    if math.isnan(v.shown_A):
        return 1.0
    misfit = (v.shown_A - command_A) / v.deviation_A
    return math.exp(-0.5 * min(misfit * misfit, MAX_MISFIT_CHI2))


@with_work_arrays
def unseen_counts(v: Samples, mean: Vector, covariance: Matrix, timing: Vector) -> float:
    """Fill mean and covariance of both directions and of what counts make (`UNKNOWNS`), given the next current.

    Where the last angle, and so none, hangs on the second direction, the first alone is tried; the second's variance
    is 0 then.

    `timing` (3) is filled with how likely each reference was, given it too. Returned is the variance [A²] of the last
    command before the current is looked at.
    """
    away_rad, made, alike = np.zeros(COMMANDS_BETWEEN), np.zeros(MADE_BETWEEN), np.zeros(_MOMENTS)
    shares, same = np.zeros(3), _same_references(v)
    points = LINE if v.spread_rad[v.samples - 1, 1] == 0.0 else GRID
    command, square = 0.0, 0.0
    for kind in range(1 if same else 3):
        share = 1.0 if same else v.timing[kind]
        if share < MIN_TIMING_SHARE:
            continue
        for at in range(points.shape[0]):
            first, second = points[at, 0], points[at, 1]
            if at == 0 or not _counts_alike(v, first, second, away_rad):
                _add(alike, made, mean, covariance)
                _made(v, MEAN_REFERENCE if same else kind, first, second, away_rad, made)
            weight, last_A = points[at, 2] * share, made[v.samples - 1]
            command += weight * last_A
            square += weight * last_A * last_A
            weight *= _fits(v, last_A + v.along_A[0] * first + v.along_A[1] * second)
            shares[kind] += weight
            _note_moments(weight, first, second, alike)
        _add(alike, made, mean, covariance)
    total = shares.sum()
    mean /= total
    for i in range(UNKNOWNS):
        for j in range(i, UNKNOWNS):
            covariance[i, j] = covariance[i, j] / total - mean[i] * mean[j]
            covariance[j, i] = covariance[i, j]
    if not same:
        timing[:] = shares / total
    return max(_LEAST_VARIANCE, square - command * command)


@inlined
def _note_moments(weight: float, first: float, second: float, out: Vector) -> None:
    """Add a point to the moments of points that count alike."""
    out[0] += weight
    out[1] += weight * first
    out[2] += weight * second
    out[3] += weight * first * first
    out[4] += weight * first * second
    out[5] += weight * second * second


@inlined
def _add(alike: Vector, made: Vector, mean: Vector, square: Matrix) -> None:
    """Add points that count alike to sums of the unknowns and of their products, whose upper half is filled.

    Their moments, `alike`, are 0 then.
    """
    mean[0] += alike[1]
    mean[1] += alike[2]
    square[0, 0] += alike[3]
    square[0, 1] += alike[4]
    square[1, 1] += alike[5]
    for i in range(MADE_BETWEEN):
        weighed = alike[0] * made[i]
        mean[2 + i] += weighed
        square[0, 2 + i] += alike[1] * made[i]
        square[1, 2 + i] += alike[2] * made[i]
        for j in range(i, MADE_BETWEEN):
            square[2 + i, 2 + j] += weighed * made[j]
    alike[:] = 0.0
