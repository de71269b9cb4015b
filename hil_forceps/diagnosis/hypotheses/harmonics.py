"""Which harmonics of the motor's angle to look at where they need not be whole: behind a gear or a screw.

As close as the turns that were run tell them apart; those that explain most beside a model are looked at with it.
"""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.evidence import Gram, Mapper, Passed, Wave, gram_of, total
from hil_forceps.diagnosis.hypotheses.places import Harmonics, Place
from hil_forceps.diagnosis.hypotheses.score_test import Prior, score_test
from hil_forceps.diagnosis.inference.fit import Fit, directions_of

Vector = NDArray[np.float64]

MAX_HARMONIC = 60.0  # periods in a turn
MAX_HARMONICS = 1000  # harmonics that are looked at
STEP_TURNS = 0.5  # of all turns that were run: harmonics nearer to each other are the same
KEPT_HARMONICS = 3  # the best, for the catalogue's places
HARMONICS_AT_ONCE = 50  # to spare memory


def telling_harmonics(model: Fit, mapper: Mapper) -> Harmonics:
    """Return the harmonics of torques, with and without the current, that explain most beside a model."""
    passes = model.passes
    courses = [run.course(passes.plant, before=False) for run in passes.runs]
    turns = max(float(np.ptp(c.theta_m)) for c in courses) / (2.0 * np.pi)
    step = max(min(1.0, STEP_TURNS / max(turns, 1e-9)), MAX_HARMONIC / MAX_HARMONICS)
    looked_at = np.arange(1.0, MAX_HARMONIC + 0.5 * step, step)
    parts = [looked_at[first : first + HARMONICS_AT_ONCE] for first in range(0, looked_at.size, HARMONICS_AT_ONCE)]
    known = directions_of(model.free, passes.theta)

    def one(run: Passed) -> list[Gram]:
        answers, residual = run.answers(passes.plant, known), (run.influence * run.residual).ravel()
        found = []
        for with_current in (False, True):
            for some in parts:
                waves = [Wave(float(h), cosine, with_current, 1.0) for h in some for cosine in (False, True)]
                found.append(gram_of((answers, run.answers(passes.plant, [], waves)), residual))
        return found

    prior = Prior.of(model.free, passes.theta)
    gains = []
    for grams, some in zip(zip(*mapper(one, passes.runs), strict=True), (*parts, *parts), strict=True):
        places = [Place("", {}, {}, 2 * i, 2 * i + 2, False) for i in range(some.size)]
        gains.append(score_test(total(list(grams)), prior, places).gains)
    cogging, ripple = (_best(looked_at, half) for half in np.split(np.concatenate(gains), 2))
    return Harmonics(cogging, ripple, max(1, looked_at.size // KEPT_HARMONICS))


def _best(harmonics: Vector, gains: Vector) -> tuple[float, ...]:
    return tuple(sorted(float(harmonics[i]) for i in np.argsort(-gains)[:KEPT_HARMONICS]))
