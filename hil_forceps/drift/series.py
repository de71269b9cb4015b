"""One parameter over sessions: what lies apart, changes one by one, and the course with its interval."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.drift.change_test import FEWEST_SESSIONS, Change, Kind, Tested, change_test, design
from hil_forceps.drift.onset import Onset, onset_of
from hil_forceps.drift.outliers import outliers
from hil_forceps.drift.regression import fitted
from hil_forceps.drift.scatter import Scatter, scatters

Vector = NDArray[np.float64]

MOST_CHANGES = 3  # of one parameter
# By which a session of a series without any is left out by chance: small beside the rate of false alarms.
OUTLIER_RATE = 0.01


class FoundChange(NamedTuple):
    """A change of one parameter, by places of the series."""

    kind: Kind
    onset: Onset
    size: float  # of a step; of a slope, by session
    size_sd: float
    total: float  # what it changed until the last session
    total_sd: float
    p_value: float


class Followed(NamedTuple):
    """A parameter over n sessions."""

    changes: tuple[FoundChange, ...]  # by onset
    apart: tuple[int, ...]  # sessions that lie apart; they count for nothing else
    scatter: Scatter  # between sessions, beside the changes
    level: Vector  # n: without the scatter
    level_sd: Vector  # n
    p_value: float  # of the first test; NaN where sessions are too few for one


def follow(series: Vector, deviations: Vector, rate: float, rng: np.random.Generator) -> Followed:
    """Follow a parameter; `rate`: false alarms of the whole series. n each, in the order of the sessions."""
    every = np.arange(series.size)
    found, p_value = _changes(series, deviations, rate, rng)
    # Behind the search: without its changes the first session of a step seems to lie apart.
    columns = design([change for change, _ in found], series.size)
    apart = sorted(outliers(series, columns, deviations, OUTLIER_RATE))
    kept = np.delete(every, apart)
    if apart:
        found, p_value = _changes(series[kept], deviations[kept], rate, rng)
    return _told(series.size, series[kept], deviations[kept], kept, apart, found, p_value)


def _changes(
    series: Vector, deviations: Vector, rate: float, rng: np.random.Generator
) -> tuple[list[tuple[Change, float]], float]:
    """Return the changes with their p values, and that of the first test."""
    found: list[tuple[Change, float]] = []
    p_value = np.nan
    while series.size >= FEWEST_SESSIONS and len(found) < MOST_CHANGES:
        tested = change_test(series, deviations, [change for change, _ in found], rate, rng)
        p_value = p_value if found else tested.p_value
        if tested.p_value > rate:
            break
        found = _placed(series, deviations, found, tested)
    return found, p_value


def _placed(
    series: Vector, deviations: Vector, found: list[tuple[Change, float]], tested: Tested
) -> list[tuple[Change, float]]:
    """Return the changes with one more, each where it is likeliest beside the others."""
    found = [*found, (tested.best, tested.p_value)]
    for place in reversed(range(len(found))):
        others = [change for at, (change, _) in enumerate(found) if at != place]
        change, p_value = found[place]
        onset = onset_of(series, deviations, change.kind, others).likeliest
        found[place] = (change._replace(onset=onset), p_value)
    return found


def _told(
    sessions: int,
    series: Vector,
    deviations: Vector,
    kept: NDArray[np.intp],
    apart: list[int],
    found: list[tuple[Change, float]],
    p_value: float,
) -> Followed:
    found = sorted(found, key=lambda each: each[0].onset)
    changes = [change for change, _ in found]
    columns = design(changes, series.size)
    fit = fitted(series, columns, deviations, scatters(deviations))
    # Sessions that lie apart have the level of those before them.
    rows = columns[np.clip(np.searchsorted(kept, np.arange(sessions), side="right") - 1, 0, None)]
    level_sd = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", rows, fit.covariance, rows), 0.0))
    told = []
    for place, (change, p) in enumerate(found):
        onset = onset_of(series, deviations, change.kind, [c for at, c in enumerate(changes) if at != place])
        size, size_sd = float(fit.coefficients[place + 1]), float(np.sqrt(fit.covariance[place + 1, place + 1]))
        last = float(columns[-1, place + 1])
        where = Onset(*(int(kept[at]) for at in onset))
        told.append(FoundChange(change.kind, where, size, size_sd, last * size, last * size_sd, p))
    return Followed(
        tuple(told), tuple(apart), fit.scatter, np.asarray(rows @ fit.coefficients), level_sd, float(p_value)
    )
