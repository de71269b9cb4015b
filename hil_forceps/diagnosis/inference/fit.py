"""Fit parameters by prediction errors: Gauss-Newton on whitened residuals.

Weights and gains of the filter are taken anew at each step and held within it, so that what is minimised is Huber's
loss of the innovations and not the size of their variances (Ljung, System Identification, 2nd ed., chapter 7).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

from hil_forceps.diagnosis.evidence import Direction, Evidence, Gram, Mapper, Passes, gram, pass_all
from hil_forceps.diagnosis.inference.parameters import Free

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

MAX_STEPS = 8
CONVERGED_CHI2 = 0.02  # that a step is to gain: no parameter is further than 0.14 deviations from its best
STATIONARY_CHI2 = 1.0  # that a step did gain: rows that come and go as evidence move χ² by as much
MAX_HALVINGS = 4
MAX_ROW_CHOICES = 3  # a first fit leaves the rest of a skew to first order, a second one is next to exact
# Of a parameter's scale, for finite differences. Over ten times as much, a radius changes torques by as much as small
# dry friction does.
DIFFERENCE_SHARE = 1e-5
MAX_STEP_RATIO = 2.0  # by which a positive parameter may change in a step
# Of what a step is to bring, that it and all steps behind it bring at most: each leaves half of it or less, where
# Gauss-Newton converges at all (Σ 2⁻ⁿ).
MAX_GAIN_OVER_DECREMENT = 2.0


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


class Posterior(NamedTuple):
    """What a fit to other runs knows of the parameters: a normal distribution."""

    theta: Vector
    precision: Matrix  # in units of the scales

    @classmethod
    def of(cls, found: Fit) -> "Posterior":
        """Return what a fit knows."""
        return cls(found.passes.theta, inverted(found.covariance))

    def away(self, free: Sequence[Free], theta: Vector) -> Vector:
        """Return the deviations of parameters from it, in units of their scales."""
        return np.array([(theta[f.place] - self.theta[f.place]) / f.scale for f in free])


def _away(free: Sequence[Free], theta: Vector, known: Posterior | None) -> tuple[Vector, Matrix]:
    """Return deviations from what is known before, in units of the scales, and its precision."""
    if known is None:
        away, precision = prior_of(free, theta)
        return away, np.diag(precision)
    return known.away(free, theta), known.precision


def directions_of(free: Sequence[Free], theta: Vector) -> list[Direction]:
    """Return the directions of some parameters, each in units of its scale."""
    found = []
    for f in free:
        step = DIFFERENCE_SHARE * max(f.scale, abs(theta[f.place]))
        if theta[f.place] + step > f.high:
            step = -step
        changed = theta.copy()
        changed[f.place] += step
        found.append(Direction(changed, f.scale / step))
    return found


def penalised(passes: Passes, free: Sequence[Free], other: Passes, known: Posterior | None = None) -> float:
    """Return the log posterior of `passes` where both passes have evidence; `known`: in place of the priors."""
    total = 0.0
    for mine, its in zip(passes.runs, other.runs, strict=True):
        both = mine.as_recorded(mine.counts) & its.as_recorded(its.counts)
        total += float(mine.as_recorded(mine.log_likelihood)[both].sum())
    away, precision = _away(free, passes.theta, known)
    return total - 0.5 * float(away @ precision @ away)


def chi2_above(base: Fit, passes: Passes, free: Sequence[Free]) -> float:
    """Return twice the log posterior of passes above that of a fit, where both have evidence."""
    return 2.0 * (penalised(passes, free, base.passes) - penalised(base.passes, base.free, passes))


class RequiredGain(NamedTuple):
    """What a fit must reach to be of use; where it can't, it ends early."""

    base: Fit
    chi2: float  # above `base`

    def is_out_of_reach(self, passes: Passes, free: Sequence[Free], decrement: float) -> bool:
        """Tell whether a fit that is to gain so much with its next step stays below."""
        return chi2_above(self.base, passes, free) + MAX_GAIN_OVER_DECREMENT * decrement < self.chi2


def fit(runs: Sequence[Evidence], theta: Vector, free: Sequence[Free], mapper: Mapper) -> Fit:
    """Return the fit from `theta` on, or from the nearest values within bounds."""
    start = theta.copy()
    for f in free:
        start[f.place] = min(max(theta[f.place], f.least), f.high)
    return fit_from(runs, pass_all(runs, start, mapper), free, mapper)


def fit_from(
    runs: Sequence[Evidence],
    passes: Passes,
    free: Sequence[Free],
    mapper: Mapper,
    known: Posterior | None = None,
    required: RequiredGain | None = None,
) -> Fit:
    """Return the fit from passes over its runs on; `known`: in place of the priors.

    A fit that can't reach `required` ends, but not before its first step: linear theory alone has put the start there.
    Channels that are late are held at the rows where the start has them: where the end has them elsewhere, by another
    fit. With each step's own rows, two steps would compare rows that hold other measurements.
    """
    for _ in range(MAX_ROW_CHOICES):
        held = [run.with_rows_of(passes.plant) for run in runs]
        found = _fit_held(held, passes, free, mapper, known, required)
        if all(run.with_rows_of(found.passes.plant) is run for run in held):
            break
        passes = pass_all(runs, found.passes.theta, mapper)
    return found


def _fit_held(
    runs: Sequence[Evidence],
    passes: Passes,
    free: Sequence[Free],
    mapper: Mapper,
    known: Posterior | None,
    required: RequiredGain | None,
) -> Fit:
    inverse = np.eye(len(free))
    for number in range(MAX_STEPS):
        newton = _newton(passes, free, mapper, known)
        inverse = newton.inverse
        if newton.decrement < CONVERGED_CHI2:
            break
        if required is not None and number > 0 and required.is_out_of_reach(passes, free, newton.decrement):
            break
        stepped = _accepted(runs, passes, free, newton.step, mapper, known)
        if stepped is None:
            break
        passes, gain = stepped
        if gain < STATIONARY_CHI2:
            break
    return Fit(tuple(free), passes, inverse)


def is_stationary(found: Fit, mapper: Mapper) -> bool:
    """Tell whether a fit ended at a zero of its score, or at bounds, and not because no step was likelier."""
    return _newton(found.passes, found.free, mapper, None).decrement < STATIONARY_CHI2


class _Newton(NamedTuple):
    inverse: Matrix  # of the posterior's curvature
    step: Vector  # in units of the scales
    decrement: float  # the fall of χ² that the step is to bring


def _newton(passes: Passes, free: Sequence[Free], mapper: Mapper, known: Posterior | None) -> _Newton:
    found = _finite(gram(passes, directions_of(free, passes.theta), mapper))
    away, precision = _away(free, passes.theta, known)
    downhill = -found.score - precision @ away
    curvature = found.information + precision
    step = bounded_step(curvature, downhill, *reach_of(free, passes.theta))
    return _Newton(inverted(curvature), step, float(2.0 * downhill @ step - step @ curvature @ step))


def bounded_step(curvature: Matrix, downhill: Vector, low: Vector, high: Vector) -> Vector:
    """Return the Newton step within bounds: what reaches one stays there, and the others are best beside it."""
    root, values, vectors = _decomposed(curvature)
    square_root = np.sqrt(values)[:, np.newaxis] * vectors.T
    target = vectors.T @ (downhill / root) / np.sqrt(values)
    solved = optimize.lsq_linear(square_root, target, (low * root, high * root), method="bvls")
    return np.asarray(solved.x / root)


def reach_of(free: Sequence[Free], theta: Vector) -> tuple[Vector, Vector]:
    """Return how far each parameter may go down and up in a step, in units of its scale."""
    low, high = np.empty(len(free)), np.empty(len(free))
    for i, f in enumerate(free):
        old, least, most = theta[f.place], f.least, f.high
        if f.low >= 0.0 and not f.amplitude and old > 0.0:
            least = least if "coulomb" in f.name else max(least, old / MAX_STEP_RATIO)
            most = min(most, max(MAX_STEP_RATIO * old, f.scale))
        low[i], high[i] = (least - old) / f.scale, (most - old) / f.scale
    return low, high


def _finite(found: Gram) -> Gram:
    """Return a Gram matrix without what is said of parameters beyond which the simulation has no finite answer."""
    good = np.isfinite(np.diag(found.information)) & np.isfinite(found.score)
    information = np.where(np.outer(good, good), found.information, 0.0)
    return found._replace(information=information, score=np.where(good, found.score, 0.0))


def inverted(curvature: Matrix) -> Matrix:
    """Return the inverse of a symmetric matrix; what it doesn't hold gets a wide but finite variance."""
    root, values, vectors = _decomposed(curvature)
    return np.asarray((vectors / values) @ vectors.T / np.outer(root, root))


def _decomposed(curvature: Matrix) -> tuple[Vector, Vector, Matrix]:
    """Return the root of a matrix's diagonal, and values and vectors of the matrix scaled by it."""
    root = np.sqrt(np.maximum(np.diag(curvature), 1e-12))
    values, vectors = linalg.eigh(curvature / np.outer(root, root))
    return root, np.maximum(values, 1e-11), vectors


def _accepted(
    runs: Sequence[Evidence],
    passes: Passes,
    free: Sequence[Free],
    step: Vector,
    mapper: Mapper,
    known: Posterior | None,
) -> tuple[Passes, float] | None:
    """Return the passes a step on and what it gains of χ², shortened until no worse; None where no step is better."""
    factor = 1.0
    for _ in range(MAX_HALVINGS):
        theta = moved(passes.theta, free, factor * step)
        tried = pass_all(runs, theta, mapper)
        before, after = penalised(passes, free, tried, known), penalised(tried, free, passes, known)
        # Variances that change with the parameters move it, too: near the best, by less than what is called stationary.
        if np.isfinite(after) and after > before - 0.5 * STATIONARY_CHI2:
            return tried, 2.0 * (after - before)
        factor *= 0.3
    return None


def moved(theta: Vector, free: Sequence[Free], step: Vector) -> Vector:
    """Return parameters a step on, within their bounds; `step` is in units of the scales."""
    changed = theta.copy()
    for f, s in zip(free, np.clip(step, *reach_of(free, theta)), strict=True):
        changed[f.place] = min(max(theta[f.place] + f.scale * float(s), f.least), f.high)
    return changed
