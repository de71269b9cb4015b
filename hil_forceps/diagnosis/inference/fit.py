"""Fit parameters by prediction errors: Gauss-Newton on whitened innovations.

Weights and gains of the filter are taken anew at each step and held within it, so that what is minimised is the sum of
squares of innovations and not the size of their variances (Ljung, System Identification, 2nd ed., chapter 7).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from hil_forceps.diagnosis.inference.parameters import Free
from hil_forceps.diagnosis.state_space.passes import Direction, Filterable, Gram, Mapper, Passes, gram, pass_all

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

MAX_STEPS = 8
CONVERGED_CHI2 = 0.02  # that a step is to gain: no parameter is further than 0.14 deviations from its best
STATIONARY_CHI2 = 1.0  # that a step did gain: rows that come and go as evidence move χ² by as much
MAX_HALVINGS = 4
DIFFERENCE = 1e-4  # of a parameter's scale, for its answer: the plant is next to linear over it
LARGEST_RATIO = 2.0  # by which a positive parameter may change in a step


class Fit(NamedTuple):
    """Parameters as fitted, with what they were fitted by."""

    free: tuple[Free, ...]
    passes: Passes
    covariance: Matrix  # of the free parameters in units of their scale

    @property
    def values(self) -> Vector:
        """Fitted values."""
        return np.asarray(self.passes.theta[[f.place for f in self.free]])

    @property
    def deviations(self) -> Vector:
        """Their standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)) * np.array([f.scale for f in self.free]))


def prior_of(free: Sequence[Free], theta: Vector) -> tuple[Vector, Vector]:
    """Return deviations from the prior in units of the scale, and its precision."""
    away = np.array([(theta[f.place] - f.centre) / f.scale for f in free])
    precision = np.array([1.0 if f.prior else 0.0 for f in free])
    return away, precision


def directions_of(free: Sequence[Free], theta: Vector) -> list[Direction]:
    """Return the directions of some parameters, each in units of its scale."""
    found = []
    for f in free:
        step = DIFFERENCE * max(f.scale, abs(theta[f.place]))
        if theta[f.place] + step > f.high:
            step = -step
        changed = theta.copy()
        changed[f.place] += step
        found.append(Direction(changed, f.scale / step))
    return found


def penalised(passes: Passes, free: Sequence[Free], other: Passes) -> float:
    """Return the log posterior of `passes` where both passes have evidence."""
    total = 0.0
    for mine, its in zip(passes.runs, other.runs, strict=True):
        both = mine.counts & its.counts
        total += float(mine.log_likelihood[both].sum())
    away, precision = prior_of(free, passes.theta)
    return total - 0.5 * float(away @ (precision * away))


def fit(runs: Sequence[Filterable], theta: Vector, free: Sequence[Free], mapper: Mapper) -> Fit:
    """Return the fit from `theta` on."""
    return fit_from(runs, pass_all(runs, theta, mapper), free, mapper)


def fit_from(runs: Sequence[Filterable], passes: Passes, free: Sequence[Free], mapper: Mapper) -> Fit:
    """Return the fit from passes over its runs on."""
    inverse = np.eye(len(free))
    for _ in range(MAX_STEPS):
        newton = _newton(passes, free, mapper)
        inverse = newton.inverse
        if newton.decrement < CONVERGED_CHI2:
            break
        stepped = _accepted(runs, passes, free, newton.step, mapper)
        if stepped is None:
            break
        passes, gain = stepped
        if gain < STATIONARY_CHI2:
            break
    return Fit(tuple(free), passes, inverse)


class _Newton(NamedTuple):
    inverse: Matrix  # of the posterior's curvature
    step: Vector  # in units of the scales
    decrement: float  # the fall of χ² that the step is to bring


def _newton(passes: Passes, free: Sequence[Free], mapper: Mapper) -> _Newton:
    found = _finite(gram(passes, directions_of(free, passes.theta), mapper))
    away, precision = prior_of(free, passes.theta)
    downhill = -found.score - precision * away
    inverse = inverted(found.information + np.diag(precision))
    step = inverse @ downhill
    return _Newton(inverse, step, float(downhill @ step))


def _finite(found: Gram) -> Gram:
    """Return a Gram matrix without what is said of parameters beyond which the simulation has no finite answer."""
    good = np.isfinite(np.diag(found.information)) & np.isfinite(found.score)
    information = np.where(np.outer(good, good), found.information, 0.0)
    return found._replace(information=information, score=np.where(good, found.score, 0.0))


def inverted(curvature: Matrix) -> Matrix:
    """Return the inverse of a symmetric matrix, scaled first; what it doesn't hold gets a wide but finite variance."""
    root = np.sqrt(np.maximum(np.diag(curvature), 1e-12))
    scaled = curvature / np.outer(root, root)
    values, vectors = linalg.eigh(scaled)
    values = np.maximum(values, 1e-11)
    inverse = (vectors / values) @ vectors.T
    return np.asarray(inverse / np.outer(root, root))


def _accepted(
    runs: Sequence[Filterable], passes: Passes, free: Sequence[Free], step: Vector, mapper: Mapper
) -> tuple[Passes, float] | None:
    """Return the passes a step on and what it gains of χ², shortened until no worse; None where no step is better."""
    factor = 1.0
    for _ in range(MAX_HALVINGS):
        theta = moved(passes.theta, free, factor * step)
        tried = pass_all(runs, theta, mapper)
        before, after = penalised(passes, free, tried), penalised(tried, free, passes)
        # Variances that change with the parameters move it, too: near the best, by less than what is called stationary.
        if np.isfinite(after) and after > before - 0.5 * STATIONARY_CHI2:
            return tried, 2.0 * (after - before)
        factor *= 0.3
    return None


def moved(theta: Vector, free: Sequence[Free], step: Vector) -> Vector:
    """Return parameters a step on, within their bounds; `step` is in units of the scales."""
    changed = theta.copy()
    for f, s in zip(free, step, strict=True):
        old = theta[f.place]
        value = old + f.scale * float(s)
        if f.low >= 0.0 and not f.amplitude and old > 0.0:
            least = 0.0 if "coulomb" in f.name and value <= 0.0 else old / LARGEST_RATIO
            value = min(max(value, least), max(LARGEST_RATIO * old, f.scale))
        changed[f.place] = min(max(value, f.low), f.high)
    return changed
