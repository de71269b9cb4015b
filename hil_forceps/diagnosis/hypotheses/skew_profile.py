"""Profile likelihood over the skew of a channel.

A skew of several rows is far from linear, and parameters that were fitted without it can be far off. So a refit begins
at the likeliest of some skews, beside the parameters as they are fitted or as the rig has them.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.evidence import Passes, pass_all
from hil_forceps.diagnosis.hypotheses.candidate import Candidate, Search
from hil_forceps.diagnosis.inference.fit import penalised
from hil_forceps.diagnosis.inference.parameters import start_of, values_of, with_effect
from hil_forceps.rig.catalogue import effect

Vector = NDArray[np.float64]

SKEW: Final = "channel_skew"
MIN_ROWS: Final = 0.1  # by the score test: of a channel that changes from row to row, it sees as little of many rows
ROWS: Final = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
REFINING_RATIOS: Final = (1.4, 1.2, 1.1, 1.05, 1.025)  # each about the root of the one before, from 2 on


class _Look(NamedTuple):
    gain: float  # of the log posterior
    theta: Vector  # beside which
    skew_s: float
    passes: Passes


def likeliest_skew(s: Search, model: Candidate, channel: str, estimate_s: float) -> Passes | None:
    """Return passes beside the likeliest skew of a channel; None where `estimate_s`, of the score test, has to do."""
    base = model.fit
    period_s = base.passes.runs[0].course(base.passes.plant, before=True).period_s
    if abs(estimate_s) < MIN_ROWS * period_s:
        return None
    limits = {p.name: (p.minimum, p.maximum) for p in effect(SKEW).parameters}[channel]

    def looked_at(theta: Vector, skew_s: float) -> _Look:
        skew_s = float(np.clip(skew_s, *limits))
        values = start_of(SKEW, {**values_of(theta, SKEW), channel: skew_s})
        passes = pass_all(s.runs, with_effect(theta, SKEW, values), s.mapper)
        gain = penalised(passes, base.free, base.passes) - penalised(base.passes, base.free, passes)
        return _Look(gain if np.isfinite(gain) else -np.inf, theta, skew_s, passes)

    best = looked_at(base.passes.theta, estimate_s)
    for theta in (base.passes.theta, _as_the_rig_has_them(s, base.passes.theta)):
        for rows in ROWS:
            for sign in (1.0, -1.0):  # of a motion that recurs, the score test may see the nearer side
                best = _better(best, looked_at(theta, sign * rows * period_s))
    for ratio in REFINING_RATIOS:
        for factor in (ratio, 1.0 / ratio):
            best = _better(best, looked_at(best.theta, factor * best.skew_s))
    return best.passes if best.gain > 0.0 else None


def _better(one: _Look, other: _Look) -> _Look:
    return other if other.gain > one.gain else one


def _as_the_rig_has_them(s: Search, theta: Vector) -> Vector:
    """Return a vector with the known parameters at the centres of their priors."""
    changed = theta.copy()
    for f in s.known:
        changed[f.place] = f.centre
    return changed
