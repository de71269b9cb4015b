"""Which entries of a scan are worth a refit."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.look import Scan

Vector = NDArray[np.float64]

SHORTLIST = 7
STANDS_OUT = 0.7  # of the threshold, by linear gain
OVERLOOKED = 3
MOST_INSTEAD, LEAST_PROMISE = 5, 2.0  # entries; of the linear gain
SHORTLIST_DROP = 40.0  # of the linear gain below the best
NEAR_DROP = 20.0  # of χ², within which entries are worth a refit, and rough fits worth fitting to the end


def best_of_each(scan: Scan) -> dict[str, int]:
    """Return the place of each entry that gains most."""
    best: dict[str, int] = {}
    for i, probe in enumerate(scan.probes):
        so_far = best.get(probe.effect_id)
        if so_far is None or scan.scores.gains[i] > scan.scores.gains[so_far]:
            best[probe.effect_id] = i
    return best


def promising(scan: Scan, effects: Collection[str]) -> list[int]:
    """Return the best places of entries that may stand in place of one of these effects, the best first."""
    gains = scan.scores.gains
    places = [i for name, i in best_of_each(scan).items() if name not in effects and gains[i] > LEAST_PROMISE]
    return sorted(places, key=lambda i: -gains[i])[:MOST_INSTEAD]


def shortlists(order: list[int], gains: Vector, needed: Vector, *, overlooked: bool) -> tuple[list[int], ...]:
    """Return which places are to be refitted, and which if none of those will do; `order`: the best first."""
    standing_out = [i for i in order if gains[i] > STANDS_OUT * needed[i]]
    if overlooked:
        return ([i for i in order if i not in standing_out][:OVERLOOKED],)
    if not standing_out:
        return ()
    top = gains[order[0]]
    near = [i for i in standing_out if gains[i] > top - max(SHORTLIST_DROP, 0.4 * top)]
    close = [i for i in order if gains[i] > top - NEAR_DROP]
    return max(near, close, key=len)[:SHORTLIST], standing_out[len(near) :][:SHORTLIST]
