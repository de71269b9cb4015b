"""Which entries of a scan are worth a refit."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.look import Scan, best_places

Vector = NDArray[np.float64]

SHORTLIST = 7
STANDS_OUT = 0.7  # of the threshold, by linear gain
OVERLOOKED = 3
MOST_INSTEAD, LEAST_PROMISE = 5, 2.0  # entries; of the linear gain
SHORTLIST_DROP = 40.0  # of the linear gain below the best
# From this linear gain on shares tell little: a slack of d = 400 has a sixth of a neighbour's, and its refit gains
# three times as much.
LARGE_GAIN, LARGE_SHARE = 200.0, 0.1
NEAR_DROP = 20.0  # of χ², within which entries are worth a refit, and rough fits worth fitting to the end

# What does the same but near a reversal, or but far round a turn: a rough fit of one beside the other's rounding can be
# 100 of χ² behind and its full fit 0.1 (an asymmetric friction that was taken for an offset of the current).
ALIASES = (
    frozenset({"current_offset", "coulomb_asymmetry"}),
    frozenset({"actuation_delay", "electrical_lag"}),
    frozenset({"pulley_eccentricity", "spool_radius_change"}),
    frozenset({"load_dependent_friction", "loaded_presliding"}),
)


def aliases(one: Collection[str], other: Collection[str]) -> bool:
    """Tell whether two sets of effects differ by an alias alone."""
    return frozenset(one) ^ frozenset(other) in ALIASES


def best_of_each(scan: Scan) -> dict[str, int]:
    """Return the place of each entry that gains most."""
    return best_places([probe.effect_id for probe in scan.probes], scan.scores.gains)


def to_try(scan: Scan) -> list[int]:
    """Return the place of each entry that gains most, and that of each channel that may be skewed, the best first."""
    names = [p.amplitudes[0] if p.effect_id == "channel_skew" else p.effect_id for p in scan.probes]
    return sorted(best_places(names, scan.scores.gains).values(), key=lambda i: -scan.scores.gains[i])


def promising(scan: Scan, effects: Collection[str]) -> list[int]:
    """Return the best places of entries that may stand in place of one of these effects, the best first."""
    gains = scan.scores.gains
    places = [i for name, i in best_of_each(scan).items() if name not in effects and gains[i] > LEAST_PROMISE]
    return sorted(places, key=lambda i: -gains[i])[:MOST_INSTEAD]


def shortlists(
    order: list[int], gains: Vector, needed: Vector, *, overlooked: bool, widely: bool
) -> tuple[list[int], ...]:
    """Return which places are to be refitted, and which if none of those will do; `order`: the best first.

    `overlooked`: the best of those that don't stand out instead. `widely`: of a large misfit more of them.
    """
    standing_out = [i for i in order if gains[i] > STANDS_OUT * needed[i]]
    if overlooked:
        return ([i for i in order if i not in standing_out][:OVERLOOKED],)
    if not standing_out:
        return ()
    top = gains[order[0]]
    least = LARGE_SHARE * top if widely and top > LARGE_GAIN else top - max(SHORTLIST_DROP, 0.4 * top)
    near = [i for i in standing_out if gains[i] > least]
    close = [i for i in order if gains[i] > top - NEAR_DROP]
    return max(near, close, key=len)[:SHORTLIST], standing_out[len(near) :][:SHORTLIST]


def with_aliases(lists: tuple[list[int], ...], order: list[int], scan: Scan) -> tuple[list[int], ...]:
    """Return shortlists of which the first holds the alias of the best, too, however little that gains by its look."""
    if not lists or not lists[0]:
        return lists
    first, *rest = lists
    best = scan.probes[first[0]].effect_id
    more = [i for i in order if i not in first and aliases((best,), (scan.probes[i].effect_id,))]
    return first + more, *rest
