"""A model: effects of the catalogue and the fit with them; with one more, with one less."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.entries import HARMONIC, Probe, free_parameters
from hil_forceps.diagnosis.fit import Fit, Held, deviations, fit, follow, hold
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.result import TWO_SIDED_95
from hil_forceps.diagnosis.score import COST_PER_COLUMN
from hil_forceps.diagnosis.spectrum import Whitener
from hil_forceps.diagnosis.unknowns import Unknown
from hil_forceps.model import parameters
from hil_forceps.rig.catalogue import effect

Vector = NDArray[np.float64]
Refresh = Callable[[Problem, Vector], Problem]  # gives the problem with what hangs on the model taken anew

MAX_HALVINGS = 6
EXTEND_STEPS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Effects and the fit with them."""

    effects: tuple[str, ...]
    problem: Problem
    fit: Fit

    @property
    def at_an_end(self) -> bool:
        """Tell whether any of the effects was fitted to the end of its range."""
        return any(at_an_end(self.problem, self.fit, effect_id) for effect_id in self.effects)

    @property
    def newest_at_an_end(self) -> bool:
        """Tell whether the effect that joined last was."""
        return at_an_end(self.problem, self.fit, self.effects[-1])

    @property
    def worth(self) -> float:
        """Return χ² and what chance takes off it for each unknown: the lower the better."""
        return self.fit.chi2 + COST_PER_COLUMN * len(self.problem.shared.items)


def extend(model: Model, probe: Probe, amplitudes: Vector, whitener: Whitener, held: Held) -> Model:
    """Refit a model with an entry added, beginning where the linear look found it."""
    entry = effect(probe.effect_id)
    start = dict(probe.start)
    factors = np.full(len(probe.amplitudes), amplitudes[0]) if probe.together else amplitudes
    for name, amplitude in zip(probe.amplitudes, factors, strict=False):
        start[name] *= float(amplitude)
    for p in entry.parameters:
        start[p.name] = float(np.clip(start.get(p.name, p.neutral or 0.0), p.minimum, p.maximum))
    for _ in range(MAX_HALVINGS):
        problem, u = _with_effect(model, probe, start)
        u, chi2 = follow(problem, u, whitener, held)
        if not probe.amplitudes or chi2 < model.fit.chi2:
            break  # else the linear look has promised too much
        start |= {name: 0.5 * start[name] for name in probe.amplitudes}
    result = fit(problem, u, whitener, held=held, steps=EXTEND_STEPS)
    return Model((*model.effects, probe.effect_id), problem, result)


def _with_effect(model: Model, probe: Probe, start: dict[str, float]) -> tuple[Problem, Vector]:
    """Return the problem with an entry added, and where to begin: the model with the entry at `start`."""
    count = len(model.problem.shared.items)
    geared = model.problem.records[0].mode == "driven"  # by an angle that may be one behind a gear or a screw
    free = free_parameters(effect(probe.effect_id), probe, geared=geared)
    shared = model.problem.shared.with_effect(probe.effect_id, start, free)
    base = model.problem.base.copy()
    for name, value in start.items():
        base[parameters.index(f"effects.{probe.effect_id}.{name}")] = value
    problem = replace(model.problem.with_shared(shared), base=base)
    return problem, np.concatenate((model.fit.u[:count], np.zeros(len(shared.items) - count), model.fit.u[count:]))


def without_effect(model: Model, place: int, whitener: Whitener, *, roughly: bool = False) -> Model:
    """Return the model refitted without one of its effects; `roughly`: with the sensitivities that it had beside it."""
    gone = model.effects[place]
    items = model.problem.shared.items
    keep = [i for i, item in enumerate(items) if not item.name.startswith(f"effects.{gone}.")]
    shared = type(model.problem.shared)(tuple(items[i] for i in keep))
    base = model.problem.base.copy()
    for p in effect(gone).parameters:
        name = f"effects.{gone}.{p.name}"
        base[parameters.index(name)] = parameters.off_value(name)
    problem = replace(model.problem.with_shared(shared), base=base)
    count = len(items)
    at = [*keep, *range(count, model.fit.u.size)]
    held = hold(model.fit.jacobian[:, at], len(keep), whitener) if roughly else None
    refit = fit(problem, model.fit.u[at], whitener, held=held, steps=4)
    return Model(tuple(e for e in model.effects if e != gone), problem, refit)


def at_an_end(problem: Problem, result: Fit, effect_id: str) -> bool:
    """Tell whether a parameter of an effect ended at the end of its physical range.

    The end at which an amplitude is off is none, as long as the effect has another one.
    """
    low, high = problem.bounds()
    own = [i for i, name in enumerate(problem.shared.names) if name.startswith(f"effects.{effect_id}.")]
    for i in own:
        item, at = problem.shared.items[i], float(result.u[i])
        room = 1e-9 * max(1.0, abs(at))
        off = len(own) > 1 and item.assumed == item.low
        if (at <= low[i] + max(room, _room_at_nothing(item, result, i)) and not off) or at >= high[i] - room:
            return True
    return False


def _room_at_nothing(item: Unknown, result: Fit, place: int) -> float:
    """Return how far above its least a length, a time or a speed may be and still be none, as far as the data tell.

    A creep of 14 ms that may as well be one of 10 is a damping.
    """
    if item.assumed is not None or item.name.endswith(f".{HARMONIC}"):
        return 0.0
    return min(TWO_SIDED_95 * float(deviations(result)[place]), item.low / item.scale)
