"""Where a change began: the likeliest session, and those that are as good as likely."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.drift.change_test import FEWEST_BEYOND, Change, Kind, column_of, design
from hil_forceps.drift.regression import beside
from hil_forceps.drift.scatter import scatters, whitened

Vector = NDArray[np.float64]


class Onset(NamedTuple):
    """Places of sessions."""

    likeliest: int
    low: int
    high: int


def onset_of(series: Vector, deviations: Vector, kind: Kind, others: Sequence[Change]) -> Onset:
    """Return where a change of a kind began, with a 95 % interval: each session is as likely beforehand."""
    sessions = series.size
    first = 1 if kind == "slope" else FEWEST_BEYOND
    places = np.arange(first, sessions - FEWEST_BEYOND + 1)
    further = np.column_stack([column_of(Change(kind, int(place)), sessions) for place in places])
    best = np.full(places.size, -np.inf)
    for model in beside(design(others, sessions), further, deviations, scatters(deviations)):
        white = whitened(series[:, np.newaxis], deviations, model.scatter)[0][:, 0]
        misfit = float(white @ white - np.sum((model.basis.T @ white) ** 2))
        told = -model.half_log_determinant - 0.5 * misfit + 0.5 * (model.further.T @ white) ** 2
        best = np.maximum(best, told)
    share = np.exp(best - best.max())
    total = np.cumsum(share) / share.sum()
    low, high = (int(places[np.searchsorted(total, bound)]) for bound in (0.025, 0.975))
    likeliest = int(places[np.argmax(best)])
    return Onset(likeliest, min(low, likeliest), max(high, likeliest))
