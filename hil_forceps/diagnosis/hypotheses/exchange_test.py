"""Which entries could take the place of others, by the score test beside the model that holds those.

One Gram matrix J, C of the innovations holds both: the amplitudes of the entries that leave go to zero, the columns of
those that join are free, and so are all other parameters. With v the amplitudes that leave (rows a of J), z = −M⁻¹s the
step without that condition and A = (M⁻¹)ₐₐ, χ² rises by (v + zₐ)ᵀ A⁻¹ (v + zₐ) over its least value with the columns.
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
    p = projected(found, Prior.of(model.free, model.passes.theta))
    usable = [place for place in places if bool(np.all(p.good[place.first : place.stop]))]
    best: dict[tuple[frozenset[str], frozenset[str]], Exchange] = {}
    for leaving in (*combinations(effects, 1), *combinations(effects, 2)):
        v, at = _amplitudes(model, leaving)
        if at.size == 0:
            continue  # a limit has no amplitude
        explained = float(v @ inverted(p.covariance[np.ix_(at, at)]) @ v)
        saved = sum(COST_PER_COLUMN * (_parameters(model, e) - 1) + threshold for e in leaving)
        alone = [e for q in usable if (e := _exchange(p, leaving, (q,), v, at, explained))]
        alone.sort(key=lambda e: -e.gain)
        pairs = combinations([e.joining[0] for e in alone[:MAX_PAIRED_PLACES]], 2) if len(leaving) == 1 else ()
        together = [
            _exchange(p, leaving, pair, v, at, explained) for pair in pairs if pair[0].effect_id != pair[1].effect_id
        ]
        for tried in (*alone, *(e for e in together if e)):
            spent = sum(COST_PER_COLUMN * (q.stop - q.first - 1) + q.cost + threshold for q in tried.joining)
            gain = tried.gain + saved - spent
            key = (frozenset(leaving), tried.effects)
            if key not in best or gain > best[key].gain:
                best[key] = tried._replace(gain=gain)
    return sorted(best.values(), key=lambda e: -e.gain)


def _amplitudes(model: Fit, effects: Sequence[str]) -> tuple[Vector, Columns]:
    """Return the amplitudes of entries in units of their scales, and their places among the free parameters."""
    at = [i for i, f in enumerate(model.free) if f.amplitude and f.name.split(".")[1] in effects]
    values = model.values / np.array([f.scale for f in model.free])
    return values[at], np.array(at, dtype=np.int64)


def _parameters(model: Fit, effect_id: str) -> int:
    return sum(f.name.startswith(f"effects.{effect_id}.") for f in model.free)


def _exchange(
    p: Projected, leaving: tuple[str, ...], joining: tuple[Place, ...], v: Vector, at: Columns, explained: float
) -> Exchange | None:
    """Return an exchange, its gain without costs; None where a size comes out with the wrong sign."""
    columns = np.concatenate([np.arange(place.first, place.stop) for place in joining])
    inverse = inverted(p.information[np.ix_(columns, columns)])
    size = inverse @ p.score[columns]
    solved = p.solved[:, columns]
    gain = float(p.score[columns] @ size)
    shift = p.alone - solved @ size
    answer = inverse @ solved[at].T
    pull = inverted(p.covariance[np.ix_(at, at)] + solved[at] @ answer) @ (v + shift[at])
    loss = float(pull @ (v + shift[at]))
    size = size + answer @ pull
    shift = shift - p.covariance[:, at] @ pull - solved @ (answer @ pull)
    sizes = tuple(size[[int(c) in range(q.first, q.stop) for c in columns]] for q in joining)
    if any(q.one_sided and own[0] <= 0.0 for q, own in zip(joining, sizes, strict=True)):
        return None
    return Exchange(leaving, joining, sizes, shift, gain - loss, explained)
