"""How much more a score scatters than its information says: the sandwich estimator of its variance, in blocks of rows.

Innovations are white under the model. Where the model or the filter is only nearly right, they hang together for a
while, and chance moves a size further than its information says. That shows in the blocks of the data themselves
(White, Econometrica 50, 1982; Liang and Zeger, Biometrika 73, 1986). With v the change that a model's extension makes
of the whitened residuals, and r what is left beside it, the dispersion over blocks B of rows is

    φ = Σ_B (Σ_{k in B} v_k r_k)² / Σ_k v_k²,

next to 1 for white residuals. A χ² is divided by it, by 1 at least. r is what is left beside the extension: a real
effect does not scatter itself.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hil_forceps.diagnosis.evidence import Passes

Matrix = NDArray[np.float64]


class Scatter(NamedTuple):
    """Of a change v of residuals r in some blocks of rows."""

    score: float  # sum of the squares of the blocks' scores
    information: float  # Σ v²
    squares: float  # sum of the squares of the blocks' information

    @property
    def dispersion(self) -> float:
        """φ, 1 at least."""
        return max(1.0, self.score / self.information) if self.information > 0.0 else 1.0

    @property
    def blocks(self) -> float:
        """How many blocks of equal information tell as much of φ as these: its degrees of freedom (Satterthwaite)."""
        return self.information**2 / self.squares if self.squares > 0.0 else 1.0


def scatter(change: Matrix, residual: Matrix, block_rows: int) -> Scatter:
    """Return how the scores of a change scatter in one run (n × m each)."""
    at = np.arange(0, change.shape[0], block_rows)
    scores = np.add.reduceat(np.sum(change * residual, axis=1), at)
    information = np.add.reduceat(np.sum(change * change, axis=1), at)
    return Scatter(float(scores @ scores), float(information.sum()), float(information @ information))


def total_scatter(parts: Sequence[Scatter]) -> Scatter:
    """Return the scatter over all runs."""
    return Scatter(*(sum(values) for values in zip(*parts, strict=True)))


# From a fall of χ² and how its scores scatter to the χ² that is as unlikely where the scores are white.
Weigh = Callable[[float, Scatter], float]


def over_dispersion(chi2: float, scattered: Scatter) -> float:
    """Return a fall of χ² over its dispersion.

    It counts as far as the change of the residuals makes it, Σ v²: the rest comes from the variances of the filter.
    """
    return max(0.0, min(chi2, scattered.information)) / scattered.dispersion


def by_student_t(chi2: float, scattered: Scatter) -> float:
    """Return the χ² of one degree of freedom that is as unlikely as Student's t by the scatter of the blocks.

    Where the filter is known to be nearly right only, the blocks alone tell how far chance goes, and few tell it badly.
    """
    over = over_dispersion(chi2, scattered)
    by_chance = float(stats.t.sf(math.sqrt(over), scattered.blocks))
    return float(stats.norm.isf(by_chance)) ** 2 if 0.0 < by_chance < 0.5 else over


def scatter_between(one: Passes, other: Passes) -> Scatter:
    """Return how scores scatter of the change from a model to another that extends it."""
    parts = []
    for before, after in zip(one.runs, other.runs, strict=True):
        both = before.as_recorded(before.counts) & after.as_recorded(after.counts)
        residual = np.where(both, after.as_recorded(after.influence * after.residual), 0.0)
        change = np.where(both, before.as_recorded(before.influence * before.residual), 0.0) - residual
        parts.append(scatter(change, residual, after.block_rows))
    return total_scatter(parts)
