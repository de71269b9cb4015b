"""Profile likelihood over the harmonics of a torque that recurs with the motor's angle.

The harmonic is chosen when its entry joins, beside a model that lacks the entries that join later. A neighbour can be
equally likely then, and far less likely beside the complete model.
"""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.evidence import Gram, Mapper, gram
from hil_forceps.diagnosis.hypotheses.entries import HARMONIC, Probe
from hil_forceps.diagnosis.hypotheses.places import estimate, place_of, usual_harmonics, waves_of
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
    own_harmonic, size = values_of(theta, effect_id)[HARMONIC], max(abs(float(theta[f.place])) for f in own)
    harmonics = sorted({*usual_harmonics(passes.plant), own_harmonic})
    units = dict.fromkeys(amplitudes, size)
    probes = [Probe(effect_id, {HARMONIC: h, **units}, tuple(amplitudes), one_sided=False) for h in harmonics]
    waves = [wave for probe in probes for wave in waves_of(probe)]
    found = gram(passes, [*directions_of(others, theta), *directions_of(own, theta)], mapper, waves)
    first, behind = len(others), len(others) + len(own)
    off = np.array([-float(theta[f.place]) / f.scale for f in own])
    score = found.score + found.information[:, first:behind] @ off
    kept = np.r_[0:first, behind : score.size]
    without = Gram(found.information[np.ix_(kept, kept)], score[kept])
    count = len(amplitudes)
    places = [place_of(probe, count * i, count * (i + 1), looks=1) for i, probe in enumerate(probes)]
    tested = score_test(without, Prior.of(others, theta), places)
    best = int(np.argmax(tested.gains))
    if harmonics[best] == own_harmonic:
        return None
    changed = moved(theta, others, tested.shifts[best])
    return with_effect(changed, effect_id, start_of(effect_id, estimate(places[best], tested.sizes[best].tolist())))
