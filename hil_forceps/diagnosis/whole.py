"""Harmonics that are whole: what goes round with the motor repeats each turn, whatever arc was run.

Over an arc any number near it fits as well, and beyond that arc it runs out of step. Fitted free, 11 of 11
harmonics had one whole number in their interval, the true one.
"""

from dataclasses import replace

import numpy as np

from hil_forceps.diagnosis.entries import HARMONIC
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.fit import deviations, fit, hold
from hil_forceps.diagnosis.result import TWO_SIDED_95
from hil_forceps.diagnosis.spectrum import Whitener
from hil_forceps.diagnosis.unknowns import Unknowns
from hil_forceps.model.parameters import index

STEPS = 6


def with_whole_harmonics(model: Model, whitener: Whitener) -> Model:
    """Return the model with each harmonic held whose 95 % interval has one whole number, where that fits as well.

    Behind a gear a harmonic may be any number: then none is in it, or holding it makes the fit worse.
    """
    for item in model.problem.shared.items:
        if item.name.endswith(f".{HARMONIC}"):
            held = _held_whole(model, item.name, whitener)
            if held is not None and held.worth <= model.worth:
                model = held
    return model


def _held_whole(model: Model, name: str, whitener: Whitener) -> Model | None:
    """Return the model with this harmonic held at the whole number in its interval; None where there isn't just one."""
    problem, u = model.problem, model.fit.u
    items = problem.shared.items
    place = problem.shared.names.index(name)
    value = float(problem.shared.values(u[: len(items)])[place])
    half = TWO_SIDED_95 * items[place].scale * float(deviations(model.fit)[place])
    whole = float(round(value))
    if abs(whole - value) > half or half >= 1.0 - abs(whole - value):
        return None
    base = problem.base.copy()
    base[index(name)] = whole
    shared = Unknowns(tuple(item for item in items if item.name != name))
    problem = replace(problem.with_shared(shared), base=base)
    known = problem.shared.known
    rest = [*range(known), *range(len(items), u.size)]
    held = hold(model.fit.jacobian[:, rest], known, whitener)
    return replace(model, problem=problem, fit=fit(problem, np.delete(u, place), whitener, held=held, steps=STEPS))
