"""What each entry gained on the way to the best model: errors of every step on runs that were never used."""

from collections.abc import Mapping, Sequence

import numpy as np

from hil_forceps.diagnosis.driven.passed import DrivenRun, play
from hil_forceps.diagnosis.evidence import Mapper
from hil_forceps.diagnosis.hypotheses.candidate import Candidate
from hil_forceps.diagnosis.inference.fit import Fit, fit
from hil_forceps.diagnosis.inference.parameters import without_effect
from hil_forceps.diagnosis.result import Estimate, Rung


def ladder(
    best: Candidate,
    fitted: Sequence[DrivenRun],
    shown: Sequence[DrivenRun],
    values: Mapping[str, Mapping[str, Estimate]],
    floors: Mapping[str, float],
    mapper: Mapper,
) -> tuple[Rung, ...]:
    """Return a rung for the known parameters alone and one for each effect, in the order in which they joined.

    Errors are root mean squares over the rows that count of `shown`, channel by channel; each model is refitted without
    the effects above it. `values`: parameters of each entry in the best model; `floors`: rms of each channel's noise.
    """
    fits: list[Fit] = [best.fit]
    for effect_id in reversed(best.effects):
        above = fits[-1]
        free = tuple(f for f in above.free if not f.name.startswith(f"effects.{effect_id}."))
        fits.append(fit(fitted, without_effect(above.passes.theta, effect_id), free, mapper))
    rungs: list[Rung] = []
    for effect_id, step in zip(("", *best.effects), reversed(fits), strict=True):
        played = play(shown, step.passes.theta, mapper)
        squares: dict[str, list[float]] = {}
        for run, channels in zip(shown, played.channels, strict=True):
            for name, measured in run.rows.channels.items():
                squares.setdefault(name, []).append(float(np.mean((measured - channels[name])[run.mask] ** 2)))
        rmse = {name: float(np.sqrt(np.mean(each))) for name, each in squares.items()}
        gain = step_gains(rungs[0].rmse, rungs[-1].rmse, rmse, floors) if rungs else {}
        rungs.append(Rung(effect_id, rmse, gain, values.get(effect_id, {})))
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
