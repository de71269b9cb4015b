"""The load's course between its jumps, and how far the load cell's noise leaves it open.

Straight pieces where these hold it (`straight.py`). Else a spline with as many knots as its bends ask for, fitted to
the load as measured with the noise's own weights: what noise does to such a fit is known instant by instant, as a
matrix. Where the load bends the knots are close and much of the noise gets through, elsewhere little (generalised least
squares; de Boor, A Practical Guide to Splines).

The error is told of more knots than the course itself has. What bends too fast for its knots is hidden in the load's
noise, but not in an encoder's: taken for an effect, a thousandth of the load's error is. Noise that is told and isn't
there costs less. It would also ring the simulated wire, and bend what is fitted to it; so the course has fewer.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.interpolate import BSpline

from hil_forceps.diagnosis.small_jumps import SmallJump, small_jumps
from hil_forceps.diagnosis.smoothing import (
    FEWEST_ROWS,
    LoadNoise,
    NoiseFilter,
    local_cutoff,
    noise_filter,
    smooth_load,
    whitening_matrix,
)
from hil_forceps.diagnosis.straight import BLOCKS, PieceCourse, straight_course

Vector = NDArray[np.float64]
Matrix = NDArray[np.float32]

DEGREE = 5
# In a period of the fastest that smoothing would let through; two would just hold it. Bends that cannot be followed
# stand out in the channels of four runs by 100 to 650 of χ² with three knots of the error, and by 40 to 270 with four.
KNOTS = 2.5
ERROR_KNOTS = 4.0
MOST_KNOTS = 2000  # of a run: some 50 s of work; each is a column of its noise
MOST_PER_ROW = 0.5  # knots
RIDGE = 1e-9


class LoadCourse(NamedTuple):
    """The load without its noise, and its error: `error` (rows, k) times k independent standard normal numbers.

    None where these would be too many: then the load is smoothed.
    """

    load: Vector
    error: Matrix | None
    straight: bool = False  # whether straight pieces hold all of it
    fitted: int = 0  # how many columns of its error, the first, it was fitted with


def load_course(tau_w: Vector, edge_rows: NDArray[np.intp], period_s: float, noise: LoadNoise) -> LoadCourse:
    """Return the course of a measured load [N m] with that noise; the rows after which it jumps are kept apart."""
    if float(noise.power.max()) <= 0.0:
        return LoadCourse(tau_w, np.empty((tau_w.size, 0), dtype=np.float32))
    white = noise_filter(noise, period_s)
    small = small_jumps(np.split(tau_w, edge_rows + 1), white, period_s) if edge_rows.size else []
    edge_rows = np.sort(np.concatenate((edge_rows, [jump.row for jump in small]))).astype(np.intp)
    pieces = np.split(tau_w, edge_rows + 1)
    block = max(1, tau_w.size // BLOCKS)
    cutoffs = [_cutoff(piece, white) for piece in pieces]
    courses = [
        _likelier(straight_course(piece, block, period_s, noise), piece, cutoff, white)
        for piece, cutoff in zip(pieces, cutoffs, strict=True)
    ]
    bent = [float(cutoff.sum()) for course, cutoff in zip(courses, cutoffs, strict=True) if course is None]
    if ERROR_KNOTS * sum(bent) > MOST_KNOTS:
        return LoadCourse(smooth_load(tau_w, edge_rows, period_s, noise), None)
    found = [
        straight if straight is not None else _splined(piece, cutoff, white)
        for piece, straight, cutoff in zip(pieces, courses, cutoffs, strict=True)
    ]
    load = np.concatenate([course.load for course in found])
    fitted = linalg.block_diag(*(course.error[:, : course.fitted] for course in found))
    unseen = linalg.block_diag(*(course.error[:, course.fitted :] for course in found))
    error = np.concatenate((fitted, _instants(small, load), unseen), axis=1).astype(np.float32)
    return LoadCourse(load, error, None not in courses, error.shape[1] - unseen.shape[1])


def _instants(small: Sequence[SmallJump], load: Vector) -> Vector:
    """Return what small jumps that come a deviation late do to a load, one a column."""
    late = np.zeros((load.size, len(small)))
    for column, jump in enumerate(small):
        rows = slice(jump.row, jump.row + 2)
        late[rows, column] = 0.5 * jump.deviation_rows * np.diff(load[rows])
    return late


def _likelier(course: PieceCourse | None, piece: Vector, cutoff: Vector, white: NoiseFilter) -> PieceCourse | None:
    """Return a course of straight pieces, if it is likelier than a spline by what both leave and how free they are.

    Any load can be cut into pieces so short that its noise hides how they bend (a smooth one's had 170 unknowns where a
    spline has 105, and was off by 487 of χ² where the spline is by 137). Akaike, IEEE Trans. Autom. Control 19, 1974.
    """
    if course is None:
        return None
    whitened = whitening_matrix(white, piece.size)
    spline, knots = _through(piece, cutoff, whitened)
    straight, smooth = (float(np.sum((whitened @ (piece - load)) ** 2)) for load in (course.load, spline))
    return course if straight + 2.0 * course.fitted < smooth + 2.0 * knots else None


def _cutoff(piece: Vector, white: NoiseFilter) -> Vector:
    """Return the fastest that the load may hold at each row, of the sampling frequency."""
    return local_cutoff(piece, white) if piece.size >= FEWEST_ROWS else np.full(piece.size, 1.0 / piece.size)


def _splined(piece: Vector, cutoff: Vector, white: NoiseFilter) -> PieceCourse:
    """Return a spline of a piece, and its error."""
    if piece.size <= DEGREE:
        return PieceCourse(piece, white.deviation_N_m * np.eye(piece.size), piece.size)
    whitened = whitening_matrix(white, piece.size)
    load, _ = _through(piece, cutoff, whitened)
    basis, _, root = _spline(cutoff, ERROR_KNOTS, whitened)
    error = basis @ linalg.solve_triangular(root, np.eye(root.shape[0]), lower=True, trans="T")
    return PieceCourse(load, np.asarray(error), error.shape[1])


def _through(piece: Vector, cutoff: Vector, whitened: sparse.csr_matrix) -> tuple[Vector, int]:
    """Return the spline that fits a piece best, and its number of unknowns."""
    basis, seen, root = _spline(cutoff, KNOTS, whitened)
    return np.asarray(basis @ linalg.cho_solve((root, True), seen.T @ (whitened @ piece))), root.shape[0]


def _spline(
    cutoff: Vector, per_period: float, whitened: sparse.csr_matrix
) -> tuple[sparse.csr_array, sparse.csr_array, Vector]:
    """Return a spline's basis, the basis as the filtered load shows it, and the root of its normal matrix."""
    rows = cutoff.size
    until = np.concatenate(([0.0], np.cumsum(np.minimum(per_period * cutoff, MOST_PER_ROW))))
    count = max(1, min(int(np.ceil(until[-1])), rows - DEGREE))
    inner = np.interp(np.linspace(0.0, until[-1], count + 1), until, np.arange(rows + 1))
    knots = np.concatenate((np.full(DEGREE, inner[0]), inner, np.full(DEGREE, inner[-1])))
    basis = BSpline.design_matrix(np.arange(rows) + 0.5, knots, DEGREE)
    seen = whitened @ basis
    normal = (seen.T @ seen).toarray()
    normal[np.diag_indices_from(normal)] *= 1.0 + RIDGE
    return basis, seen, linalg.cholesky(normal, lower=True)
