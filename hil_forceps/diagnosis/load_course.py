"""The load's course between its jumps, and how far the load cell's noise leaves it open.

Straight pieces where these hold it (`straight.py`), else as smooth as is likeliest (`smooth_course.py`). What noise
does to either is known instant by instant, as a matrix.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from hil_forceps.diagnosis.small_jumps import SmallJump, small_jumps
from hil_forceps.diagnosis.smooth_course import knot_count, smooth_course
from hil_forceps.diagnosis.smoothing import (
    FEWEST_ROWS,
    LoadNoise,
    NoiseFilter,
    local_cutoff,
    noise_filter,
    smooth_load,
)
from hil_forceps.diagnosis.straight import BLOCKS, PieceCourse, straight_course

Vector = NDArray[np.float64]
Matrix = NDArray[np.float32]

CLEARLY = 10.0  # of χ²: between jumps most pieces are one line by either course, and differ by less than half of it
MOST_KNOTS = 2000  # of a run: some 50 s of work; each is a column of its noise


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
    straight = [straight_course(piece, block, period_s, noise) for piece in pieces]
    bent = [knot_count(cutoff) for course, cutoff in zip(straight, cutoffs, strict=True) if course is None]
    if sum(bent) > MOST_KNOTS:
        return LoadCourse(smooth_load(tau_w, edge_rows, period_s, noise), None)
    places = zip(straight, pieces, cutoffs, strict=True)
    found = [_likelier(course, piece, cutoff, white) for course, piece, cutoff in places]
    load = np.concatenate([course.load for course in found])
    fitted = linalg.block_diag(*(course.error[:, : course.fitted] for course in found))
    unseen = linalg.block_diag(*(course.error[:, course.fitted :] for course in found))
    error = np.concatenate((fitted, _instants(small, load), unseen), axis=1).astype(np.float32)
    as_straight = all(course is each for course, each in zip(found, straight, strict=True))
    return LoadCourse(load, error, as_straight, error.shape[1] - unseen.shape[1])


def _instants(small: Sequence[SmallJump], load: Vector) -> Vector:
    """Return what small jumps that come a deviation late do to a load, one a column."""
    late = np.zeros((load.size, len(small)))
    for column, jump in enumerate(small):
        rows = slice(jump.row, jump.row + 2)
        late[rows, column] = 0.5 * jump.deviation_rows * np.diff(load[rows])
    return late


def _likelier(course: PieceCourse | None, piece: Vector, cutoff: Vector, white: NoiseFilter) -> PieceCourse:
    """Return a course of straight pieces, unless a smooth one is clearly likelier.

    Both by what they leave and how free they are. Any load can be cut into pieces so short that its noise hides how
    they bend (a smooth one's had 170 unknowns where a spline has 105, and was off by 487 of χ² where the spline is by
    137). Akaike, IEEE Trans. Autom. Control 19, 1974.
    """
    smooth = smooth_course(piece, cutoff, white)
    if course is not None and course.chi2 + 2.0 * course.fitted < smooth.chi2 + 2.0 * smooth.freedom + CLEARLY:
        return course
    return PieceCourse(smooth.load, smooth.error, smooth.error.shape[1], smooth.chi2)


def _cutoff(piece: Vector, white: NoiseFilter) -> Vector:
    """Return the fastest that the load may hold at each row, of the sampling frequency."""
    return local_cutoff(piece, white) if piece.size >= FEWEST_ROWS else np.full(piece.size, 1.0 / piece.size)
