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
        usable = [q for q in places if bool(np.all(beside.tested.good[q.first : q.stop]))]
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
    """A model without the entries that leave."""

    tested: Projected  # columns beside the parameters that stay
    stay: Columns  # places of these among all fitted
    shifts: Vector  # of all fitted parameters, for the amplitudes that leave
    explained: float


def _without(model: Fit, leaving: Sequence[str], found: Gram, prior: Prior) -> _Beside | None:
    """Return the linear model with amplitudes of entries at zero; None where they have none, as a limit."""
    of = [f.name.split(".")[1] if f.name.startswith("effects.") else "" for f in model.free]
    shifts = np.zeros(found.score.size)
    for i, f in enumerate(model.free):
        if f.amplitude and of[i] in leaving:
            shifts[i] = -model.values[i] / f.scale
    if not shifts.any():
        return None
    stay = np.array([i for i, effect_id in enumerate(of) if effect_id not in leaving], dtype=np.int64)
    kept = np.concatenate([stay, np.arange(len(of), found.score.size)])
    information, score = found.information.copy(), found.score.copy()
    information[: len(of), : len(of)] += prior.precision
    score[: len(of)] += prior.pull
    moved = score + information @ shifts
    none = Prior(np.zeros((stay.size, stay.size)), np.zeros(stay.size))
    tested = projected(Gram(information[np.ix_(kept, kept)], moved[kept]), none)
    before = score[: len(of)] @ inverted(information[: len(of), : len(of)]) @ score[: len(of)]
    after = moved[stay] @ tested.covariance @ moved[stay]
    explained = float(shifts @ (score + moved) - after + before)
    return _Beside(tested, stay, shifts[: len(of)], explained)


def _parameters(model: Fit, effect_id: str) -> int:
    return sum(f.name.startswith(f"effects.{effect_id}.") for f in model.free)


def _exchange(beside: _Beside, leaving: tuple[str, ...], joining: tuple[Place, ...]) -> Exchange | None:
    """Return an exchange, its gain without costs; None where a size comes out with the wrong sign."""
    p, columns = beside.tested, np.concatenate([np.arange(place.first, place.stop) for place in joining])
    size = inverted(p.information[np.ix_(columns, columns)]) @ p.score[columns]
    sizes = tuple(size[[int(c) in range(q.first, q.stop) for c in columns]] for q in joining)
    if any(q.one_sided and own[0] <= 0.0 for q, own in zip(joining, sizes, strict=True)):
        return None
    shifts = beside.shifts.copy()
    shifts[beside.stay] = p.alone - p.solved[:, columns] @ size
    return Exchange(
        leaving, joining, sizes, shifts, float(p.score[columns] @ size) - beside.explained, beside.explained
    )
