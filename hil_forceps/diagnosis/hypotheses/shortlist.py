"""Which entries are refitted at a step, and from where: the best place of each, with the shape that fits best."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.evidence import Direction, Mapper, gram
from hil_forceps.diagnosis.hypotheses.places import Place, between
from hil_forceps.diagnosis.hypotheses.score_test import Prior, Tested, score_test
from hil_forceps.diagnosis.inference.fit import Fit, directions_of

Vector = NDArray[np.float64]

MAX_SHORTLIST = 6  # entries that are refitted at a step
SHORTLIST_SHARE = 0.3  # of the best gain  # tuned: lag and damping beside a skew of d = 50
# Of a shape: places to look are a factor of 5 to 7 apart, and a refit finds its way over one of 1.5.
SHAPES_BETWEEN = (0.25, 0.4, 0.65, 1.5, 2.4, 4.0)


class Start(NamedTuple):
    """Where a refit begins."""

    place: Place
    sizes: Vector  # of its columns
    shifts: Vector  # of the fitted parameters, in units of their scales
    gain: float


def best_starts(model: Fit, places: Sequence[Place], tested: Tested, mapper: Mapper) -> list[Start]:
    """Return where to refit from, the best entries first; none where nothing gains more than chance gives."""
    chosen = _shortlist(places, tested)
    passes, known = model.passes, directions_of(model.free, model.passes.theta)
    more: list[Place] = []
    directions: list[Direction] = []
    for start in chosen:
        for factor in SHAPES_BETWEEN:
            if (found := between(passes.theta, start.place, factor, len(directions))) is not None:
                more.append(found[0])
                directions += found[1]
    if not more:
        return chosen
    looked = score_test(gram(passes, [*known, *directions], mapper), Prior.of(model.free, passes.theta), more)
    best = {_key(start.place): start for start in chosen}
    for i, place in enumerate(more):
        gain = float(looked.gains[i])
        if gain > best[_key(place)].gain:
            best[_key(place)] = Start(place, looked.sizes[i], looked.shifts[i], gain)
    return sorted(best.values(), key=lambda start: -start.gain)


def _shortlist(places: Sequence[Place], tested: Tested) -> list[Start]:
    order = np.argsort(-tested.gains)
    top = float(tested.gains.max(initial=0.0))
    chosen: dict[tuple[str, ...], Start] = {}
    for i in order:
        gain, place = float(tested.gains[i]), places[i]
        if top <= tested.threshold or gain < SHORTLIST_SHARE * top or gain < 0.5 * tested.threshold:
            break
        chosen.setdefault(_key(place), Start(place, tested.sizes[i], tested.shifts[i], gain))
    return list(chosen.values())[:MAX_SHORTLIST]


def _key(place: Place) -> tuple[str, ...]:
    """Return what is refitted once: an entry, or a channel of a skew."""
    return (place.effect_id, *(place.amplitudes if place.effect_id == "channel_skew" else ()))
