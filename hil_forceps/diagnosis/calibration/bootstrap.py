"""What runs without any effect seem to show, by a parametric bootstrap (Efron and Tibshirani, 1993, chapter 6).

The innovations are only nearly what they are taken for with coloured noise, without a load cell, and between the rows
of a faster drive. There, before an effect is named, the measured runs are simulated without it and identified alike.
Where the replicas stay below the thresholds that the score test draws, these hold. Where they don't, what the replicas
gain is taken for lognormal, and the bound is what a further one exceeds in a share α: exp(m + t s √(1 + 1/n)), with m
and s the mean and deviation of the logarithms of n of them, and t Student's quantile with n − 1 degrees of freedom.
Replicas are made by the model, and lack what it lacks: so the measured runs must exceed `LEFT_OVER_CHANCE` times that.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from hil_forceps.diagnosis.calibration.replica import replica
from hil_forceps.diagnosis.error_rates import CALIBRATED_FALSE_ALARMS, LEFT_OVER_CHANCE
from hil_forceps.diagnosis.evidence import Mapper, pass_all
from hil_forceps.diagnosis.identification import Calibration, Identified, identify, shown_by_chance
from hil_forceps.diagnosis.preparation.even_rows import EvenRun
from hil_forceps.diagnosis.validation.verdict import unexplained
from hil_forceps.rig import Rig

DRAWS, MORE_DRAWS = 2, 4  # more where the first ones exceed a threshold: the bound is the nearer to them, the more
NO_ROOM = (0.0, 0.0)


class _Asked(NamedTuple):
    """What both identifications are made with."""

    rig: Rig
    mapper: Mapper
    without: frozenset[str]
    seed: int


def identify_calibrated(
    runs: Sequence[EvenRun],
    held_out: Sequence[EvenRun],
    rig: Rig,
    *,
    mapper: Mapper,
    without: frozenset[str] = frozenset(),
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
    spent: Callable[[], bool] = lambda: False,
) -> Identified:
    """Do as `identify`; what is found where the filter is an approximation is held against replicas without it."""

    def identified(least_gain: float) -> Identified:
        return identify(
            runs,
            held_out,
            rig,
            mapper=mapper,
            without=without,
            seed=seed,
            progress=progress,
            spent=spent,
            least_gain=least_gain,
        )

    found = identified(0.0)
    if not (shows_something(found) and is_approximate(found)) or spent():
        return found
    asked = _Asked(rig, mapper, without, seed)
    calibration = calibrate(found, runs, held_out, asked, progress)
    gains = [float(step.tested.gains.max()) for step in found.found.steps if step.joined]
    bar = calibration.gain
    if gains and gains[0] > bar and min(gains) <= bar and not spent():
        found = identified(bar)
    return found._replace(calibration=calibration)


def shows_something(found: Identified) -> bool:
    """Tell whether an entry is named, or more is left than chance leaves."""
    return bool(found.found.best.effects) or unexplained(found, NO_ROOM) is not None


def is_approximate(found: Identified) -> bool:
    """Tell whether the filter takes these runs for something that they are not quite."""
    coloured = bool(np.any(found.noise.correlation != 0.0))
    between = any(record.series.samples > 1 for record in found.records)
    unmeasured = not all(record.load_measured and record.jaw_measured for record in found.records)
    return coloured or between or unmeasured


def calibrate(
    found: Identified,
    runs: Sequence[EvenRun],
    held_out: Sequence[EvenRun],
    asked: _Asked,
    progress: Callable[[str], None],
) -> Calibration:
    """Return what replicas of runs seem to show that are made by the known parameters alone."""
    theta, plant = found.found.baseline.passes.theta, found.found.baseline.passes.plants.sliding
    records = [record.with_friction_of(plant) for record in (*found.records, *found.held_out)]
    passes = pass_all(records, theta, asked.mapper)
    every = list(zip((*runs, *held_out), records, passes.runs, strict=True))
    unseen_threshold = found.unseen.threshold if found.unseen else 0.0
    thresholds = (
        found.found.steps[0].tested.threshold,
        LEFT_OVER_CHANCE * found.before.threshold,
        LEFT_OVER_CHANCE * unseen_threshold,
    )
    drawn: list[tuple[float, float, float]] = []
    for number in range(MORE_DRAWS):
        if number == DRAWS and bool(np.all(np.array(drawn) <= thresholds)):
            break
        progress(f"simulating the runs without any effect, time {number + 1}")

        def once_more(item: tuple[int, Any], number: int = number) -> EvenRun:
            place, (even, record, passed) = item
            rng = np.random.default_rng([asked.seed, number, place])
            return replica(even, record, passed, asked.rig, theta, found.noise, rng)

        again = list(asked.mapper(once_more, list(enumerate(every))))
        drawn.append(
            shown_by_chance(
                again[: len(runs)],
                again[len(runs) :],
                asked.rig,
                mapper=asked.mapper,
                without=asked.without,
                seed=asked.seed + number,
            )
        )
    bounds = [beyond(each, most) for each, most in zip(zip(*drawn, strict=True), thresholds, strict=True)]
    return Calibration(bounds[0], bounds[1], bounds[2], tuple(each[0] for each in drawn))


def beyond(drawn: Sequence[float], threshold: float) -> float:
    """Return what measured runs have to exceed; 0 where the replicas stay below the threshold."""
    if max(drawn) <= threshold:
        return 0.0
    logarithms, n = np.log(np.maximum(drawn, 1.0)), len(drawn)
    quantile = float(stats.t.isf(CALIBRATED_FALSE_ALARMS, n - 1))
    bound = math.exp(float(logarithms.mean()) + quantile * float(logarithms.std(ddof=1)) * math.sqrt(1.0 + 1.0 / n))
    return max(LEFT_OVER_CHANCE * bound, threshold)
