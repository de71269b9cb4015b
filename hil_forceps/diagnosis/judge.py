"""What the findings amount to: the verdict, its words, and every number of the result."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hil_forceps.diagnosis.bursts import ROWS, Burst, burst_of
from hil_forceps.diagnosis.choice import SET_DROP, Choice
from hil_forceps.diagnosis.diagnose import Findings
from hil_forceps.diagnosis.error_rates import DETECTION_POWER, FALSE_ALARMS, UNEXPLAINED_SHARE
from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.fit import deviations
from hil_forceps.diagnosis.lack_of_fit.omnibus_test import LackOfFit
from hil_forceps.diagnosis.leftover import OVER_CHANCE, Leftover
from hil_forceps.diagnosis.predict import CLIPS
from hil_forceps.diagnosis.result import (
    TWO_SIDED_95,
    AuditFinding,
    Balance,
    Detectable,
    Estimate,
    NamedEffect,
    Shift,
    Trend,
    Verdict,
)
from hil_forceps.diagnosis.spectrum import JAW
from hil_forceps.model.parameters import index
from hil_forceps.rig.catalogue import EFFECTS, Location, effect

Vector = NDArray[np.float64]

SHIFT_SD = 3.29  # a parameter is said to be shifted this far from what was assumed: 1 in 1000 by chance
LEAST_SHIFT = 0.2  # of what was known: less is no shift, however well it is measured
POWER_DEVIATIONS = float(stats.norm.ppf(DETECTION_POWER))
ACCURACY_OF_ALL = 2e-5
UNSEEN_SHARE = 0.1  # the same in runs held out; deleted entries' neighbours left 0.2 and 0.47
# The same where no loop keeps errors small: at a limit of the current they add up, the load's too, which is told of the
# closed loop. The truth has ten times the χ² of its noise there (limit of d = 50), and the right model left 0.57.
UNSEEN_SHARE_OPEN = 0.6
UNSEEN_OVER_CHANCE = 2.5  # right models were seen to leave up to 1.4 times chance in them
# Both at once, of a small share: right models leave no more than 0.8 in the lesser of the two, and chance has no part
# in both. Neighbours of deleted entries left 1.5 and 1.7, 2.9 and 2.2 (1.2 % of what they explain).
BOTH_OVER_CHANCE = 1.2
# In the fitted runs of a closed loop, of a small share: right models leave no more than 1.2 times chance. Three
# neighbours of a deleted cogging (d = 50) left 24 times, 1.2 % of what they explain.
FITTED_OVER_CHANCE = 5.0
# In a closed loop both only from this share on, which is chance at d = 126: right models of d = 1000 leave up to 50
# times chance in the fitted runs and 27 times in those held out, 0.05 % of what they explain; a wrong one left 0.3 %.
LEAST_SHARE = 0.001
ACCURACY = 1e-3  # of an effect's parameter: what the simulation's steps leave, however well the data show it


class Judgement(NamedTuple):
    """The verdict and why."""

    verdict: Verdict
    sentence: str
    effects: tuple[NamedEffect, ...]
    sets: tuple[tuple[str, ...], ...]
    shifts: dict[str, Shift]
    varies_over: tuple[str, ...]
    reasons: tuple[str, ...]


def judge(found: Findings) -> Judgement:
    """Return the verdict on runs that could be simulated."""
    choice, model = found.choice, found.choice.model
    shifts = parameter_shifts(model)
    sets = tuple(dict.fromkeys(rival.model.effects for rival in choice.rivals if rival.model.effects))
    if left := _unexplained(found):
        place, variable, _ = left.families[0]
        said = f"Something is there that no entry of the catalogue explains; at {place}, it varies over {variable}."
        reasons = _unnamed_reasons(model, "" if left is found.after else " in the runs held out")
        return Judgement("unnamed", said, (), sets, shifts, varies_over(left), reasons)
    if model.effects:
        named = named_effects(found)
        reasons = tuple(
            "these data can't tell " + " from ".join(" + ".join(ids) for ids in sets) + " apart"
            for _ in range(len(sets) > 1)
        )
        reasons += _better_unseen(found)
        over: tuple[str, ...] = ()
        if _beyond_numerics(found, found.after):
            share = found.after.gain / (found.after.gain + _explained(found))
            reasons += (f"beside the named entries something is left: {share:.1g} of the misfit that they explain",)
            over = varies_over(found.after)
        return Judgement("effects", _effects_sentence(named, sets), named, sets, shifts, over, reasons)
    moved = found.nominal.fit.chi2 - found.baseline.fit.chi2
    limit = float(stats.chi2.isf(FALSE_ALARMS, len(found.baseline.problem.shared.items)))
    if moved > limit and shifts:
        names = ", ".join(shifts)
        return Judgement(
            "parameters", f"Other values of known parameters explain all: {names}.", (), (), shifts, (), ()
        )
    return Judgement("consistent", "The simulation agrees with the data to within their noise.", (), (), {}, (), ())


def _unexplained(found: Findings) -> Leftover | None:
    """Return what is left beyond doubt: in the fitted runs, or beside named effects in those held out."""
    unseen = _least_unseen(found)
    looks = ((found.after, UNEXPLAINED_SHARE, OVER_CHANCE), (unseen, _unseen_share(found), UNSEEN_OVER_CHANCE))
    for left, share, over_chance in looks:
        if left is None or left.gain < over_chance * left.threshold or not _beyond_numerics(found, left):
            continue
        if not found.choice.model.effects or left.gain > share * (left.gain + _explained(found)):
            return left
    return _left_of_small_share(found)


def _left_of_small_share(found: Findings) -> Leftover | None:
    """Return what is left in the fitted runs, when it is many times chance, or beyond it in those held out, too."""
    after, unseen, driven = found.after, _least_unseen(found), _driven(found)

    def beyond(left: Leftover, times: float) -> bool:
        return left.gain > times * left.threshold and _by_no_numerics(found, left)

    if not driven and after.gain < LEAST_SHARE * (after.gain + _explained(found)):
        return None
    many = not driven and beyond(after, FITTED_OVER_CHANCE)
    both = unseen is not None and beyond(after, BOTH_OVER_CHANCE) and beyond(unseen, BOTH_OVER_CHANCE)
    return after if many or both else None


def _least_unseen(found: Findings) -> Leftover | None:
    """Return what is left in the runs held out by the one of those tied that leaves least: one that will do is enough.

    Which of them is named first is up to the fitted runs alone.
    """
    if found.unseen is None:
        return None
    return min((found.unseen, *found.unseen_of_rivals.values()), key=_over_chance)


def _over_chance(left: Leftover) -> float:
    return left.gain / left.threshold


def _better_unseen(found: Findings) -> tuple[str, ...]:
    """Say which of those tied leaves less in the runs held out than the one that is named, where any does."""
    least = _least_unseen(found)
    if found.unseen is None or least is None or least is found.unseen:
        return ()
    first = " + ".join(found.choice.model.effects)
    other = next(" + ".join(names) for names, left in found.unseen_of_rivals.items() if left is least)
    times = f"{_over_chance(found.unseen):.1f} times chance, {other} {_over_chance(least):.1f}"
    return (f"in the runs held out {first} leaves {times}",)


def _unseen_share(found: Findings) -> float:
    """Return what share of all misfit may be left in runs held out."""
    by_itself = not all(record.evenly_logged for record in found.held_out)  # a limit clips as the simulation has it
    is_open = _driven(found) or (by_itself and CLIPS in found.choice.model.effects)
    return UNSEEN_SHARE_OPEN if is_open else UNSEEN_SHARE


def _driven(found: Findings) -> bool:
    """Whether the measured motion drives the simulation."""
    return found.records[0].mode == "driven"


def _beyond_numerics(found: Findings, left: Leftover) -> bool:
    """Tell whether what is left stands out, from chance and from what numerics and the encoder's shaking leave."""
    return left.stands_out and _by_no_numerics(found, left)


def _by_no_numerics(found: Findings, left: Leftover) -> bool:
    """Tell whether more is left than numerics and the encoder's shaking leave."""
    # That grows with what there is to simulate, in the runs held out as in those fitted.
    simulated = max(found.nominal.fit.chi2 - found.choice.model.fit.chi2, left.explained)
    return left.gain > ACCURACY_OF_ALL * simulated


def _explained(found: Findings) -> float:
    """Return the fall of χ² by the named entries."""
    return found.baseline.fit.chi2 - found.choice.model.fit.chi2


def varies_over(left: Leftover | LackOfFit) -> tuple[str, ...]:
    """Return the variables over which what is left varies most, with their places."""
    return tuple(dict.fromkeys(f"{p}: {v}" for p, v, gain in left.families[:4] if gain > left.threshold))


def _unnamed_reasons(model: Model, where: str) -> tuple[str, ...]:
    if not model.effects:
        return ()
    return (f"the nearest of the catalogue, {' + '.join(model.effects)}, leaves too much unexplained{where}",)


def _effects_sentence(named: Sequence[NamedEffect], sets: Sequence[tuple[str, ...]]) -> str:
    words = " and ".join(effect(e.id).summary for e in named)
    said = f"The data show: {words}."
    return said + (" Other entries explain them as well." if len(sets) > 1 else "")


def named_effects(found: Findings) -> tuple[NamedEffect, ...]:
    """Return the named effects with intervals of their parameters."""
    model = found.choice.model
    items = model.problem.shared.items
    values = model.problem.shared.values(model.fit.u[: len(items)])
    sd = deviations(model.fit)[: len(items)]
    named = []
    for effect_id in model.effects:
        parameters = {}
        wider = float(np.sqrt(found.choice.inflation.get(effect_id, 1.0)))
        for item, value, deviation in zip(items, values, sd, strict=True):
            if item.name.startswith(f"effects.{effect_id}."):
                spread = np.hypot(float(deviation) * item.scale * wider, ACCURACY * float(value))
                half = TWO_SIDED_95 * float(spread)
                parameters[item.name.rsplit(".", 1)[1]] = Estimate(
                    float(value), float(value) - half, float(value) + half, item.unit
                )
        for p in effect(effect_id).parameters:
            if p.neutral is None and p.name not in parameters:  # a shape that is not fitted: a whole harmonic
                held = float(model.problem.base[index(f"effects.{effect_id}.{p.name}")])
                parameters[p.name] = Estimate(held, held, held, p.unit)
        named.append(NamedEffect(effect_id, effect(effect_id).location, _confidence(found, effect_id), parameters))
    return tuple(named)


def _confidence(found: Findings, effect_id: str) -> float:
    """Return the share of the weight of all models within reach that name the effect."""
    rivals = found.choice.rivals
    # Errors of the noise's colour make χ² differences less telling than they look: half their weight.
    weights = np.array([np.exp(-0.25 * rival.behind) for rival in rivals])
    has = np.array([effect_id in rival.model.effects for rival in rivals])
    return float(weights[has].sum() / weights.sum())


def parameter_shifts(model: Model) -> dict[str, Shift]:
    """Return the known parameters that are not what was assumed."""
    items = model.problem.shared.items
    values = model.problem.shared.values(model.fit.u[: len(items)])
    sd = deviations(model.fit)[: len(items)]
    shifts = {}
    for item, value, deviation in zip(items, values, sd, strict=True):
        if item.name.startswith("effects."):
            continue
        spread = float(deviation) * item.scale
        least = max(SHIFT_SD * spread, LEAST_SHIFT * (0.3 if "coulomb" in item.name else 1.0) * item.scale)
        if item.assumed is None or abs(float(value) - item.assumed) > least:
            half = TWO_SIDED_95 * spread
            shifts[item.name] = Shift(
                item.assumed, Estimate(float(value), float(value) - half, float(value) + half, item.unit)
            )
    return shifts


def detectable(found: Findings) -> dict[str, Detectable]:
    """Return the smallest amplitude of each entry that these data would show in `DETECTION_POWER` of cases."""
    scan = found.choice.scan
    projected = np.diag(scan.scores.projected)
    amplitudes = [
        (probe.effect_id, name, probe.start[name], float(projected[group.first + offset]))
        for probe, group in zip(scan.probes, scan.groups, strict=True)
        if not probe.together  # no amplitude of its own
        for offset, name in enumerate(probe.amplitudes)
    ]
    return least_detectable(amplitudes, scan.scores.threshold)


def least_detectable(amplitudes: Iterable[tuple[str, str, float, float]], threshold: float) -> dict[str, Detectable]:
    """Return the smallest detectable amplitude of each entry, in the catalogue's order.

    `amplitudes`: entry, parameter, a size of it, and its information at that size; `threshold`: of the score test.
    """
    needed = float(np.sqrt(threshold)) + POWER_DEVIATIONS
    least: dict[str, Detectable] = {}
    for effect_id, name, size, information in amplitudes:
        if information <= 1e-6:
            continue
        value = abs(size) * needed / float(np.sqrt(information))
        parameter = next(p for p in effect(effect_id).parameters if p.name == name)
        held = least.get(effect_id)
        if value <= parameter.maximum and (held is None or value < held.value):
            least[effect_id] = Detectable(name, value, parameter.unit)
    return {entry.id: least[entry.id] for entry in EFFECTS if entry.id in least}


_PLACES: Mapping[str, tuple[Location, str]] = {
    "motor": ("motor", "theta_m_rad"),
    "wire": ("wire", "theta_j_rad"),
    "jaw": ("jaw", "theta_j_rad"),
    "theta_m_rad": ("sensor", "theta_m_rad"),
    "theta_j_rad": ("sensor", "theta_j_rad"),
    "current_A": ("timing", "current_A"),
}


def balances(before: Leftover | LackOfFit, after: Leftover | LackOfFit) -> tuple[Balance, ...]:
    """Return how badly each balance fails: the best curve at each place, over what chance allows; 1 is that."""
    found = []
    for place, (location, channel) in _PLACES.items():
        first = [gain for p, _, gain in before.families if p == place]
        second = [gain for p, _, gain in after.families if p == place]
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


def trends(channels: Sequence[str], before: Leftover | LackOfFit, after: Leftover | LackOfFit) -> tuple[Trend, ...]:
    """Return over what the residual varies, before and after: each family's gain over what chance allows."""
    later = {(place, variable): gain for place, variable, gain in after.families}
    return tuple(
        Trend(place, variable, gain / before.threshold, later.get((place, variable), 0.0) / after.threshold)
        for place, variable, gain in before.families[: 2 * len(channels) + 4]
    )


def audit_findings(found: Findings) -> tuple[AuditFinding, ...]:
    """Return the audit as the result has it, notes of the preparation behind it, and a burst that no noise makes."""
    findings = [f.told() for f in found.findings]
    notes = [AuditFinding("preparation", "note", "", "", note) for note in found.notes]
    burst = burst_beside(found.choice)
    bursts = [_burst_finding(found.records[burst.run], burst)] if burst is not None and burst.stands_out else []
    return (*findings, *notes, *bursts)


def burst_beside(choice: Choice) -> Burst | None:
    """Return the strongest burst of what a chosen model leaves in the fitted runs."""
    model = choice.model
    return burst_of(model.problem.layout, choice.whitener.apply(model.fit.residual))


def _burst_finding(record: Record, burst: Burst) -> AuditFinding:
    first, last = record.time_s[burst.first], record.time_s[burst.first + ROWS - 1]
    text = (
        f"from {first:.2f} to {last:.2f} s what the model leaves of the jaw's angle has {burst.times:.0f} times "
        "the power of the run's noise: a blow, friction that broke loose, or what no entry explains"
    )
    return AuditFinding("burst", "warning", record.name, JAW, text)


__all__ = [
    "SET_DROP",
    "Judgement",
    "audit_findings",
    "balances",
    "burst_beside",
    "detectable",
    "judge",
    "least_detectable",
    "named_effects",
    "trends",
    "varies_over",
]
