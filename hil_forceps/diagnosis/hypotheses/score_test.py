"""Score tests of all places at once, with one false-alarm rate for the family.

With answers J of the innovations r to the fitted parameters (prior precision Λ) and C to a place, the projected
information is S = CᵀC − CᵀJ (JᵀJ + Λ)⁻¹ JᵀC, the projected score b likewise, and the place gains bᵀS⁻¹b of χ². Under
the model b ~ N(0, S); the threshold is what the largest gain exceeds in a share `FALSE_ALARMS` of draws from all of S.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.error_rates import FALSE_ALARMS
from hil_forceps.diagnosis.evidence import Gram
from hil_forceps.diagnosis.hypotheses.places import Place
from hil_forceps.diagnosis.inference.fit import Posterior, inverted, prior_of
from hil_forceps.diagnosis.inference.parameters import Free

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

DRAWS = 4000
COST_PER_COLUMN = 2.0  # Akaike's: what χ² falls by chance, twice
# Of a column's information: less is left where known parameters do the same, to the accuracy of finite differences.
IDENTIFIABLE_SHARE = 1e-5


class Tested(NamedTuple):
    """What came out, place by place."""

    gains: Vector  # fall of χ² beyond the cost of more than one column
    sizes: list[Vector]  # of the columns
    shifts: list[Vector]  # of the fitted parameters beside them, in units of their scales
    information: Matrix  # of the columns, beside the fitted parameters
    threshold: float
    shift: Vector  # of the fitted parameters without any place


class Prior(NamedTuple):
    """What is known of the fitted parameters beside the runs that are tested, in units of their scales."""

    precision: Matrix
    pull: Vector  # precision times how far they are from where it has them

    @classmethod
    def of(cls, free: Sequence[Free], theta: Vector) -> "Prior":
        """Return the prior that parameters were fitted with."""
        away, precision = prior_of(free, theta)
        return cls(np.diag(precision), precision * away)

    @classmethod
    def by_fit(cls, known: Posterior, free: Sequence[Free], theta: Vector) -> "Prior":
        """Return what a fit to other runs knows."""
        return cls(known.precision, known.precision @ known.away(free, theta))


class Projected(NamedTuple):
    """Information and score of the places' columns beside the fitted parameters."""

    covariance: Matrix  # of the fitted parameters, (JᵀJ + Λ)⁻¹
    alone: Vector  # shift of the fitted parameters without any place
    solved: Matrix  # their shift per size of each column, with the sign changed
    information: Matrix  # S
    score: Vector  # b
    good: NDArray[np.bool_]  # columns that the fitted parameters don't do as well


def projected(found: Gram, prior: Prior) -> Projected:
    """Project a Gram matrix; its first rows are the fitted parameters, as many as the prior has."""
    fitted = prior.pull.size
    own = found.information[fitted:, fitted:]
    cross = found.information[:fitted, fitted:]
    inverse = inverted(found.information[:fitted, :fitted] + prior.precision)
    solved = inverse @ cross
    alone = -inverse @ (found.score[:fitted] + prior.pull)
    s = own - cross.T @ solved
    b = -(found.score[fitted:] - solved.T @ (found.score[:fitted] + prior.pull))
    good = np.isfinite(np.diag(own)) & (np.diag(s) > IDENTIFIABLE_SHARE * np.diag(own)) & (np.diag(s) > 1e-12)
    return Projected(inverse, alone, solved, s, b, good)


def score_test(found: Gram, prior: Prior, places: Sequence[Place], seed: int | None = None) -> Tested:
    """Test all places; without a seed there is no threshold (infinite)."""
    p = projected(found, prior)
    gains, sizes, shifts = [], [], []
    for place in places:
        gain, size = _gain(p.information, p.score, place, p.good)
        gains.append(gain)
        sizes.append(size)
        shifts.append(p.alone - p.solved[:, place.first : place.stop] @ size)
    threshold = np.inf if seed is None else _threshold(p.information, places, p.good, seed)
    information = np.where(np.outer(p.good, p.good), p.information, 0.0)
    return Tested(np.array(gains), sizes, shifts, information, threshold, p.alone)


def _gain(s: Matrix, b: Vector, place: Place, good: NDArray[np.bool_]) -> tuple[float, Vector]:
    sizes = np.zeros(place.stop - place.first)
    chosen = np.arange(place.first, place.stop)[good[place.first : place.stop]]
    if chosen.size == 0:
        return 0.0, sizes
    inverse = inverted(s[np.ix_(chosen, chosen)])
    size = inverse @ b[chosen]
    if place.one_sided and size[0] <= 0.0:
        return 0.0, sizes
    sizes[chosen - place.first] = size
    return float(b[chosen] @ size) - COST_PER_COLUMN * (chosen.size - 1) - place.cost, sizes


def _threshold(s: Matrix, places: Sequence[Place], good: NDArray[np.bool_], seed: int) -> float:
    """Return the largest gain that chance gives in all but `FALSE_ALARMS` of data sets."""
    kept = np.flatnonzero(good)
    if kept.size == 0:
        return np.inf
    at = np.full(good.size, -1)
    at[kept] = np.arange(kept.size)
    size = np.sqrt(np.diag(s)[kept])
    normed = s[np.ix_(kept, kept)] / np.outer(size, size)
    values, vectors = np.linalg.eigh(normed)
    values = np.maximum(values, 0.0)
    normed = (vectors * values) @ vectors.T  # what is drawn and what weighs it are of one matrix, without rounding
    rng = np.random.default_rng(seed)
    scores = (vectors * np.sqrt(values)) @ rng.standard_normal((kept.size, DRAWS))
    largest = np.zeros(DRAWS)
    for place in places:
        chosen = at[place.first : place.stop]
        chosen = chosen[chosen >= 0]
        if chosen.size == 0:
            continue
        here = scores[chosen]
        gain = np.einsum("ik,ij,jk->k", here, inverted(normed[np.ix_(chosen, chosen)]), here)
        gain -= COST_PER_COLUMN * (chosen.size - 1)
        largest = np.maximum(largest, np.where(here[0] > 0.0, gain, 0.0) if place.one_sided else gain)
    return _upper_quantile(largest)


def _upper_quantile(values: Vector) -> float:
    """Return the quantile 1 − `FALSE_ALARMS`, by the exponential tail of a χ² beyond what the draws reach."""
    reachable = max(FALSE_ALARMS, 20.0 / DRAWS)
    return float(np.quantile(values, 1.0 - reachable)) + 2.0 * float(np.log(reachable / FALSE_ALARMS))
