"""What was found, looked at once more with the load smoothed less.

Smoothing may bend the load by some deviations of its noise at every corner. Many corners bent alike look like an effect
that the catalogue doesn't have, or like a weak one that it has, whereas an effect that is there stays when the load is
smoothed less and keeps its corners.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

from hil_forceps.diagnosis.anew import Refresh, courses_of
from hil_forceps.diagnosis.assemble import Setting, assemble
from hil_forceps.diagnosis.choice import Choice, Rival, below_threshold
from hil_forceps.diagnosis.echoes import load_echoes
from hil_forceps.diagnosis.experiment import smoothed_anew
from hil_forceps.diagnosis.extension import Model, without_effect
from hil_forceps.diagnosis.fit import fit, fit_again
from hil_forceps.diagnosis.leftover import Leftover, curves_along, leftover
from hil_forceps.diagnosis.linear import Response
from hil_forceps.diagnosis.look import noise_of
from hil_forceps.diagnosis.smoothing import LESS_BENT, LoadNoise
from hil_forceps.diagnosis.spectrum import Whitener, whitening
from hil_forceps.rig import Rig

STEPS = 4
WEAK = 100.0  # gains from here on are more than bent corners have been seen to give
STAYS = 0.25  # of the gain of a weak effect, with the load smoothed less: noise takes some of it

Sharper = Callable[[Choice], tuple[Setting, Model, Whitener]]


def with_sharper_load(noise: LoadNoise, rig: Rig, refresh: Refresh) -> Sharper:
    """Return what refits a choice's model with less of the load smoothed away; once for each choice."""

    @cache
    def sharper(choice: Choice) -> tuple[Setting, Model, Whitener]:
        chosen, whitener = choice.model, choice.whitener
        records = smoothed_anew(chosen.problem.records, noise, LESS_BENT)
        setting = assemble(records, rig, chosen.problem.mapper, chosen.problem.shared)
        problem = refresh(replace(setting.problem, base=chosen.problem.base), chosen.fit.u)
        found = fit(problem, chosen.fit.u, whitener, steps=STEPS)
        problem = refresh(problem, found.u)
        model = replace(chosen, problem=problem, fit=fit(problem, found.u, whitener, steps=STEPS))
        noise_left, _ = noise_of(model, choice.scan.columns, whitener, setting.floor)
        whitener = whitening(problem.layout, noise_left)
        return setting, replace(model, fit=fit_again(problem, model.fit, whitener)), whitener

    return sharper


def confirmed(choice: Choice, sharper: Sharper) -> Choice:
    """Return the choice without weak effects that lose most of their gain with less of the load smoothed away."""
    gains = {c.id: c.score for c in choice.candidates if c.state == "named" and c.score < WEAK}
    model, inflation = choice.model, choice.inflation
    if not gains.keys() & set(model.effects):
        return choice
    _, sharp, whitener = sharper(choice)
    # Both are to be compared, so this one is fitted to its end, too.
    sharp = replace(sharp, fit=fit(sharp.problem, sharp.fit.u, whitener, steps=2 * STEPS))
    for place in reversed(range(len(model.effects))):
        name = model.effects[place]
        if name not in gains:
            continue
        less = without_effect(sharp, place, whitener)
        gain = (less.fit.chi2 - sharp.fit.chi2) / inflation.get(name, 1.0)
        if gain < STAYS * gains[name]:
            sharp, model = less, without_effect(model, place, choice.whitener)
    if model.effects == choice.model.effects:
        return choice
    dropped = {c.id for c in choice.candidates} - set(model.effects)
    candidates = tuple(below_threshold(choice.candidates, dropped))
    return replace(choice, model=model, rivals=(Rival(model, 0.0),), candidates=candidates)


def left_with_sharper_load(choice: Choice, sharper: Sharper, responses: Sequence[Response], seed: int) -> Leftover:
    """Return what is left beside the chosen model, refitted, with less of the load smoothed away."""
    setting, model, whitener = sharper(choice)
    problem = model.problem
    curves = curves_along(courses_of(setting, model), problem.layout, responses, problem.mapper)
    return leftover(model, whitener, curves, load_echoes(problem, model.fit.u), seed)
