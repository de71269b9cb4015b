"""The load's course between its jumps, and how far the load cell's noise leaves it open.

A spline with as many knots as its bends ask for, fitted to the load as measured with the noise's own weights: what
noise does to such a fit is known instant by instant, as a matrix. Where the load bends the knots are close and much of
the noise gets through, elsewhere little. More knots than smoothing would need keep the course from being bent: noise
that is known costs less than a bend that isn't (generalised least squares; de Boor, A Practical Guide to Splines).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.interpolate import BSpline

from hil_forceps.diagnosis.smoothing import (
    FEWEST_ROWS,
    ORDER,
    LoadNoise,
    NoiseFilter,
    local_cutoff,
    noise_filter,
    smooth_load,
)

Vector = NDArray[np.float64]
Matrix = NDArray[np.float32]

DEGREE = 5
# In a period of the fastest that smoothing would let through; two would just hold it. With three of a cubic spline the
# load's bends were followed to 2 % of the power of its error: several times the encoder's noise, and named.
KNOTS = 5.0
MOST_KNOTS = 2000  # of a run: some 50 s of work; each is a column of its noise
RIDGE = 1e-9


class LoadCourse(NamedTuple):
    """The load without its noise, and its error: `error` (rows, k) times k independent standard normal numbers.

    None where these would be too many: then the load is smoothed.
    """

    load: Vector
    error: Matrix | None


def load_course(tau_w: Vector, edge_rows: NDArray[np.intp], period_s: float, noise: LoadNoise) -> LoadCourse:
    """Return the course of a measured load [N m] with that noise; the rows after which it jumps are kept apart."""
    if float(noise.power.max()) <= 0.0:
        return LoadCourse(tau_w, np.empty((tau_w.size, 0), dtype=np.float32))
    white = noise_filter(noise, period_s)
    pieces = np.split(tau_w, edge_rows + 1)
    wanted = [_knots_until(piece, white) for piece in pieces]
    if sum(float(knots[-1]) for knots in wanted) > MOST_KNOTS:
        return LoadCourse(smooth_load(tau_w, edge_rows, period_s, noise), None)
    fits = [_fitted(piece, knots, white) for piece, knots in zip(pieces, wanted, strict=True)]
    error = linalg.block_diag(*(error for _, error in fits)).astype(np.float32)
    return LoadCourse(np.concatenate([load for load, _ in fits]), error)


def _knots_until(piece: Vector, white: NoiseFilter) -> Vector:
    """Return how many knots are wanted before each row (rows + 1)."""
    if piece.size < FEWEST_ROWS:
        return np.linspace(0.0, 1.0, piece.size + 1)
    return np.concatenate(([0.0], np.cumsum(np.minimum(KNOTS * local_cutoff(piece, white), 0.5))))


def _fitted(piece: Vector, knots_until: Vector, white: NoiseFilter) -> tuple[Vector, Vector]:
    if piece.size <= DEGREE:
        return piece, white.deviation_N_m * np.eye(piece.size)
    count = max(1, min(int(np.ceil(knots_until[-1])), piece.size - DEGREE))
    inner = np.interp(np.linspace(0.0, knots_until[-1], count + 1), knots_until, np.arange(piece.size + 1))
    knots = np.concatenate((np.full(DEGREE, inner[0]), inner, np.full(DEGREE, inner[-1])))
    basis = BSpline.design_matrix(np.arange(piece.size) + 0.5, knots, DEGREE)
    filtered = _filter_matrix(white, piece.size)
    seen = filtered @ basis
    normal = (seen.T @ seen).toarray()
    normal[np.diag_indices_from(normal)] *= 1.0 + RIDGE
    root = linalg.cholesky(normal, lower=True)
    load = basis @ linalg.cho_solve((root, True), seen.T @ (filtered @ piece))
    error = basis @ linalg.solve_triangular(root, np.eye(root.shape[0]), lower=True, trans="T")
    return np.asarray(load), np.asarray(error)


def _filter_matrix(white: NoiseFilter, rows: int) -> sparse.csr_matrix:
    """Return the matrix that makes the noise of so many rows white, of variance 1; exact from the first row on."""
    first = min(ORDER, rows)
    taps = white.taps[: first + (rows > ORDER)] / white.deviation_N_m
    lags = range(taps.size)
    whole = sparse.diags_array([np.full(rows - lag, taps[lag]) for lag in lags], offsets=[-lag for lag in lags])
    start = linalg.cholesky(linalg.toeplitz(white.covariance[:first]), lower=True)
    head = sparse.csr_matrix(linalg.solve_triangular(start, np.eye(first), lower=True))
    top = sparse.hstack((head, sparse.csr_matrix((first, rows - first))))
    return sparse.csr_matrix(sparse.vstack((top, whole.tocsr()[first:])))
