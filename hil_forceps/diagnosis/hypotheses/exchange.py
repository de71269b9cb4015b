"""Exchanges behind forward selection: an entry for a rival, a harmonic for another.

The order of selection matters: what was less likely alone may be likelier beside entries that joined later.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hil_forceps.diagnosis.error_rates import SETS_WITHOUT_TRUTH
from hil_forceps.diagnosis.evidence import pass_all
from hil_forceps.diagnosis.hypotheses.candidate import Candidate, Search, adapted_to, fitted, with_runs
from hil_forceps.diagnosis.hypotheses.exchange_test import Exchange
from hil_forceps.diagnosis.hypotheses.harmonic_profile import likelier_harmonic
from hil_forceps.diagnosis.hypotheses.places import WAVES, estimate
from hil_forceps.diagnosis.inference.fit import fit, moved
from hil_forceps.diagnosis.inference.parameters import start_of, with_effect, without_effect
from hil_forceps.rig.catalogue import EFFECT_IDS, effect

Vector = NDArray[np.float64]

MAX_EXCHANGES = 6  # that are refitted
# Of the χ² that the leaving entries explain: columns change with large amplitudes, and the prediction is linear.
LINEAR_ERROR_SHARE = 0.1
# Of twice the log likelihood, 8.9: models within it are kept. Models δ deviations apart part by N(δ², 4δ²), so the true
# one falls behind another by more than D with Φ(−√D) at most, whatever δ, and behind any of the catalogue with
# `SETS_WITHOUT_TRUTH`.
SET_DROP = float(stats.norm.isf(SETS_WITHOUT_TRUTH / len(EFFECT_IDS)) ** 2)


def ranked(models: Sequence[Candidate], tied_share: float) -> list[Candidate]:
    """Return models by their gain; but first, of those that are taken for as good as the best, the simplest."""
    order = sorted(models, key=lambda c: -c.gain)
    near = [c for c in order if c.gain > (1.0 - tied_share) * order[0].gain]
    near.sort(key=lambda c: len(c.fit.free))
    return near[:1] + [c for c in order if c is not near[0]] if near else order


def with_likeliest_harmonics(s: Search, model: Candidate) -> Candidate:
    """Return a model with the likeliest harmonic of each entry; behind a gear harmonics stay.

    The number of fitted parameters is the same for all harmonics, so none costs more.
    """
    for effect_id in model.effects:
        if s.geared or effect_id not in WAVES:
            continue
        theta = likelier_harmonic(model.fit, effect_id, s.mapper)
        if theta is None:
            continue
        changed = fitted(s, model, pass_all(s.runs, theta, s.mapper), model.effects, added=0)
        if changed.gain > 0.0:
            model = changed._replace(gain=model.gain + changed.gain)
    return model


def exchanged(
    s: Search, best: Candidate, rivals: tuple[Candidate, ...], near: Sequence[Exchange], threshold: float
) -> tuple[Candidate, tuple[Candidate, ...]]:
    """Return the best model and its rivals, with entries exchanged for others; `near`: what could, the best first."""
    every = {frozenset(c.effects): c for c in (*rivals, best)}
    drop = max(SET_DROP, s.tied_share * best.gain)  # what is further behind is no rival
    left = MAX_EXCHANGES
    for e in near:
        if left == 0 or s.spent():
            break
        if e.gain < -SET_DROP - LINEAR_ERROR_SHARE * e.explained:
            continue
        effects = [*(k for k in best.effects if k not in e.leaving), *(q.effect_id for q in e.joining)]
        is_compared = frozenset(effects) in every and not _needs_its_own_runs(s, effects, best)
        if is_compared or len(set(effects)) < len(effects):
            continue
        left -= 1
        theta = moved(best.fit.passes.theta, best.fit.free, e.shifts)
        for effect_id in e.leaving:
            theta = without_effect(theta, effect_id)
        for place, sizes in zip(e.joining, e.sizes, strict=True):
            start = start_of(place.effect_id, estimate(place, sizes.tolist()))
            theta = with_effect(theta, place.effect_id, start)
        more = len(e.joining) - len(e.leaving)
        found = _rival(s, best, theta, effects, more, threshold * more - drop)
        every[frozenset(effects)] = found._replace(gain=best.gain + found.gain - threshold * more)
    order = ranked(list(every.values()), s.tied_share)
    kept = tuple(c for c in order if c.gain > order[0].gain - SET_DROP)
    return (best, kept) if order[0] is best else (adapted_to(s, with_runs(s, order[0]))[1], kept)


def _rival(
    s: Search, best: Candidate, theta: Vector, effects: Sequence[str], added: int, least_gain: float
) -> Candidate:
    """Return the fit of a rival from `theta` on; its gain is that above `best`, on runs that suit both.

    What can't gain `least_gain` is told with less than that. On runs that suit `best` alone nobody knows what can.
    """
    start = pass_all(s.runs, theta, s.mapper)
    if not _needs_its_own_runs(s, effects, best):
        return fitted(s, best, start, effects, added=added, least_gain=least_gain)
    found = fitted(s, best, start, effects, added=added)
    s, found = adapted_to(s, found)
    there = best._replace(fit=fit(s.runs, best.fit.passes.theta, best.fit.free, s.mapper))
    return fitted(s, there, found.fit.passes, effects, added=added)


def _needs_its_own_runs(s: Search, effects: Sequence[str], best: Candidate) -> bool:
    """Tell whether a rival has dry friction that the best model lacks.

    Rows where friction may hold a mass are no evidence beside the rival, but were evidence beside the best model. So
    both are compared on runs adapted to the rival.
    """
    return s.friction_decides and any(effect(e).dry_friction_of is not None for e in set(effects) - set(best.effects))
