"""The verdict on identified runs, its words, and the numbers of the result."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from hil_forceps.diagnosis.error_rates import FALSE_ALARMS, STEP_ACCURACY, STEP_ERROR_SHARE
from hil_forceps.diagnosis.identified import Identified
from hil_forceps.diagnosis.inference.fit import Fit, inverted
from hil_forceps.diagnosis.inference.parameters import Free, known
from hil_forceps.diagnosis.lack_of_fit.omnibus_test import LackOfFit
from hil_forceps.diagnosis.result import TWO_SIDED_95, Candidate, Estimate, NamedEffect, Shift, Verdict
from hil_forceps.diagnosis.validation.numbers import varies_over
from hil_forceps.model.parameters import index
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import effect

SHIFT_SD = 3.29  # a parameter is said to be shifted this far from what was assumed: 1 in 1000 by chance
LEAST_SHIFT = 0.2  # of what was known: less is no shift, however well it is measured


class Judgement(NamedTuple):
    """The verdict and why."""

    verdict: Verdict
    sentence: str
    effects: tuple[NamedEffect, ...]
    sets: tuple[tuple[str, ...], ...]
    shifts: dict[str, Shift]
    varies_over: tuple[str, ...]
    reasons: tuple[str, ...]


def judge(found: Identified, rig: Rig, room: tuple[float, float] = (STEP_ERROR_SHARE, STEP_ERROR_SHARE)) -> Judgement:
    """Return the verdict; `room`: shares of what is explained that may be left in fitted and in held-out runs."""
    best = found.found.best
    shifts = parameter_shifts(best.fit, rig)
    sets = tuple(model.effects for model in found.found.rivals if model.effects)
    if (left := unexplained(found, room)) is not None:
        worst = left.families[0]
        said = "No entry of the catalogue explains the data. "
        said += f"The lack of fit is at {worst.place}, and varies over {worst.variable}."
        where = "" if left is found.after else " in the runs held out"
        nearest = " + ".join(best.effects)
        nearby = (f"the best of the catalogue, {nearest}, leaves a significant lack of fit{where}",) if nearest else ()
        return Judgement("unnamed", said, (), sets, shifts, varies_over(left), nearby)
    cut_short = tuple(
        f"the time limit was reached before this was tested: {what}" for what in found.found.not_looked_at
    )
    if best.effects:
        named = named_effects(found)
        acting = {e.id for e in named if plausibility(e.id, e.parameters) < 1.0}
        words = [("an effect similar to " if e.id in acting else "") + effect(e.id).summary for e in named]
        said = f"The data show: {' and '.join(words)}."
        said += " Other entries explain the data equally well." if len(sets) > 1 else ""
        tied = "the data can't distinguish between " + ", ".join(" + ".join(ids) for ids in sets)
        reasons = (*((tied,) if len(sets) > 1 else ()), *cut_short)
        reasons = (*reasons, *_implausible(named))
        over: tuple[str, ...] = ()
        if found.after.significant:
            share = found.after.gain / (found.after.gain + found.found.explained)
            reasons += (f"the named entries leave a lack of fit: {share:.1g} of the misfit that they explain",)
            over = varies_over(found.after)
        return Judgement("effects", said, named, sets, shifts, over, reasons)
    if cut_short:
        return Judgement("undetermined", f"No result: {cut_short[0]}.", (), (), shifts, (), cut_short)
    if shifts and moved(best.fit, rig) > float(stats.chi2.isf(FALSE_ALARMS, len(_assumed(best.fit, rig)))):
        said = f"Other values of known parameters explain the data: {', '.join(shifts)}."
        return Judgement("parameters", said, (), (), shifts, (), ())
    return Judgement("consistent", "The simulation agrees with the data to within their noise.", (), (), {}, (), ())


def unexplained(found: Identified, room: tuple[float, float]) -> LackOfFit | None:
    """Return what is left beyond doubt, in the fitted runs or in those held out.

    Beside named effects a small share of what they explain may be left: the model's own step and its linear answers are
    not exact.
    """
    for left, share in zip((found.after, found.unseen), room, strict=True):
        if left is None or not left.significant:
            continue
        if left.gain > share * found.found.explained:
            return left
    return None


def named_effects(found: Identified) -> tuple[NamedEffect, ...]:
    """Return the effects of the best model, with intervals of their parameters."""
    best = found.found.best
    named = []
    for effect_id in best.effects:
        parameters = {}
        for free, value, deviation in zip(best.fit.free, best.fit.values, best.fit.deviations, strict=True):
            if free.name.startswith(f"effects.{effect_id}."):
                spread = float(np.hypot(deviation, STEP_ACCURACY * value))
                parameters[free.name.rsplit(".", 1)[1]] = _estimate(free, float(value), spread)
        for p in effect(effect_id).parameters:
            if p.neutral is None and p.name not in parameters:  # a shape that is not fitted: a whole harmonic
                held = float(best.fit.passes.theta[index(f"effects.{effect_id}.{p.name}")])
                parameters[p.name] = Estimate(held, held, held, p.unit)
        sure = confidence(found, effect_id) * plausibility(effect_id, parameters)
        named.append(NamedEffect(effect_id, effect(effect_id).location, sure, parameters))
    return tuple(named)


def plausibility(effect_id: str, parameters: Mapping[str, Estimate]) -> float:
    """Return how far an effect's size bears out its name: 1 as far as hardware has it, 0.25 at twice that.

    As of a prior with so long a tail: what lies far outside acts like the entry, and is likelier something else.
    """
    beyond = [abs(parameters[p.name].value) / p.plausible for p in effect(effect_id).parameters if p.name in parameters]
    return min(1.0, max(beyond, default=1.0) ** -2) if max(beyond, default=0.0) > 0.0 else 1.0


def _implausible(named: Sequence[NamedEffect]) -> tuple[str, ...]:
    return tuple(
        f"{e.id} is larger than in known hardware: the cause may be another effect that is similar"
        for e in named
        if plausibility(e.id, e.parameters) < 1.0
    )


def confidence(found: Identified, effect_id: str) -> float:
    """Return the share of the weight of all models within reach that name the effect."""
    rivals = found.found.rivals
    top = max(model.gain for model in rivals)
    weights = np.array([np.exp(0.5 * (model.gain - top)) for model in rivals])
    has = np.array([effect_id in model.effects for model in rivals])
    return float(weights[has].sum() / weights.sum())


def parameter_shifts(fitted: Fit, rig: Rig) -> dict[str, Shift]:
    """Return the known parameters that are not what was assumed."""
    shifts = {}
    for free, value, deviation in zip(fitted.free, fitted.values, fitted.deviations, strict=True):
        if free.name.startswith("effects."):
            continue
        assumed = known(rig, free.name).value
        shares = LEAST_SHIFT * (0.3 if "coulomb" in free.name else 1.0)
        if assumed is None or abs(value - assumed) > max(SHIFT_SD * deviation, shares * free.scale):
            shifts[free.name] = Shift(assumed, _estimate(free, float(value), float(deviation)))
    return shifts


def moved(fitted: Fit, rig: Rig) -> float:
    """Return the χ² by which the data move the known parameters from what was assumed."""
    at = _assumed(fitted, rig)
    away = np.array([(fitted.values[i] - (known(rig, fitted.free[i].name).value or 0.0)) for i in at])
    scaled = away / np.array([fitted.free[i].scale for i in at])
    return float(scaled @ inverted(fitted.covariance[np.ix_(at, at)]) @ scaled)


def _assumed(fitted: Fit, rig: Rig) -> list[int]:
    """Return the places of the parameters of which the rig says a value."""
    return [
        i
        for i, free in enumerate(fitted.free)
        if not free.name.startswith("effects.") and known(rig, free.name).value is not None
    ]


def _estimate(free: Free, value: float, deviation: float) -> Estimate:
    """Return a value with its 95 % interval, within the bounds of the parameter."""
    half = TWO_SIDED_95 * deviation
    return Estimate(value, max(value - half, free.low), min(value + half, free.high), free.unit)


def candidates(found: Identified) -> tuple[Candidate, ...]:
    """Return every entry as it was judged in each step of the search, the best of its places."""
    told: list[Candidate] = []
    tied = {model.effects[-1] for model in found.found.rivals if model.effects}
    for number, step in enumerate(found.found.steps):
        refitted = {model.effects[-1]: model for model in step.tried if model.effects}
        gains: dict[str, float] = {}
        for place, gain in zip(step.places, step.tested.gains, strict=True):
            gains[place.effect_id] = max(float(gain), gains.get(place.effect_id, 0.0))
        for effect_id, linear in gains.items():
            gain = refitted[effect_id].gain if effect_id in refitted else linear
            state = "weaker"
            if effect_id == step.joined and effect_id in found.found.best.effects:
                state = "named"
            elif gain <= step.tested.threshold:
                state = "below threshold" if linear > 0.0 else "not excited"
            elif effect_id in tied and step.joined:
                state = "tied"
            told.append(Candidate(effect_id, number, gain, step.tested.threshold, state))  # type: ignore[arg-type]
    return tuple(told)
