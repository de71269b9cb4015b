"""Numbers of the result: what these data would show, how badly balances fail, over what the residual varies."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import stats

from hil_forceps.diagnosis.error_rates import DETECTION_POWER
from hil_forceps.diagnosis.hypotheses.candidate import Step
from hil_forceps.diagnosis.lack_of_fit.omnibus_test import LackOfFit
from hil_forceps.diagnosis.result import Balance, Detectable, Trend
from hil_forceps.rig.catalogue import EFFECTS, Location, effect

_PLACES: Mapping[str, tuple[Location, str]] = {
    "motor": ("motor", "theta_m_rad"),
    "wire": ("wire", "theta_j_rad"),
    "jaw": ("jaw", "theta_j_rad"),
    "theta_m_rad": ("sensor", "theta_m_rad"),
    "theta_j_rad": ("sensor", "theta_j_rad"),
    "current_A": ("timing", "current_A"),
}


def detectable(step: Step) -> dict[str, Detectable]:
    """Return the smallest amplitude of each entry that the data of a step would show in `DETECTION_POWER` of cases."""
    needed = float(np.sqrt(step.tested.threshold)) + float(stats.norm.ppf(DETECTION_POWER))
    information = np.diag(step.tested.information)
    least: dict[str, Detectable] = {}
    for place in step.places:
        if place.stop - place.first != len(place.amplitudes):
            continue  # it has no amplitude of its own
        own = information[place.first : place.stop].tolist()
        for (name, size), told in zip(place.amplitudes.items(), own, strict=True):
            if told <= 1e-6:
                continue
            value = abs(size) * needed / float(np.sqrt(told))
            parameter = next(p for p in effect(place.effect_id).parameters if p.name == name)
            held = least.get(place.effect_id)
            if value <= parameter.maximum and (held is None or value < held.value):
                least[place.effect_id] = Detectable(name, value, parameter.unit)
    return {entry.id: least[entry.id] for entry in EFFECTS if entry.id in least}


def balances(before: LackOfFit, after: LackOfFit) -> tuple[Balance, ...]:
    """Return how badly each balance fails: the best curve at each place, over what chance allows; 1 is that."""
    found = []
    for place, (location, channel) in _PLACES.items():
        first = [family.gain for family in before.families if family.place == place]
        second = [family.gain for family in after.families if family.place == place]
        if first:
            found.append(
                Balance(
                    location,
                    channel,
                    float(np.sqrt(max(*first, 0.0) / before.threshold)),
                    float(np.sqrt(max(*second, 0.0) / after.threshold)),
                )
            )
    return tuple(found)


def trends(channels: Sequence[str], before: LackOfFit, after: LackOfFit) -> tuple[Trend, ...]:
    """Return over what the residual varies, before and after: each family's gain over what chance allows."""
    later = {(family.place, family.variable): family.gain for family in after.families}
    return tuple(
        Trend(
            family.place,
            family.variable,
            family.gain / before.threshold,
            later.get((family.place, family.variable), 0.0) / after.threshold,
        )
        for family in before.families[: 2 * len(channels) + 4]
    )


def varies_over(left: LackOfFit) -> tuple[str, ...]:
    """Return the variables over which what is left varies most, with their places."""
    return tuple(dict.fromkeys(f"{f.place}: {f.variable}" for f in left.families[:4] if f.gain > left.threshold))
