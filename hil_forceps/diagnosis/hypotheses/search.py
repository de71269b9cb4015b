"""Forward selection with refits, backward elimination, and the set of models that the data can't tell apart."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hil_forceps.diagnosis.error_rates import SETS_WITHOUT_TRUTH
from hil_forceps.diagnosis.evidence import Mapper, Passes, gram, pass_all
from hil_forceps.diagnosis.hypotheses.harmonic_profile import likelier_harmonic
from hil_forceps.diagnosis.hypotheses.harmonics import telling_harmonics
from hil_forceps.diagnosis.hypotheses.places import WAVES, Place, estimate, places_of
from hil_forceps.diagnosis.hypotheses.score_test import COST_PER_COLUMN, Prior, Tested, score_test
from hil_forceps.diagnosis.hypotheses.shortlist import Start, best_starts
from hil_forceps.diagnosis.inference.dispersion import Weigh, scatter_between
from hil_forceps.diagnosis.inference.fit import Fit, directions_of, fit, fit_from, inverted, moved, penalised
from hil_forceps.diagnosis.inference.parameters import (
    Free,
    effect_parameters,
    start_of,
    values_of,
    with_effect,
    without_effect,
)
from hil_forceps.rig.catalogue import EFFECT_IDS

Vector = NDArray[np.float64]

ADAPTING_ROUNDS = 3  # of a pass that decides and a fit to what it decided
ADAPTED = 0.3  # deviations of a parameter: a fit that moves less decides the same
EXCHANGES = 3  # of an entry that joined, for others tried at that step
EXCHANGE_SHARE = 0.7  # of the gain with which it joined: what gained less was no near rival
START_SHARES = (1.0, 0.3, 0.1)  # of what the score test finds
# Of twice the log likelihood, 8.9: models within it are kept. Models δ deviations apart part by N(δ², 4δ²), so the true
# one falls behind another by more than D with Φ(−√D) at most, whatever δ, and behind any of the catalogue with
# `SETS_WITHOUT_TRUTH`.
SET_DROP = float(stats.norm.isf(SETS_WITHOUT_TRUTH / len(EFFECT_IDS)) ** 2)


class Candidate(NamedTuple):
    """A model: effects with the fit that holds them."""

    effects: tuple[str, ...]
    fit: Fit
    gain: float  # twice the log likelihood above the model it extends, less the cost of its parameters
    worth: float = 0.0  # of χ², what that is beside how its scores scatter

    def without_runs(self) -> "Candidate":
        """Return the model without its passes over the runs."""
        return self._replace(fit=self.fit._replace(passes=self.fit.passes._replace(runs=())))


class Step(NamedTuple):
    """One step of the search."""

    beside: tuple[str, ...]
    places: tuple[Place, ...]
    tested: Tested
    tried: tuple[Candidate, ...]
    joined: str = ""  # the entry that did


class Found(NamedTuple):
    """What the search found."""

    baseline: Fit
    best: Candidate
    rivals: tuple[Candidate, ...]  # the best and all within `SET_DROP` of it
    steps: tuple[Step, ...]
    explained: float = 0.0  # the fall of χ² from the baseline to the best
    not_looked_at: tuple[str, ...] = ()  # because the time was spent


class Adapt(Protocol):
    """How runs are adapted to a model: what a pass with it decides, and the noise that it leaves."""

    def __call__(self, runs: Sequence[Any], model: Fit, *, first: bool) -> Sequence[Any]:
        """Return the runs (`Evidence`) adapted to a model; `first`: of several rounds."""


class Search(NamedTuple):
    """What a search works on."""

    runs: Sequence[Any]  # `Evidence`
    known: tuple[Free, ...]
    mapper: Mapper
    without: frozenset[str]
    seed: int
    progress: Callable[[str], None]
    spent: Callable[[], bool]  # whether the time that was allowed is spent
    adapt: Adapt
    least_share: float  # of what is explained, that a further entry must gain
    tied_share: float  # of the best gain: models that are no further behind are taken for equally good
    geared: bool  # the motor's angle may be one behind a gear: harmonics need not be whole
    most_effects: int
    weigh: Weigh | None  # what a gain is worth beside how its scores scatter; None: as the likelihood has it


def search(s: Search, theta: Vector) -> Found:
    """Fit the known parameters from `theta` on, then let entries join as long as one gains more than chance gives."""
    s.progress("fitting the known parameters")
    baseline = fit(s.runs, theta, s.known, s.mapper)
    s, best = _beside(s, Candidate((), baseline, 0.0))
    baseline = best.fit
    rivals: tuple[Candidate, ...] = (best,)
    tried: tuple[Candidate, ...]
    steps: list[Step] = []
    left_out: list[str] = []
    explained = 0.0
    seen = {frozenset(best.effects)}
    while len(best.effects) < s.most_effects:
        beside = f"beside {' + '.join(best.effects) or 'the known parameters'}"
        if s.spent():
            left_out.append(f"the catalogue {beside}")
            break
        s.progress(f"scoring the catalogue {beside}")
        places, tested = _scored(s, best)
        tried = ()
        for start in best_starts(best.fit, places, tested, s.mapper):
            if s.spent():
                left_out.append(f"{start.place.effect_id} {beside}")
                continue
            s.progress(f"fitting {start.place.effect_id} {beside}")
            refitted = _refitted(s, best, start)
            cost = start.place.cost
            tried = _with_one_more(tried, refitted._replace(gain=refitted.gain - cost, worth=refitted.worth - cost))
        least = s.least_share * explained
        joined = _ranked([c for c in tried if c.worth > tested.threshold and c.gain > least], s.tied_share)
        light = tuple(c.without_runs() for c in tried)
        steps.append(Step(best.effects, tuple(places), tested, light, joined[0].effects[-1] if joined else ""))
        if not joined:
            break
        thinned = _thinned(s, _with_runs(s, joined[0]), tested.threshold)
        if frozenset(thinned.effects) in seen:
            break  # what joined took the place of what it had joined beside, and that the place of it
        rivals = (thinned, *(c for c in joined[1:] if c.gain > joined[0].gain - SET_DROP))
        seen.add(frozenset(thinned.effects))
        s, best = _beside(s, _with_likeliest_harmonics(s, thinned))
        explained += best.gain
    if len(best.effects) > 1 and not s.spent():
        s.progress("exchanging entries for their nearest rivals")
        before = best.gain
        best, rivals = _exchanged(s, best, rivals, steps)
        explained += best.gain - before
    return Found(baseline, best, rivals, tuple(steps), explained, tuple(left_out))


def fit_known(s: Search, theta: Vector) -> Fit:
    """Return the fit of the known parameters from `theta` on, to runs adapted to it."""
    return _beside(s, Candidate((), fit(s.runs, theta, s.known, s.mapper), 0.0))[1].fit


def _ranked(models: Sequence[Candidate], tied_share: float) -> list[Candidate]:
    """Return models by their gain; but first, of those that are taken for as good as the best, the simplest."""
    ranked = sorted(models, key=lambda c: -c.gain)
    near = [c for c in ranked if c.gain > (1.0 - tied_share) * ranked[0].gain]
    near.sort(key=lambda c: len(c.fit.free))
    return near[:1] + [c for c in ranked if c is not near[0]] if near else ranked


def _with_runs(s: Search, model: Candidate) -> Candidate:
    """Return a model with its passes over the runs."""
    if model.fit.passes.runs:
        return model
    return model._replace(fit=model.fit._replace(passes=pass_all(s.runs, model.fit.passes.theta, s.mapper)))


def _with_one_more(tried: tuple[Candidate, ...], new: Candidate) -> tuple[Candidate, ...]:
    """Return candidates with one more; passes over runs are kept of the best alone: they take most of the memory."""
    if tried and new.gain <= max(c.gain for c in tried):
        return (*tried, new.without_runs())
    return (*(c.without_runs() for c in tried), new)


def _beside(s: Search, model: Candidate) -> tuple[Search, Candidate]:
    """Return search and model with the runs adapted to that model, the same for all that is compared beside it.

    What they decide hangs on its parameters: the model is fitted to that, and they decide anew, until neither moves on.
    """
    found = model.fit
    for number in range(ADAPTING_ROUNDS):
        runs = s.adapt(s.runs, found, first=number == 0)
        s = s._replace(runs=runs)
        before = found.values
        found = fit(runs, found.passes.theta, found.free, s.mapper)
        if np.all(np.abs(found.values - before) < ADAPTED * found.deviations):
            break
    return s, model._replace(fit=found)


def _scored(s: Search, model: Candidate) -> tuple[list[Place], Tested]:
    """Return all places beside a model, tested."""
    passes, free = model.fit.passes, model.fit.free
    taken = frozenset(model.effects) - {"channel_skew"}
    harmonics = None
    if s.geared:
        harmonics = telling_harmonics(model.fit, s.mapper)
    places, directions, waves = places_of(passes, s.without | taken, harmonics)
    found = gram(passes, [*directions_of(free, passes.theta), *directions], s.mapper, waves)
    return places, score_test(found, Prior.of(free, passes.theta), places, s.seed)


def _refitted(s: Search, model: Candidate, start: Start) -> Candidate:
    """Return a model with an entry added, from where the score test puts it and the parameters beside it.

    Where the plant is not linear that far, from nearer to the model.
    """
    base, place = model.fit, start.place
    starts: list[tuple[Passes, list[str]]] = []
    for share in START_SHARES:
        theta = moved(base.passes.theta, base.free, share * start.shifts)
        new = start_of(place.effect_id, estimate(place, [share * float(v) for v in start.sizes]))
        if place.effect_id in model.effects:  # another channel of a skew
            old = values_of(theta, place.effect_id)
            new = {k: v if v != 0.0 else old[k] for k, v in new.items()}
        passes = pass_all(s.runs, with_effect(theta, place.effect_id, new), s.mapper)
        starts.append((passes, [*(e for e in model.effects if e != place.effect_id), place.effect_id]))
        if penalised(passes, base.free, base.passes) > penalised(base.passes, base.free, passes):
            return _fitted(s, model, *starts[-1], added=1)
    return _fitted(s, model, *starts[0], added=1)


def _fitted(s: Search, model: Candidate, start: Passes, effects: Sequence[str], *, added: int) -> Candidate:
    """Return the fit of a model with `effects` from a start that holds them; its gain is that above `model`.

    `added`: how many entries it has more than `model`. Each parameter costs, but for one of each entry: that one's cost
    is the threshold.
    """
    free = list(s.known)
    for effect_id in effects:
        free += effect_parameters(effect_id, values_of(start.theta, effect_id))
    found = fit_from(s.runs, start, free, s.mapper)
    base = model.fit
    gain = 2.0 * (penalised(found.passes, found.free, base.passes) - penalised(base.passes, base.free, found.passes))
    cost = COST_PER_COLUMN * (len(free) - len(base.free) - added)
    worth = s.weigh(gain - cost, scatter_between(base.passes, found.passes)) if s.weigh else gain - cost
    return Candidate(tuple(effects), found, gain - cost, worth)


def _with_likeliest_harmonics(s: Search, model: Candidate) -> Candidate:
    """Return a model with each harmonic that is likelier beside all that has joined; behind a gear it stays.

    A harmonic is no parameter that is fitted, so as many are: no cost is due.
    """
    for effect_id in model.effects:
        if s.geared or effect_id not in WAVES:
            continue
        start = likelier_harmonic(model.fit, effect_id, s.mapper)
        if start is None:
            continue
        others = [f for f in model.fit.free if f.name.rsplit(".", 1)[1] not in start.place.amplitudes]
        theta = moved(model.fit.passes.theta, others, start.shifts)
        theta = with_effect(theta, effect_id, start_of(effect_id, estimate(start.place, start.sizes.tolist())))
        changed = _fitted(s, model, pass_all(s.runs, theta, s.mapper), model.effects, added=0)
        if changed.gain > 0.0:
            model = changed._replace(gain=model.gain + changed.gain)
    return model


def _exchanged(
    s: Search, best: Candidate, rivals: tuple[Candidate, ...], steps: Sequence[Step]
) -> tuple[Candidate, tuple[Candidate, ...]]:
    """Return the best model and its rivals, with entries exchanged that were near when another joined.

    What was less likely alone may be likelier beside what joined later.
    """
    every = {frozenset(c.effects): c for c in (*rivals, best)}
    for step in steps:
        if step.joined not in best.effects:
            continue
        joined = max(c.gain for c in step.tried if c.effects[-1] == step.joined)
        near = [c for c in step.tried if c.gain > EXCHANGE_SHARE * joined and c.effects[-1] not in best.effects]
        for other in sorted(near, key=lambda c: -c.gain)[:EXCHANGES]:
            effect_id = other.effects[-1]
            effects = [effect_id if e == step.joined else e for e in best.effects]
            if frozenset(effects) in every or s.spent():
                continue
            theta = without_effect(best.fit.passes.theta, step.joined)
            theta = with_effect(theta, effect_id, values_of(other.fit.passes.theta, effect_id))
            found = _fitted(s, best, pass_all(s.runs, theta, s.mapper), effects, added=0)
            every[frozenset(effects)] = found._replace(gain=best.gain + found.gain)
    ranked = _ranked(list(every.values()), s.tied_share)
    kept = tuple(c for c in ranked if c.gain > ranked[0].gain - SET_DROP)
    if ranked[0] is best:
        return best, kept
    return _beside(s, _with_runs(s, ranked[0]))[1], kept


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
        fewer = _fitted(s, model, start, [e for e in model.effects if e != weakest], added=-1)
        if fewer.gain < -threshold:
            break  # a size of none lies further off than its deviation here says
        model = fewer._replace(gain=model.gain + fewer.gain)
    return model
