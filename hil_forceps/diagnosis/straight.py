"""The course of a load that ramps and holds: straight pieces, and the instants at which it bends.

Such a load is known much better than a spline of it: some twenty levels and instants instead of hundreds of knots. And
a corner rings the wire as a rounded one doesn't. Bends are sought in means of blocks of rows, isolated ones first, then
whatever stands out of what is left; their instants are then fitted with all rows (Gauss-Newton). A load that bends
otherwise needs them close to each other: then it has no such course.

Slow noise hides a ramp as high as its own deviation, which the motor shows all the same. So what the course leaves open
holds bends everywhere that are too weak to be seen.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from hil_forceps.diagnosis.smoothing import (
    CUTOFFS,
    FEWEST_ROWS,
    LoadNoise,
    NoiseFilter,
    local_cutoff,
    noise_filter,
    whitening_matrix,
)

Vector = NDArray[np.float64]

BLOCKS = 600  # of a run, in which bends are sought
FEWEST_BLOCKS = 8
STANDS_OUT = 12.0  # of χ²: one that is missed bends the load by more than is told, one too many costs little
CLEAR = 25.0  # of χ²: what one of two bends must tell that are closer than they may be
OF_THE_HIGHEST = 0.3  # the skirts of a high gain are no bends
LEAST_APART_S = 0.1
ISOLATED_S = 0.15  # to both sides of a bend that is sought by itself
MOST_PASSES = 10
SETTLED = 1.0  # of χ²
STEPS, PRUNING_STEPS = 8, 3
SLOWEST = 2.0  # times the slowest cutoff: with more in what is left, it isn't straight
# A corner rounded over this rings the wire half as much as a sharp one, and no load cell shows it.
ROUNDED_S = 6.0e-3
# Bends that the noise hides, one every `UNSEEN_S`, each this share of what would show between two pieces of `OVER_S`.
UNSEEN_S, UNSEEN_SHARE, OVER_S = 0.1, 0.06, 0.3
HIDES = 4.0  # of its variance (white noise: 1): the power of slow noise that hides more than shows at the motor
SMALL = 1e-9


class PieceCourse(NamedTuple):
    """The course of a load between two jumps; its error is `error` (rows, k) times k standard normal numbers."""

    load: Vector
    error: Vector
    fitted: int  # how many of them, the first, the load was fitted with
    chi2: float  # what it leaves of the load


class _Fit(NamedTuple):
    at: Vector  # instants of the bends, in rows
    bends: Vector  # change of slope at each, N m per row
    load: Vector
    left: Vector  # whitened
    chi2: float


class _Sight(NamedTuple):
    """A load as it is looked at: at every row, or in means of blocks of rows."""

    rows: Vector  # the middle of each, in rows
    width: float  # of each, in rows; all but 0: the load as it was at that instant
    load: Vector
    white: NoiseFilter
    whitening: sparse.csr_matrix
    whitened: Vector


def straight_course(piece: Vector, block: int, period_s: float, noise: LoadNoise) -> PieceCourse | None:
    """Return the course [N m] of a load (rows) without jumps, if straight pieces hold it to within its noise.

    `block`: rows of a block in which bends are sought first.
    """
    if piece.size < FEWEST_ROWS:
        return None
    few = piece.size < FEWEST_BLOCKS * block
    at = np.empty(0) if few else _bends(_sight(piece, block, period_s, noise), period_s)
    if at is None:
        return None
    every = _sight(piece, 1, period_s, noise)._replace(width=SMALL)
    fit = _refined(every, at, STEPS)
    if _close(fit.at, LEAST_APART_S / period_s).any():
        return None
    if local_cutoff(piece - fit.load, every.white).mean() > SLOWEST * CUTOFFS[0]:
        return None
    return PieceCourse(fit.load, _error(every, fit, period_s), 2 + 3 * fit.at.size, fit.chi2)


def _sight(piece: Vector, block: int, period_s: float, noise: LoadNoise) -> _Sight:
    count = piece.size // block
    means = np.asarray(piece[: count * block].reshape(count, block).mean(axis=1), dtype=np.float64)
    white = noise_filter(noise, block * period_s)
    # A mean has as much less variance as it has rows.
    deviation, covariance = white.deviation_N_m / np.sqrt(block), white.covariance / block
    white = white._replace(deviation_N_m=deviation, covariance=covariance)
    whitening = whitening_matrix(white, count)
    rows = np.asarray((np.arange(count) + 0.5) * block, dtype=np.float64)
    return _Sight(rows, float(block), means, white, whitening, whitening @ means)


def _bends(sight: _Sight, period_s: float) -> Vector | None:
    """Return the instants at which a load bends, in rows; None where they come too close for straight pieces."""
    apart = LEAST_APART_S / period_s
    at = _isolated(sight, ISOLATED_S / period_s)
    places = sight.rows[2:-1] - 0.5 * sight.width
    ramps = sight.whitening @ _ramps(sight, places)
    own = np.einsum("ij,ij->j", ramps, ramps)
    before = np.inf
    for _ in range(MOST_PASSES):
        if at.size > sight.rows[-1] / (2.0 * apart):
            return None
        fit = _pruned(sight, _refined(sight, at, STEPS), apart)
        if _close(fit.at, apart).any():
            return None
        known, _ = np.linalg.qr(sight.whitening @ _columns(sight, fit))
        free = ramps - known @ (known.T @ ramps)
        gains = (free.T @ fit.left) ** 2 / np.maximum(np.einsum("ij,ij->j", free, free), SMALL * own)
        new = _highest(gains, max(STANDS_OUT, OF_THE_HIGHEST * float(gains.max())), places, 2.0 * apart)
        if not new.size or fit.chi2 > before - SETTLED:
            return fit.at
        before = fit.chi2
        at = np.sort(np.concatenate((fit.at, new)))
    return None


def _isolated(sight: _Sight, reach: float) -> Vector:
    """Return where the load bends by what it does near by alone."""
    half = max(3, int(reach / sight.width))
    if sight.load.size <= 2 * half:
        return np.empty(0)
    x = np.arange(-half, half + 1.0)
    template = np.abs(x) - np.abs(x).mean()
    size = float(template @ template)
    amplitude = np.convolve(sight.load, template, "same") / size
    amplitude[:half] = amplitude[-half:] = 0.0
    deviation = np.sqrt(sight.white.covariance[0] / size)
    return np.sort(_highest((amplitude / deviation) ** 2, STANDS_OUT, sight.rows, reach))


def _highest(gains: Vector, least: float, places: Vector, apart: float) -> Vector:
    """Return the places of the highest gains, none nearer to a higher one than `apart`."""
    found: list[float] = []
    for i in np.argsort(-gains):
        if gains[i] < least:
            break
        if all(abs(places[i] - place) >= apart for place in found):
            found.append(float(places[i]))
    return np.array(found)


def _pruned(sight: _Sight, fit: _Fit, apart: float) -> _Fit:
    """Drop bends that tell nothing, one by one, and of those too close the less clear, unless both are clear."""
    while fit.at.size:
        variance = _variances(sight, _columns(sight, fit))[2 : 2 + fit.at.size]
        clarity = fit.bends**2 / variance
        close = _close(fit.at, apart)
        least = int(np.argmin(np.where(close, clarity, np.inf) if close.any() else clarity))
        without = _refined(sight, np.delete(fit.at, least), PRUNING_STEPS)
        if without.chi2 > fit.chi2 + (CLEAR if close.any() else STANDS_OUT):
            break
        fit = without
    return fit


def _close(at: Vector, apart: float) -> NDArray[np.bool_]:
    """Tell which instants have another one nearer than `apart`."""
    near = np.diff(at) < apart
    return np.asarray(np.append(near, False) | np.append(False, near))


def _refined(sight: _Sight, at: Vector, steps: int) -> _Fit:
    """Fit levels, slopes and the instants of bends, from these on."""
    fit = _fitted(sight, at)
    longest = max(20.0, 5.0 * sight.width)
    for _ in range(steps if at.size else 0):
        step = np.linalg.lstsq(sight.whitening @ _columns(sight, fit), fit.left, rcond=None)[0][2 + at.size :]
        step = np.clip(step, -longest, longest)
        moved = (np.clip(fit.at + part * step, sight.rows[0] + 1.0, sight.rows[-1] - 1.0) for part in (1.0, 0.3))
        better = next((new for new in (_fitted(sight, np.sort(to)) for to in moved) if new.chi2 < fit.chi2), None)
        if better is None:
            break
        fall, fit = fit.chi2 - better.chi2, better
        if fall < 0.1 * SETTLED:
            break
    return fit


def _fitted(sight: _Sight, at: Vector) -> _Fit:
    """Fit level, slope and changes of slope at these instants."""
    columns = _straight_columns(sight, at)
    values = np.linalg.lstsq(sight.whitening @ columns, sight.whitened, rcond=None)[0]
    load = columns @ values
    left = sight.whitened - sight.whitening @ load
    return _Fit(at, values[2:], load, left, float(left @ left))


def _straight_columns(sight: _Sight, at: Vector) -> Vector:
    rows = sight.rows
    return np.column_stack((np.ones_like(rows), rows - rows.mean(), _ramps(sight, at)))


def _columns(sight: _Sight, fit: _Fit) -> Vector:
    """Return what level, slope, changes of slope and their instants do to the load."""
    return np.column_stack((_straight_columns(sight, fit.at), -fit.bends * _after(sight, fit.at)))


def _after(sight: _Sight, at: Vector) -> Vector:
    """Return the share of each row or block that is after each instant."""
    return np.asarray(np.clip((sight.rows[:, None] - at) / sight.width + 0.5, 0.0, 1.0))


def _ramps(sight: _Sight, at: Vector) -> Vector:
    """Return ramps of slope 1 from each instant on, as means over each row or block."""
    share = _after(sight, at)
    return np.where(share < 1.0, 0.5 * sight.width * share**2, sight.rows[:, None] - at)


def _error(sight: _Sight, fit: _Fit, period_s: float) -> Vector:
    """Return the course's error: what its unknowns leave open, how round each corner is, and bends that aren't seen.

    In this order: by Cholesky's root the first are what they would be without those behind.
    """
    near = np.maximum(0.0, 1.0 - np.abs(sight.rows[:, None] - fit.at))
    rounding = near * fit.bends * (ROUNDED_S / period_s) ** 2 / 24.0
    unseen = _unseen(sight, period_s)
    columns = np.concatenate((_columns(sight, fit), rounding, unseen), axis=1)
    seen = sight.whitening @ columns
    normal = seen.T @ seen
    size = np.sqrt(np.diag(normal))
    normal[np.diag_indices_from(normal)] += np.r_[np.zeros(2 + 2 * fit.at.size), np.ones(fit.at.size + unseen.shape[1])]
    scaled = normal / np.outer(size, size)
    scaled[np.diag_indices_from(scaled)] += SMALL
    root = linalg.cholesky(scaled, lower=True)
    return np.asarray((columns / size) @ linalg.solve_triangular(root, np.eye(size.size), lower=True, trans="T"))


def _variances(sight: _Sight, columns: Vector) -> Vector:
    """Return the variance of each unknown, all others unknown, too."""
    seen = sight.whitening @ columns
    size = np.linalg.norm(seen, axis=0)
    return np.asarray(np.diag(linalg.pinvh((seen / size).T @ (seen / size))) / size**2)


def _unseen(sight: _Sight, period_s: float) -> Vector:
    """Return bends too weak to show, one a column; none where the noise is white."""
    slow = sight.white.deviation_N_m**2 / float(np.sum(sight.white.taps)) ** 2
    if slow < HIDES * sight.white.covariance[0]:
        return np.empty((sight.rows.size, 0))
    # Between two straight pieces of one length a bend's χ² is its square by that length cubed, over 24 of the power.
    shows = math.sqrt(STANDS_OUT * 24.0 * slow / (OVER_S / period_s) ** 3)
    every = UNSEEN_S / period_s
    return UNSEEN_SHARE * shows * _ramps(sight, np.arange(every, sight.rows[-1], every))
