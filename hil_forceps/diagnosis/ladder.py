"""What each entry gained on the way to the chosen model: errors of every step on runs that were never used."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hil_forceps.diagnosis.diagnose import Findings
from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.extension import without_effect
from hil_forceps.diagnosis.fit import fit
from hil_forceps.diagnosis.heldout import play
from hil_forceps.diagnosis.judge import named_effects
from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.result import Rung
from hil_forceps.rig import Rig


def ladder(
    records: Sequence[Record],
    rig: Rig,
    found: Findings,
    mapper: Mapper,
    floors: Mapping[str, float],
) -> tuple[Rung, ...]:
    """Return a rung for the known parameters alone and one for each effect, in the order in which they joined.

    Errors are root mean squares over the rows that count of all `records`, channel by channel; each model is refitted
    without the effects above it. `floors`: rms of the noise of each channel, for the gain of each step.
    """
    model, baseline, whitener = found.choice.model, found.baseline, found.choice.whitener
    values = {effect.id: effect.parameters for effect in named_effects(found)}
    models = [model]
    while models[-1].effects:
        last = len(models[-1].effects) - 1
        if last == 0:
            models.append(baseline)
            continue
        less = without_effect(models[-1], last, whitener)
        # What was left out may have stood for known parameters: they have a long way back.
        models.append(replace(less, fit=fit(less.problem, less.fit.u, whitener)))
    rungs: list[Rung] = []
    for step in reversed(models):
        played = play(records, rig, step.problem.theta(step.fit.u), 0.0, mapper)
        squares: dict[str, list[float]] = {}
        for record, channels in zip(records, played.channels, strict=True):
            for name, measured in record.channels.items():
                here = record.weights > 0.0
                squares.setdefault(name, []).append(float(np.mean((measured - channels[name])[here] ** 2)))
        rmse = {name: float(np.sqrt(np.mean(values))) for name, values in squares.items()}
        last_id = step.effects[-1] if step.effects else ""
        gain = step_gains(rungs[0].rmse, rungs[-1].rmse, rmse, floors) if rungs else {}
        rungs.append(Rung(last_id, rmse, gain, values.get(last_id, {})))
    return tuple(rungs)


def step_gains(
    first: Mapping[str, float], before: Mapping[str, float], after: Mapping[str, float], floors: Mapping[str, float]
) -> dict[str, float]:
    """Return what a step explains of the squared error that the first rung leaves above noise, channel by channel."""
    found = {}
    for name, error in after.items():
        room = first[name] ** 2 - min(floors.get(name, 0.0), first[name]) ** 2
        found[name] = (before[name] ** 2 - error**2) / room if room > 1e-12 * first[name] ** 2 else 0.0
    return found
