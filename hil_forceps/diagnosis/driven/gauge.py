"""What no sensor shows: both radii times s with the stiffness over s² are one machine.

A fit holds one radius. Where the rig knows no value of it, the others' intervals hold for that radius alone, and what
is really known is r_m/r_j and k r_j².
"""

from collections.abc import Mapping

import numpy as np

from hil_forceps.diagnosis.driven.starting_values import R_J, R_M
from hil_forceps.diagnosis.inference.parameters import known
from hil_forceps.diagnosis.result import Estimate, Shift
from hil_forceps.rig import Rig

K = "forceps.wire_stiffness_N_per_m"


def with_scale(shifts: Mapping[str, Shift], rig: Rig) -> tuple[dict[str, Shift], tuple[str, ...]]:
    """Return parameters with intervals over all scales that the rig's bounds allow, and what does show, in words.

    As they are where the rig knows a radius, or where radius and stiffness weren't both fitted as unknowns.
    """
    held = known(rig, R_M)
    found = dict(shifts)
    if held.minimum is None or held.maximum is None or held.value is None or not {R_J, K} <= shifts.keys():
        return found, ()
    if shifts[R_J].assumed is not None or shifts[K].assumed is not None:
        return found, ()
    radius, stiffness = shifts[R_J].fitted, shifts[K].fitted
    bounds_j, bounds_k = known(rig, R_J), known(rig, K)
    least = [held.minimum / held.value, _or(bounds_j.minimum, 0.0) / radius.value]
    most = [held.maximum / held.value, _or(bounds_j.maximum, np.inf) / radius.value]
    least.append(float(np.sqrt(stiffness.value / _or(bounds_k.maximum, np.inf))))
    most.append(float(np.sqrt(stiffness.value / max(_or(bounds_k.minimum, 0.0), 1e-30))))
    low, high = max(least), min(most)
    found[R_M] = Shift(None, Estimate(held.value, held.value * low, held.value * high, "m"))
    found[R_J] = Shift(None, Estimate(radius.value, radius.low * low, radius.high * high, radius.unit))
    wide = Estimate(stiffness.value, stiffness.low / high**2, stiffness.high / low**2, stiffness.unit)
    found[K] = Shift(None, wide)
    ratio = held.value / radius.value
    turned = stiffness.value * radius.value**2
    relative = float(np.hypot(_half(stiffness), 2.0 * _half(radius)))
    text = (
        f"no sensor shows the common scale of radii and stiffness; determined are "
        f"r_m/r_j = {ratio:.4g} [{held.value / radius.high:.4g}, {held.value / radius.low:.4g}] and "
        f"k r_j² = {turned:.4g} [{turned * (1 - relative):.4g}, {turned * (1 + relative):.4g}] N m/rad"
    )
    return found, (text,)


def _half(estimate: Estimate) -> float:
    """Return half the interval over the value."""
    return 0.5 * (estimate.high - estimate.low) / abs(estimate.value)


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value
