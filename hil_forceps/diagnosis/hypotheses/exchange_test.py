"""Which entries could take the place of others, by the score test beside the model that holds those.

One Gram matrix of the innovations holds both: the amplitudes v of the entries that leave, which go to zero, and the
columns of those that join. The step −v moves the scores of all others by −M v; what they and the columns then gain is
what a score test says beside the parameters that stay. An exact alias of what leaves has a column there, too.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.evidence import Gram
from hil_forceps.diagnosis.hypotheses.places import Place
from hil_forceps.diagnosis.hypotheses.score_test import COST_PER_COLUMN, Prior, Projected, projected
from hil_forceps.diagnosis.inference.fit import Fit, inverted

Vector = NDArray[np.float64]
Columns = NDArray[np.int64]

MAX_PAIRED_PLACES = 30  # places that are tried two by two: those that gain most alone


class Exchange(NamedTuple):
    """Entries for others, as the linear model has it."""

    leaving: tuple[str, ...]
    joining: tuple[Place, ...]
    sizes: tuple[Vector, ...]  # of the columns of each place that joins
    shifts: Vector  # of the fitted parameters, in units of their scales
    gain: float  # fall of χ², less the cost of parameters and entries
    explained: float  # χ² that the leaving entries explain: its rise without them and with nothing in their place

    @property
    def effects(self) -> frozenset[str]:
        """Entries that join."""
        return frozenset(place.effect_id for place in self.joining)


def exchanges(
    model: Fit, effects: Sequence[str], places: Sequence[Place], found: Gram, threshold: float
) -> list[Exchange]:
    """Return the best exchange for each set of entries that leave and join, the best first.

    `places`, `found`: all places beside the model and the Gram matrix of its free parameters and their columns. An
    entry more costs `threshold`, one less saves it.
    """
    prior = Prior.of(model.free, model.passes.theta)
    best: dict[tuple[frozenset[str], frozenset[str]], Exchange] = {}
    for leaving in (*combinations(effects, 1), *combinations(effects, 2)):
        beside = _without(model, leaving, found, prior)
        if beside is None:
            continue
        usable = [q for q in places if bool(np.all(beside.columns.good[q.first : q.stop]))]
        alone = [e for q in usable if (e := _exchange(beside, leaving, (q,)))]
        alone.sort(key=lambda e: -e.gain)
        pairs = combinations([e.joining[0] for e in alone[:MAX_PAIRED_PLACES]], 2) if len(leaving) == 1 else ()
        together = [_exchange(beside, leaving, pair) for pair in pairs if pair[0].effect_id != pair[1].effect_id]
        saved = sum(COST_PER_COLUMN * (_parameters(model, e) - 1) + threshold for e in leaving)
        for tried in (*alone, *(e for e in together if e)):
            spent = sum(COST_PER_COLUMN * (q.stop - q.first - 1) + q.cost + threshold for q in tried.joining)
            gain = tried.gain + saved - spent
            key = (frozenset(leaving), tried.effects)
            if key not in best or gain > best[key].gain:
                best[key] = tried._replace(gain=gain)
    return sorted(best.values(), key=lambda e: -e.gain)


class _Beside(NamedTuple):
    """The linear model without the entries that leave."""

    columns: Projected  # beside the parameters that stay
    staying: Columns  # places of these among the fitted ones
    shifts: Vector  # of all fitted parameters: amplitudes that leave go to zero, the others stay where they are
    explained: float  # χ² that the leaving entries explain


def _without(model: Fit, leaving: Sequence[str], found: Gram, prior: Prior) -> _Beside | None:
    """Return the linear model with amplitudes of entries at zero; None where they have none, as a limit."""
    count = len(model.free)
    entries = [f.name.split(".")[1] if f.name.startswith("effects.") else "" for f in model.free]
    shifts = np.zeros(found.score.size)  # the columns behind the parameters don't move
    for i, f in enumerate(model.free):
        if f.amplitude and entries[i] in leaving:
            shifts[i] = -model.values[i] / f.scale
    if not shifts.any():
        return None
    information, score = found.information.copy(), found.score.copy()
    information[:count, :count] += prior.precision
    score[:count] += prior.pull
    moved = score + information @ shifts
    staying = np.array([i for i, entry in enumerate(entries) if entry not in leaving], dtype=np.int64)
    kept = np.concatenate([staying, np.arange(count, score.size)])
    included = Prior(np.zeros((staying.size, staying.size)), np.zeros(staying.size))
    columns = projected(Gram(information[np.ix_(kept, kept)], moved[kept]), included)
    best_with = score[:count] @ inverted(information[:count, :count]) @ score[:count]
    best_without = moved[staying] @ columns.covariance @ moved[staying]
    explained = float(shifts @ (score + moved) - best_without + best_with)
    return _Beside(columns, staying, shifts[:count], explained)


def _parameters(model: Fit, effect_id: str) -> int:
    return sum(f.name.startswith(f"effects.{effect_id}.") for f in model.free)


def _exchange(beside: _Beside, leaving: tuple[str, ...], joining: tuple[Place, ...]) -> Exchange | None:
    """Return an exchange, its gain without costs; None where a size comes out with the wrong sign."""
    at = np.concatenate([np.arange(place.first, place.stop) for place in joining])
    score = beside.columns.score[at]
    size = inverted(beside.columns.information[np.ix_(at, at)]) @ score
    sizes = tuple(size[[int(c) in range(q.first, q.stop) for c in at]] for q in joining)
    if any(q.one_sided and own[0] <= 0.0 for q, own in zip(joining, sizes, strict=True)):
        return None
    shifts = beside.shifts.copy()
    shifts[beside.staying] = beside.columns.alone - beside.columns.solved[:, at] @ size
    return Exchange(leaving, joining, sizes, shifts, float(score @ size) - beside.explained, beside.explained)
