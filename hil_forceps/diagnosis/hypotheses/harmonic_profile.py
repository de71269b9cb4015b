"""Profile likelihood over the harmonics of a torque that recurs with the motor's angle.

A harmonic is chosen when its entry joins, beside a model that lacks what joins later. A neighbour may have been as
likely then, and is worse by far beside the whole model.
"""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.evidence import Gram, Mapper, Wave, gram
from hil_forceps.diagnosis.hypotheses.entries import HARMONIC
from hil_forceps.diagnosis.hypotheses.places import HARMONICS, WAVES, Place, estimate
from hil_forceps.diagnosis.hypotheses.score_test import Prior, score_test
from hil_forceps.diagnosis.inference.fit import Fit, directions_of, moved
from hil_forceps.diagnosis.inference.parameters import start_of, values_of, with_effect
from hil_forceps.rig.catalogue import effect

Vector = NDArray[np.float64]


def likelier_harmonic(model: Fit, effect_id: str, mapper: Mapper) -> Vector | None:
    """Return parameters with another harmonic that explains more than an effect's own in a model; None where none does.

    The effect is linear in its amplitudes a: without it the residuals are r − J a, and harmonics are scored on these.
    """
    passes, theta = model.passes, model.passes.theta
    amplitudes = [p.name for p in effect(effect_id).parameters if p.neutral is not None]
    names = [f"effects.{effect_id}.{name}" for name in amplitudes]
    own = [f for f in model.free if f.name in names]
    others = [f for f in model.free if f.name not in names]
    plant = passes.plants.sliding
    harmonics = sorted({*HARMONICS, plant.r_m / plant.r_j, values_of(theta, effect_id)[HARMONIC]})
    size = max(abs(float(theta[f.place])) for f in own)
    waves = [Wave(h, name.startswith("cosine"), WAVES[effect_id], size) for h in harmonics for name in amplitudes]
    found = gram(passes, [*directions_of(others, theta), *directions_of(own, theta)], mapper, waves)
    first, behind = len(others), len(others) + len(own)
    off = np.array([-float(theta[f.place]) / f.scale for f in own])
    score = found.score + found.information[:, first:behind] @ off
    kept = np.r_[0:first, behind : score.size]
    without = Gram(found.information[np.ix_(kept, kept)], score[kept])
    units = dict.fromkeys(amplitudes, size)
    places = [
        Place(effect_id, {HARMONIC: h}, units, len(amplitudes) * i, len(amplitudes) * (i + 1), one_sided=False)
        for i, h in enumerate(harmonics)
    ]
    tested = score_test(without, Prior.of(others, theta), places)
    best = int(np.argmax(tested.gains))
    if harmonics[best] == values_of(theta, effect_id)[HARMONIC]:
        return None
    changed = moved(theta, others, tested.shifts[best])
    return with_effect(changed, effect_id, start_of(effect_id, estimate(places[best], tested.sizes[best].tolist())))
