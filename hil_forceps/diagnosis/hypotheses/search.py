"""Forward selection with refits, backward elimination, and the set of models that the data can't tell apart."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.evidence import Gram, gram, pass_all
from hil_forceps.diagnosis.hypotheses.candidate import Candidate, Search, Step, adapted_to, fitted, with_runs
from hil_forceps.diagnosis.hypotheses.exchange import SET_DROP, exchanged, ranked, with_likeliest_harmonics
from hil_forceps.diagnosis.hypotheses.exchange_test import Exchange, exchanges
from hil_forceps.diagnosis.hypotheses.harmonics import telling_harmonics
from hil_forceps.diagnosis.hypotheses.places import Place, places_of
from hil_forceps.diagnosis.hypotheses.score_test import Prior, Tested, score_test
from hil_forceps.diagnosis.hypotheses.shortlist import Start, best_starts
from hil_forceps.diagnosis.hypotheses.starting_point import SKEW, starting_point
from hil_forceps.diagnosis.inference.fit import Fit, directions_of, fit, inverted
from hil_forceps.diagnosis.inference.parameters import without_effect

Vector = NDArray[np.float64]


class Found(NamedTuple):
    """What the search found."""

    baseline: Fit
    best: Candidate
    rivals: tuple[Candidate, ...]  # the best and all within `SET_DROP` of it
    steps: tuple[Step, ...]
    explained: float = 0.0  # the fall of χ² from the baseline to the best
    not_looked_at: tuple[str, ...] = ()  # because the time was spent


def search(s: Search, theta: Vector) -> Found:
    """Fit the known parameters from `theta` on, then let entries join as long as one gains more than chance gives."""
    s.progress("fitting the known parameters")
    baseline = fit(s.runs, theta, s.known, s.mapper)
    s, best = adapted_to(s, Candidate((), baseline, 0.0))
    baseline = best.fit
    rivals: tuple[Candidate, ...] = (best,)
    tried: tuple[Candidate, ...]
    steps: list[Step] = []
    left_out: list[str] = []
    explained = 0.0
    seen = {frozenset(best.effects)}
    near: list[Exchange] = []
    while len(best.effects) < s.most_effects:
        where = f"beside {' + '.join(best.effects) or 'the known parameters'}"
        if s.spent():
            left_out.append(f"the catalogue {where}")
            break
        s.progress(f"scoring the catalogue {where}")
        places, tested, found = _scored(s, best)
        tried = ()
        for start in best_starts(best.fit, places, tested, s.mapper):
            if s.spent():
                left_out.append(f"{start.place.effect_id} {where}")
                continue
            s.progress(f"fitting {start.place.effect_id} {where}")
            refitted = _refitted(s, best, start)
            cost = start.place.cost
            tried = _with_one_more(tried, refitted._replace(gain=refitted.gain - cost, worth=refitted.worth - cost))
        least = s.least_share * explained
        joined = ranked([c for c in tried if c.worth > tested.threshold and c.gain > least], s.tied_share)
        light = tuple(c.without_runs() for c in tried)
        steps.append(Step(best.effects, tuple(places), tested, light, joined[0].effects[-1] if joined else ""))
        if not joined:
            near = exchanges(best.fit, best.effects, places, found, tested.threshold) if best.effects else []
            break
        thinned = _thinned(s, with_runs(s, joined[0]), tested.threshold)
        if frozenset(thinned.effects) in seen:
            break  # what joined took the place of what it had joined beside, and that the place of it
        rivals = (thinned, *(c for c in joined[1:] if c.gain > joined[0].gain - SET_DROP))
        seen.add(frozenset(thinned.effects))
        s, best = adapted_to(s, with_likeliest_harmonics(s, thinned))
        explained += best.gain
    if near and not s.spent():
        s.progress("exchanging entries for their nearest rivals")
        before = best.gain
        best, rivals = exchanged(s, best, rivals, near, tested.threshold)
        explained += best.gain - before
    return Found(baseline, best, rivals, tuple(steps), explained, tuple(left_out))


def fit_known(s: Search, theta: Vector) -> Fit:
    """Return the fit of the known parameters from `theta` on, to runs adapted to it."""
    return adapted_to(s, Candidate((), fit(s.runs, theta, s.known, s.mapper), 0.0))[1].fit


def _with_one_more(tried: tuple[Candidate, ...], new: Candidate) -> tuple[Candidate, ...]:
    """Return candidates with one more; passes over runs are kept of the best alone: they take most of the memory."""
    if tried and new.gain <= max(c.gain for c in tried):
        return (*tried, new.without_runs())
    return (*(c.without_runs() for c in tried), new)


def _scored(s: Search, model: Candidate) -> tuple[list[Place], Tested, Gram]:
    """Return all places beside a model, tested, and the Gram matrix of its free parameters and their columns."""
    passes, free = model.fit.passes, model.fit.free
    taken = frozenset(model.effects) - {SKEW}
    harmonics = None
    if s.geared:
        harmonics = telling_harmonics(model.fit, s.mapper)
    places, directions, waves = places_of(passes, s.without | taken, harmonics)
    found = gram(passes, [*directions_of(free, passes.theta), *directions], s.mapper, waves)
    return places, score_test(found, Prior.of(free, passes.theta), places, s.seed), found


def _refitted(s: Search, model: Candidate, start: Start) -> Candidate:
    """Return a model with an entry added; with another channel of a skew it has no entry more."""
    effect_id = start.place.effect_id
    effects = [*(e for e in model.effects if e != effect_id), effect_id]
    return fitted(s, model, starting_point(s, model, start), effects, added=1)


def wald(found: Fit, effect_id: str) -> float:
    """Return the χ² by which an effect's amplitudes differ from none."""
    at = [i for i, f in enumerate(found.free) if f.amplitude and f.name.startswith(f"effects.{effect_id}.")]
    if not at:
        return np.inf
    values = np.array([found.values[i] / found.free[i].scale for i in at])
    return float(values @ inverted(found.covariance[np.ix_(at, at)]) @ values)


def _thinned(s: Search, model: Candidate, threshold: float) -> Candidate:
    """Drop entries that don't pay any more beside those that joined: without them χ² rises by less than `threshold`."""
    while len(model.effects) > 1:
        weakest = min(model.effects, key=lambda e: wald(model.fit, e))
        if wald(model.fit, weakest) >= threshold:
            break
        start = pass_all(s.runs, without_effect(model.fit.passes.theta, weakest), s.mapper)
        fewer = fitted(s, model, start, [e for e in model.effects if e != weakest], added=-1)
        if fewer.gain < -threshold:
            break  # a size of none lies further off than its deviation here says
        model = fewer._replace(gain=model.gain + fewer.gain)
    return model
