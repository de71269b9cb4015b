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

HIGHEST = 60.0
MOST = 1000  # that are looked at
STEP_TURNS = 0.5  # of all turns that were run: harmonics nearer to each other are the same
KEPT = 3
AT_ONCE = 50


def telling_harmonics(model: Fit, mapper: Mapper) -> Harmonics:
    """Return the harmonics of torques, and of torques in proportion to the current, that explain most."""
    cogging, looks = _best(model, mapper, with_current=False)
    ripple, _ = _best(model, mapper, with_current=True)
    return Harmonics(cogging, ripple, max(1, looks // KEPT))


def _best(model: Fit, mapper: Mapper, *, with_current: bool) -> tuple[tuple[float, ...], int]:
    passes = model.passes
    courses = [run.course(passes.plants, before=False) for run in passes.runs]
    turns = max(float(np.ptp(c.theta_m)) for c in courses) / (2.0 * np.pi)
    step = max(min(1.0, STEP_TURNS / max(turns, 1e-9)), HIGHEST / MOST)
    looked_at = np.arange(1.0, HIGHEST + 0.5 * step, step)
    known = directions_of(model.free, passes.theta)

    def one(run: Passed) -> list[Gram]:
        answers = run.answers(passes.plants, known)
        residual = (run.influence * run.residual).ravel()
        found = []
        for first in range(0, looked_at.size, AT_ONCE):
            some = looked_at[first : first + AT_ONCE]
            waves = [Wave(float(h), cosine, with_current, 1.0) for h in some for cosine in (False, True)]
            found.append(gram_of(np.hstack((answers, run.answers(passes.plants, [], waves))), residual))
        return found

    gains = []
    for grams in zip(*mapper(one, passes.runs), strict=True):
        count = (grams[0].score.size - len(known)) // 2
        places = [Place("", {}, {}, 2 * i, 2 * i + 2, False) for i in range(count)]
        gains.append(score_test(total(list(grams)), Prior.of(model.free, passes.theta), places).gains)
    best = np.argsort(-np.concatenate(gains))[:KEPT]
    return tuple(sorted(float(looked_at[i]) for i in best)), looked_at.size
