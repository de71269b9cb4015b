"""Where the refit of an entry begins: at the likeliest of some points.

The score test puts it where the innovations are linear. A large effect is not: parameters that were fitted without it
are far off, and so is the size that seems best beside them. So larger sizes are looked at as well, beside the
parameters as they are fitted and as the rig has them. Of a channel's skew, whole rows are.
"""

from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.evidence import Passes, pass_all
from hil_forceps.diagnosis.hypotheses.candidate import Candidate, Search
from hil_forceps.diagnosis.hypotheses.places import estimate
from hil_forceps.diagnosis.hypotheses.shortlist import Start
from hil_forceps.diagnosis.inference.fit import chi2_above, moved
from hil_forceps.diagnosis.inference.parameters import start_of, values_of, with_effect
from hil_forceps.rig.catalogue import effect

Vector = NDArray[np.float64]
Values = Mapping[str, float]

SKEW: Final = "channel_skew"
REDUCED_SHARES: Final = (1.0, 0.3, 0.1)  # shares of what the score test finds, until the likelihood rises
MAX_DOUBLINGS: Final = 5  # of what it finds, as long as the likelihood rises
# Where the score test finds less, the skew is within a row. It finds little of a skew of many rows, too, where a
# channel changes from row to row.
MIN_SKEW_ROWS: Final = 0.1
SKEW_ROWS: Final = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
REFINING_RATIOS: Final = (1.4, 1.2, 1.1, 1.05, 1.025)  # each about the root of the one before, from 2 on


class _Trial(NamedTuple):
    gain: float  # χ² above the model without the entry; −∞ where the filter diverges
    passes: Passes
    skew_s: float = 0.0


def starting_point(s: Search, model: Candidate, start: Start) -> Passes:
    """Return passes at the likeliest point that a refit may begin at."""
    best = max(_sizes_tried(s, model, start), key=lambda trial: trial.gain)
    if start.place.effect_id == SKEW:
        ((channel, skew_s),) = ((k, v) for k, v in estimate(start.place, start.sizes.tolist()).items() if v != 0.0)
        skewed = _likeliest_skew(s, model, channel, skew_s)
        if skewed is not None and skewed.gain > best.gain:
            best = skewed
    return best.passes


def _sizes_tried(s: Search, model: Candidate, start: Start) -> Iterator[_Trial]:
    """Yield the entry as the score test has it, smaller until that is likelier than none, and larger."""
    base, place = model.fit, start.place

    def at(theta: Vector, share: float) -> _Trial:
        values = estimate(place, [share * float(v) for v in start.sizes])
        return _tried(s, model, theta, place.effect_id, values)

    linear = _Trial(-np.inf, base.passes)
    for share in REDUCED_SHARES:
        linear = at(moved(base.passes.theta, base.free, share * start.shifts), share)
        yield linear
        if linear.gain > 0.0:
            break
    for theta in (base.passes.theta, _as_the_rig_has_them(s, base.passes.theta)):
        likeliest = linear.gain if theta is base.passes.theta else -np.inf
        for doublings in range(MAX_DOUBLINGS + 1):
            trial = at(theta, 2.0**doublings)
            yield trial
            if trial.gain <= likeliest:
                break
            likeliest = trial.gain


def _tried(s: Search, model: Candidate, theta: Vector, effect_id: str, values: Values) -> _Trial:
    """Return passes with an entry of these values beside the parameters `theta`, and what it gains."""
    base, new = model.fit, start_of(effect_id, values)
    if effect_id in model.effects:  # another channel of a skew
        old = values_of(theta, effect_id)
        new = {k: v if v != 0.0 else old[k] for k, v in new.items()}
    passes = pass_all(s.runs, with_effect(theta, effect_id, new), s.mapper)
    gain = chi2_above(base, passes, base.free)
    return _Trial(gain if np.isfinite(gain) else -np.inf, passes)


def _likeliest_skew(s: Search, model: Candidate, channel: str, estimate_s: float) -> _Trial | None:
    """Return the likeliest of the skews of whole rows; None where the score test's is far within one."""
    base = model.fit
    period_s = base.passes.runs[0].course(base.passes.plant, before=True).period_s
    if abs(estimate_s) < MIN_SKEW_ROWS * period_s:
        return None
    limits = {p.name: (p.minimum, p.maximum) for p in effect(SKEW).parameters}[channel]

    def at(theta: Vector, skew_s: float) -> _Trial:
        skew_s = float(np.clip(skew_s, *limits))  # a refinement may go beyond
        return _tried(s, model, theta, SKEW, {channel: skew_s})._replace(skew_s=skew_s)

    best = _Trial(-np.inf, base.passes)
    for theta in (base.passes.theta, _as_the_rig_has_them(s, base.passes.theta)):
        reached = {float(np.clip(sign * rows * period_s, *limits)) for rows in SKEW_ROWS for sign in (1.0, -1.0)}
        for skew_s in sorted(reached):  # both sides: of a motion that recurs, the score test may see the nearer one
            best = _better(best, at(theta, skew_s))
    for ratio in REFINING_RATIOS:
        for factor in (ratio, 1.0 / ratio):
            best = _better(best, at(best.passes.theta, factor * best.skew_s))
    return best


def _better(one: _Trial, other: _Trial) -> _Trial:
    return other if other.gain > one.gain else one


def _as_the_rig_has_them(s: Search, theta: Vector) -> Vector:
    """Return a vector with the known parameters at the centres of their priors."""
    changed = theta.copy()
    for f in s.known:
        changed[f.place] = f.centre
    return changed
