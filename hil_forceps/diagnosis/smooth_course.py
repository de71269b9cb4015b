"""The course of a load that bends smoothly: a spline that is as smooth as is likeliest.

A spline fitted by least squares lets noise through at all frequencies that its knots can follow, whether the load has
anything there or not; and what noise of the load does to the motor is sixty times the encoder's rounding. So the
differences of its coefficients, of some order, are taken to be independent normal numbers (penalised splines; Eilers
and Marx, Statist. Sci. 11, 1996). Their order, their size, and how much closer the knots are where the load bends more
are those that make the load as measured likeliest (Wahba, Ann. Statist. 13, 1985). The error is what the measurement
then leaves open.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, sparse
from scipy.interpolate import BSpline

from hil_forceps.diagnosis.smoothing import NoiseFilter, whitening_matrix

Vector = NDArray[np.float64]

DEGREE = 5
KNOTS = 4.0  # in a period of the fastest that smoothing would let through; two would just hold it
HIGHEST = 0.125  # cutoff that knots are made for: there is one in two rows then
ORDERS = (2, 3, 4, 5, 6)  # of the differences
FOLLOWS = (0.0, 0.5, 1.0)  # how much closer the knots are where the load bends more: the power of its local cutoff
SLACKEST = 1.5  # of the logarithm to base 2 of a cutoff, over that which the knots are made for
CONDITION = 1e11  # how much stiffer than the measurement differences may be held
TELLING = 0.1  # of that logarithm
RIDGE = 1e-9


class SmoothCourse(NamedTuple):
    """The course of a load between two jumps; its error is `error` (rows, k) times k standard normal numbers."""

    load: Vector
    error: Vector
    chi2: float  # what it leaves of the load
    freedom: float  # how many unknowns that fit it as well it stands for


class _Seen(NamedTuple):
    """A spline's basis, and its normal equations for a load as the filtered one shows it, in bands."""

    basis: sparse.csr_array
    normal: Vector
    slope: Vector


class _Likeliest(NamedTuple):
    improbability: float  # −2 log of the likelihood, but for what all have
    seen: _Seen
    bands: Vector  # of the normal equations with the prior


def knot_count(cutoff: Vector) -> float:
    """Return about how many knots the course of a load has, at most; `cutoff`: of its smoothing, row by row."""
    return KNOTS * float(np.minimum(cutoff, HIGHEST).sum())


def smooth_course(piece: Vector, cutoff: Vector, white: NoiseFilter) -> SmoothCourse:
    """Return the course of a load [N m] without jumps.

    `cutoff`: of the smoothing that it allows, row by row, of the sampling frequency. `white`: makes its noise white.
    """
    if piece.size <= DEGREE:
        return SmoothCourse(piece, white.deviation_N_m * np.eye(piece.size), 0.0, float(piece.size))
    whitening = whitening_matrix(white, piece.size)
    whitened = whitening @ piece
    # Levels and slopes, which have no prior, would else count as so many times likelier as their unit is smaller.
    size = max(float(piece.std()), white.deviation_N_m)
    seen = [_seen(_knots(cutoff, follows), whitening, whitened) for follows in FOLLOWS]
    best = min(
        (_likeliest(each, size, order) for each in seen for order in ORDERS), key=lambda found: found.improbability
    )
    basis, root = best.seen.basis, _root(best.bands)
    load = np.asarray(basis @ linalg.cho_solve((root, True), best.seen.slope))
    error = np.asarray(basis @ linalg.solve_triangular(root, np.eye(root.shape[0]), lower=True, trans="T"))
    left = whitened - whitening @ load
    return SmoothCourse(load, error, float(left @ left), float(np.sum((whitening @ error) ** 2)))


def _knots(cutoff: Vector, follows: float) -> Vector:
    """Return a spline's knots, in rows; closer where the load bends more, by that power of its cutoff."""
    rows = cutoff.size
    cutoff = np.minimum(cutoff, HIGHEST)
    usual = np.exp(np.mean(np.log(cutoff)))
    until = np.concatenate(([0.0], np.cumsum(KNOTS * usual * (cutoff / usual) ** follows)))
    count = max(1, min(math.ceil(until[-1]), rows - DEGREE))
    inner = np.interp(np.linspace(0.0, until[-1], count + 1), until, np.arange(rows + 1))
    return np.concatenate((np.full(DEGREE, inner[0]), inner, np.full(DEGREE, inner[-1])))


def _seen(knots: Vector, whitening: sparse.csr_matrix, whitened: Vector) -> _Seen:
    basis = BSpline.design_matrix(np.arange(whitened.size) + 0.5, knots, DEGREE)
    seen = whitening @ basis
    normal = sparse.coo_array(seen.T @ seen)
    width = max(int(np.abs(normal.row - normal.col).max()), min(ORDERS[-1], basis.shape[1] - 1))
    bands = _bands(normal, width)
    bands[0] *= 1.0 + RIDGE
    return _Seen(basis, bands, np.asarray(seen.T @ whitened))


def _bands(matrix: sparse.coo_array, width: int) -> Vector:
    """Return the diagonals of a symmetric matrix, the main one first."""
    below = matrix.row >= matrix.col
    bands = np.zeros((width + 1, matrix.shape[1]))
    np.add.at(bands, (matrix.row[below] - matrix.col[below], matrix.col[below]), matrix.data[below])
    return bands


def _likeliest(seen: _Seen, size: float, order: int) -> _Likeliest:
    """Return the likeliest strength of a prior on the differences of that order."""
    count = seen.slope.size
    if count <= order + 1:
        return _Likeliest(math.inf, seen, seen.normal)
    differences = _differences(count, order)
    bands = _bands(sparse.coo_array(differences.T @ differences), seen.normal.shape[0] - 1)
    # As strong as the measurement of a coefficient at the frequency that the knots are made for.
    usual = float(np.median(seen.normal[0])) / (2.0 * math.sin(math.pi / KNOTS)) ** (2 * order)
    known = _log_determinant(count, order) - 2.0 * order * math.log(size)

    def strength(logarithm: float) -> float:
        return float(usual * 2.0 ** (-2.0 * order * logarithm))

    def improbability(logarithm: float) -> float:
        of_each = strength(logarithm)
        root = linalg.cholesky_banded(seen.normal + of_each * bands, lower=True, check_finite=False)
        explained = seen.slope @ linalg.cho_solve_banded((root, True), seen.slope, check_finite=False)
        return float(2.0 * np.log(root[0]).sum() - explained - (count - order) * math.log(of_each) - known)

    stiffest = 0.5 - 0.5 * math.log2(CONDITION) / order
    found = optimize.minimize_scalar(
        improbability, bounds=(stiffest, SLACKEST), method="bounded", options={"xatol": TELLING}
    )
    return _Likeliest(float(found.fun), seen, seen.normal + strength(float(found.x)) * bands)


def _differences(count: int, order: int) -> sparse.csr_array:
    """Return the matrix that takes the differences of some order of so many numbers."""
    taps = [(-1.0) ** (order - k) * math.comb(order, k) for k in range(order + 1)]
    diagonals = [np.full(count - order, tap) for tap in taps]
    return sparse.csr_array(sparse.diags_array(diagonals, offsets=list(range(order + 1)), shape=(count - order, count)))


def _log_determinant(count: int, order: int) -> float:
    """Return log det D Dᵀ of the matrix D of differences.

    It is that of Vᵀ V, where the columns of V are polynomials (i over j), whose differences are 0: below the first
    differences of each order less than this one D is a matrix of determinant 1, and V is the head of its inverse.
    """
    places = np.arange(count, dtype=np.float64)
    columns = [np.ones(count)]
    for j in range(1, order):
        columns.append(columns[-1] * (places - j + 1.0) / j)
    polynomials = np.stack(columns, axis=1)
    sizes = np.abs(polynomials).max(axis=0)
    triangle = np.linalg.qr(polynomials / sizes, mode="r")
    return float(2.0 * np.sum(np.log(np.abs(np.diag(triangle))) + np.log(sizes)))


def _root(bands: Vector) -> Vector:
    """Return Cholesky's root of a matrix given by its bands."""
    narrow = linalg.cholesky_banded(bands, lower=True)
    count = narrow.shape[1]
    return np.asarray(
        sparse.diags_array(
            [row[: count - k] for k, row in enumerate(narrow)],
            offsets=[-k for k in range(narrow.shape[0])],
            shape=(count, count),
        ).toarray()
    )
