"""Output-error fits: Gauss-Newton with damping, priors and bounds on whitened residuals."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.problem import Matrix, Outputs, Problem
from hil_forceps.diagnosis.spectrum import Flat, Whitener, transform
from hil_forceps.diagnosis.unknowns import Unknowns

Vector = NDArray[np.float64]

MAX_STEPS = 12
AGAIN_STEPS = 3
SMALL_FALL = 0.05  # of χ²: a step that gains less ends the fit
FIRST_DAMPING = 1e-6
MAX_DAMPINGS = 7
TRUSTED = 0.1  # of the expected fall: as long as it comes that close, the sensitivities are still good
BLOCK = 1 << 15  # rows of a product that are made double at a time
RIDGE = 1e-13
LEAST_POWER = 1e-60  # of a column: one that shows nothing is known to nothing, but in numbers


class Fit(NamedTuple):
    """Where a fit ended."""

    u: Vector
    chi2: float  # misfit plus priors
    residual: Flat  # not whitened
    outputs: Outputs
    jacobian: Matrix  # not whitened; at u, or at a point from where it led to u as expected
    covariance: NDArray[np.float64]
    steps: int


def deviations(result: Fit) -> Vector:
    """Return the standard deviation of each unknown, in units of u."""
    return np.sqrt(np.maximum(np.diag(result.covariance), 0.0))


def chi2_of(problem: Problem, residual: Flat, whitener: Whitener, u: Vector) -> float:
    """Return the objective: squared whitened residual plus priors."""
    return _objective(whitener.apply(residual), problem.prior_weights(), u)


def _objective(white: Flat, weights: Vector, u: Vector) -> float:
    return sum_of_squares(white) + float(np.sum(weights * u * u))


def sum_of_squares(flat: Flat) -> float:
    """Return Σ x² in double precision."""
    return float(np.einsum("i,i->", flat, flat, dtype=np.float64))


def gram(left: Matrix, right: Matrix, mapper: Mapper = map) -> NDArray[np.float64]:
    """Return leftᵀ right in double precision: where only priors tell unknowns apart, the last digits count."""

    def product(start: int) -> NDArray[np.float64]:
        first = left[start : start + BLOCK].astype(np.float64)
        second = first if right is left else right[start : start + BLOCK].astype(np.float64)
        return np.asarray(first.T @ second)

    total = np.zeros((left.shape[1], right.shape[1]))
    for each in mapper(product, range(0, left.shape[0], BLOCK)):
        total += each
    return total


def inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a positive definite matrix whose rows are of very different size."""
    return _inverted(*_scaled(matrix))


def _inverted(size: Vector, values: Vector, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a matrix of which `_scaled` has told these."""
    return np.asarray((vectors / values) @ vectors.T / np.outer(size, size))


def _scaled(matrix: NDArray[np.float64]) -> tuple[Vector, Vector, NDArray[np.float64]]:
    """Return the size of each row, and eigenvalues and eigenvectors of the matrix with all rows of size 1."""
    size = np.sqrt(np.maximum(np.diag(matrix), LEAST_POWER))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    return size, np.maximum(values, RIDGE * float(values.max())), vectors


class Held(NamedTuple):
    """Sensitivities that a fit takes as constant: of the first shared unknowns, and of all nuisances behind them."""

    columns: Matrix
    white: Matrix
    gram: NDArray[np.float64]
    shared: int  # how many of the columns belong to shared unknowns


def hold(jacobian: Matrix, shared: int, whitener: Whitener) -> Held:
    """Prepare the sensitivities of a fit for others that begin at it."""
    white = whitener.apply(jacobian)
    return Held(jacobian, white, gram(white, white, whitener.mapper), shared)


def hold_nuisances(found: Fit, problem: Problem, whitener: Whitener) -> Held:
    """Prepare the nuisances' sensitivities of a fit, which hardly hang on what is fitted."""
    return hold(found.jacobian[:, len(problem.shared.items) :], 0, whitener)


def hold_beside(found: Fit, problem: Problem, whitener: Whitener, new: int) -> Held:
    """Prepare all sensitivities but those of the last `new` shared unknowns: to the nuisances as the fit had them.

    Those to the other shared unknowns are taken where the fit is, with the problem as it is now.
    """
    count = len(problem.shared.items)
    columns = problem.shared_columns(found.u, problem.simulate(found.u), range(count - new))
    return hold(np.concatenate((columns, found.jacobian[:, count:]), axis=1), count - new, whitener)


class Sensitivity(NamedTuple):
    """Sensitivities at a point, whitened products ready."""

    columns: Matrix
    white: Matrix
    gram: NDArray[np.float64]


def fit(problem: Problem, u: Vector, whitener: Whitener, *, held: Held | None = None, steps: int = MAX_STEPS) -> Fit:
    """Minimise the objective from u.

    `held`: sensitivities taken as constant, so that only those of the other shared unknowns are computed anew each
    step. Good near a fit, and many times cheaper.
    """
    low, high = problem.bounds()
    weights = problem.prior_weights()
    u = np.clip(u, low, high)
    outputs = problem.simulate(u)
    residual = problem.measured - transform(problem.layout, outputs)
    white = whitener.apply(residual)
    chi2 = _objective(white, weights, u)
    damping = FIRST_DAMPING
    at, fresh = _sensitivity(problem, u, outputs, whitener, held), True
    done = 0
    while done < steps:
        done += 1
        slope = gram(at.white, white[:, None], problem.mapper)[:, 0] - weights * u
        whole = _step(at.gram, slope, weights, 0.0, u, low, high) - u
        if _expected(at.gram, slope, weights, whole) < SMALL_FALL:
            break
        improved = False
        for _ in range(MAX_DAMPINGS):
            candidate = _step(at.gram, slope, weights, damping, u, low, high)
            new_outputs = problem.simulate(candidate)
            new_residual = problem.measured - transform(problem.layout, new_outputs)
            new_white = whitener.apply(new_residual)
            new_chi2 = _objective(new_white, weights, candidate)
            if np.isfinite(new_chi2) and new_chi2 < chi2:
                improved = True
                break
            damping = max(damping, 1e-6) * 30.0
        if not improved and fresh:
            break
        if improved:
            fall, expected = chi2 - new_chi2, _expected(at.gram, slope, weights, candidate - u)
            u, outputs, residual, white, chi2 = candidate, new_outputs, new_residual, new_white, new_chi2
            damping = max(damping / 30.0, FIRST_DAMPING)
            if fall < SMALL_FALL:
                break
        fresh = not improved or abs(fall - expected) > TRUSTED * expected
        if fresh:
            at = _sensitivity(problem, u, outputs, whitener, held)
    covariance = inverse(at.gram + np.diag(weights))
    return Fit(u, chi2, residual, outputs, at.columns, covariance, done)


def follow(problem: Problem, u: Vector, whitener: Whitener, held: Held) -> tuple[Vector, float]:
    """Return u with all held unknowns where a linear step puts them, or u where that is worse; and χ² there."""
    rest = np.r_[: held.shared, held.shared + u.size - held.columns.shape[1] : u.size]
    weights = problem.prior_weights()[rest]
    low, high = (bound[rest] for bound in problem.bounds())
    residual = problem.measured - problem.predicted(u)
    slope = gram(held.white, whitener.apply(residual)[:, None], problem.mapper)[:, 0] - weights * u[rest]
    moved = u.copy()
    moved[rest] = _step(held.gram, slope, weights, 0.0, u[rest], low, high)
    before = chi2_of(problem, residual, whitener, u)
    after = chi2_of(problem, problem.measured - problem.predicted(moved), whitener, moved)
    return (moved, after) if after < before else (u, before)


def fit_own(problem: Problem, u: Vector, whitener: Whitener, steps: int) -> Fit:
    """Fit only what belongs to each run, the shared unknowns held as in u; the fit returned has those alone."""
    bare = replace(problem.with_shared(Unknowns(())), base=problem.theta(u))
    return fit(bare, u[len(problem.shared.items) :], whitener, steps=steps)


def fit_again(problem: Problem, found: Fit, whitener: Whitener) -> Fit:
    """Fit with another noise, which moves a fit little: with the sensitivities that it had."""
    held = hold(found.jacobian, len(problem.shared.items), whitener)
    return fit(problem, found.u, whitener, held=held, steps=AGAIN_STEPS)


def _sensitivity(problem: Problem, u: Vector, outputs: Outputs, whitener: Whitener, held: Held | None) -> Sensitivity:
    if held is None:
        columns = problem.jacobian(u, outputs)
        white = whitener.apply(columns)
        return Sensitivity(columns, white, gram(white, white, problem.mapper))
    first, count = held.shared, len(problem.shared.items)
    if first == count:
        return Sensitivity(held.columns, held.white, held.gram)
    fresh = problem.shared_columns(u, outputs, range(first, count))
    white = whitener.apply(fresh)
    cross, own = gram(held.white, white, problem.mapper), gram(white, white, problem.mapper)
    old = held.gram
    products = np.block(
        [
            [old[:first, :first], cross[:first], old[:first, first:]],
            [cross[:first].T, own, cross[first:].T],
            [old[first:, :first], cross[first:], old[first:, first:]],
        ]
    )
    return Sensitivity(
        np.concatenate((held.columns[:, :first], fresh, held.columns[:, first:]), axis=1),
        np.concatenate((held.white[:, :first], white, held.white[:, first:]), axis=1),
        products,
    )


def _expected(normal: NDArray[np.float64], slope: Vector, weights: Vector, step: Vector) -> float:
    """Return by how much the objective would fall if the sensitivities held all the way."""
    return float(2.0 * step @ slope - step @ normal @ step - np.sum(weights * step * step))


def _step(
    normal: NDArray[np.float64], slope: Vector, weights: Vector, damping: float, u: Vector, low: Vector, high: Vector
) -> Vector:
    """Return the next point: where the objective would be least within the bounds if the sensitivities held."""
    system = normal + np.diag(weights)
    system = system + damping * np.diag(np.diag(system) + 1e-12)
    size, values, vectors = _scaled(system)
    there = u + _inverted(size, values, vectors) @ slope
    if not np.any((there < low) | (there > high)):
        return there
    # Putting all that cross on their bounds at once may lead uphill: beside the first, others may not cross any more.
    root = np.sqrt(values)
    found = optimize.lsq_linear(
        root[:, None] * vectors.T,
        vectors.T @ (slope / size) / root,
        ((low - u) * size, (high - u) * size),
        method="bvls",
    )
    return np.asarray(np.clip(u + found.x / size, low, high))
