"""What is left, looked at once more with the load smoothed less.

Smoothing may bend the load by some deviations of its noise at every corner. Many corners bent alike look like an effect
that the catalogue doesn't have, whereas such an effect stays when the load is smoothed less and keeps its corners.
"""

from collections.abc import Sequence
from dataclasses import replace

from hil_forceps.diagnosis.anew import Refresh, courses_of
from hil_forceps.diagnosis.assemble import assemble
from hil_forceps.diagnosis.choice import Choice
from hil_forceps.diagnosis.experiment import smoothed_anew
from hil_forceps.diagnosis.fit import fit, fit_again
from hil_forceps.diagnosis.leftover import Leftover, curves_along, leftover
from hil_forceps.diagnosis.linear import Response
from hil_forceps.diagnosis.look import noise_of
from hil_forceps.diagnosis.smoothing import LESS_BENT, LoadNoise
from hil_forceps.diagnosis.spectrum import whitening
from hil_forceps.rig import Rig

STEPS = 4


def left_with_sharper_load(
    choice: Choice, noise: LoadNoise, rig: Rig, refresh: Refresh, responses: Sequence[Response], seed: int
) -> Leftover:
    """Return what is left beside the chosen model, refitted, with less of the load smoothed away."""
    chosen, whitener = choice.model, choice.whitener
    records = smoothed_anew(chosen.problem.records, noise, LESS_BENT)
    setting = assemble(records, rig, chosen.problem.mapper, chosen.problem.shared)
    problem = refresh(replace(setting.problem, base=chosen.problem.base), chosen.fit.u)
    found = fit(problem, chosen.fit.u, whitener, steps=STEPS)
    problem = refresh(problem, found.u)
    model = replace(chosen, problem=problem, fit=fit(problem, found.u, whitener, steps=STEPS))
    noise_left, _ = noise_of(model, choice.scan.columns, whitener, setting.floor)
    whitener = whitening(problem.layout, noise_left)
    model = replace(model, fit=fit_again(problem, model.fit, whitener))
    curves = curves_along(courses_of(setting, model), problem.layout, whitener, responses, problem.mapper)
    return leftover(model, whitener, curves, seed)
