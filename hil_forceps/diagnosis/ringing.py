"""Where the jaw's inertia is by how the wire rings: no linear step finds it over more than a resonance's width.

The jaw rings on the wire for tens of periods after every corner. A frequency one percent off is soon out of step, and
more of it fits no worse: χ² over the jaw's inertia has many valleys, and a fit may end in any of them. Nor do the
sensitivities know of ringing that only what is quick in the load excites, for they come from a calm load. So the
simulation itself is looked at over all that is thinkable, and the deepest valley is where the inertia is taken to be.

Where the load jumps, its instants set the phase of the ringing. Fitted beside a wrong inertia they suit that one: in
trapezoids held out χ² was least 3 % off with the instants as they were, and 4900 less, at 0.4 %, with instants of its
own beside each inertia.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.fit import chi2_of, fit_own
from hil_forceps.diagnosis.predict import ClosedLoop
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.spectrum import JAW, Whitener, transform
from hil_forceps.diagnosis.unknowns import Unknown, Unknowns

Vector = NDArray[np.float64]

INERTIA = "forceps.jaw_inertia_kg_m2"
MOTOR_INERTIA = "forceps.motor_inertia_kg_m2"
AT_WORD = (INERTIA, MOTOR_INERTIA, "forceps.motor_coulomb_N_m")
REACH = 0.35  # of the logarithm, to both sides of what the rig says
STEP = 0.005
TELLING = 25.0  # of χ²: how deep a valley is below the middle of what was looked at
SURE = 0.005  # of the value: no valley is known any better
# Of χ²: what is no further above the deepest may be it. The load's noise excites the simulated wire, too, and where
# little else does, the truth was seen 11 to 42 above.
DOUBT = 50.0
# Prior deviations: a model that pulls it further has another valley than the one before. Without an electrical lag of
# 0.2 ms the deepest valley was 11 % off; held to it, the right model left 212 of 7274 explained, and 13 without.
STRAINED = 3.0
LOOSE = 0.05  # of the value: how sure what a model with effects shows is beside another one
STRIDE = 0.02  # of the value
MOST_STRIDES = 10
OWN_STEPS = 3


class Valley(NamedTuple):
    """Where the jaw's inertia is, and how sure."""

    place: int  # of the inertia among the shared unknowns
    inertia_kg_m2: float
    deviation_kg_m2: float


class _Point(NamedTuple):
    inertia_kg_m2: float
    chi2: float
    u: Vector


def in_deepest_valley(problem: Problem, u: Vector, whitener: Whitener) -> tuple[Problem, Vector]:
    """Return the problem with the jaw's inertia known to be in the deepest valley of χ², and u with it there.

    Both as they are where there is none.
    """
    valley = deepest_valley(problem, u, whitener)
    if valley is None:
        return problem, u
    found = _known(problem, valley)
    return found, moved_to(found, u, valley.place, valley.inertia_kg_m2)


def out_of_a_wrong_valley(problem: Problem, u: Vector, whitener: Whitener) -> tuple[Problem, Vector]:
    """Return the same with the jaw's inertia sought anew where it is pulled from the valley that it is held to.

    Both as they are where it isn't.
    """
    if INERTIA not in problem.shared.names:
        return problem, u
    place = problem.shared.names.index(INERTIA)
    if not _strained(problem, u, place):
        return problem, u
    valley = deepest_valley(problem, u, whitener)
    if valley is None:
        return problem, u
    u = beside_own_unknowns(problem, moved_to(problem, u, place, valley.inertia_kg_m2), place, whitener)
    value = float(problem.shared.values(u[: len(problem.shared.items)])[place])
    found = _known(problem, Valley(place, value, LOOSE * value))
    return found, moved_to(found, u, place, value)


def at_the_rig_s_word(problem: Problem, u: Vector) -> tuple[Problem, Vector] | None:
    """Return the same with inertias and the motor's friction as the rig has them; None where its inertia is near that.

    Slow motion shows only the sum of both inertias. A valley that something else had bent held the jaw's 15 % too high,
    and the motor's ended at a third of its value.
    """
    names = problem.shared.names
    if INERTIA not in names or MOTOR_INERTIA not in names:
        return None
    motor, jaw = names.index(MOTOR_INERTIA), names.index(INERTIA)
    item = problem.shared.items[jaw]
    if not _strained(problem, u, motor) or item.assumed is None or item.centre == item.assumed:
        return None
    back = _with_item(problem, jaw, item._replace(centre=item.assumed, precision=item.told))
    for place, other in enumerate(back.shared.items):
        if other.name in AT_WORD and other.assumed is not None:
            u = moved_to(back, u, place, other.assumed)
    return back, u


def _strained(problem: Problem, u: Vector, place: int) -> bool:
    """Tell whether a model pulls one of the shared unknowns far from what is known of it."""
    return bool(problem.shared.prior_weights()[place] * u[place] ** 2 >= STRAINED**2)


def in_valley_of(other: Problem, v: Vector, problem: Problem, u: Vector) -> tuple[Problem, Vector]:
    """Return the same in the valley of another problem at v, with each run's own unknowns as they are there.

    Both as they are where neither has another valley.
    """
    if INERTIA not in problem.shared.names:
        return problem, u
    place = problem.shared.names.index(INERTIA)
    item = other.shared.items[place]
    if item == problem.shared.items[place]:
        return problem, u
    own = v[len(other.shared.items) :]
    there = np.concatenate((u[:place], v[place : place + 1], u[place + 1 : -own.size], own))
    return _with_item(problem, place, item), there


def _known(problem: Problem, valley: Valley) -> Problem:
    """Return the problem with the jaw's inertia known to be in a valley."""
    place, value, deviation = valley
    item = problem.shared.items[place]
    return _with_item(problem, place, item._replace(centre=value, precision=(item.scale / deviation) ** 2, prior=True))


def _with_item(problem: Problem, place: int, item: Unknown) -> Problem:
    """Return the problem with another item for one of the shared unknowns."""
    items = problem.shared.items
    return problem.with_shared(Unknowns((*items[:place], item, *items[place + 1 :])))


def deepest_valley(problem: Problem, u: Vector, whitener: Whitener) -> Valley | None:
    """Return where χ² is least over the jaw's inertia, all else as in u.

    None where no valley is deep, the loop isn't closed, or the jaw isn't measured.
    """
    loop = problem.simulate_runs
    names = list(problem.shared.names)
    if not isinstance(loop, ClosedLoop) or INERTIA not in names:
        return None
    if any(JAW not in record.channels for record in problem.records):  # at the motor alone, a damped ring is another's
        return None
    place = names.index(INERTIA)
    item = problem.shared.items[place]
    plain = loop.as_shaken()

    def chi2(value: float) -> float:
        there = moved_to(problem, u, place, value)
        outputs = plain(problem.theta(there), problem.nuisances(there))
        return chi2_of(problem, problem.measured - transform(problem.layout, outputs), whitener, there)

    values = item.centre * np.exp(np.arange(-REACH, REACH + STEP, STEP))
    values = values[(values >= item.low) & (values <= item.high)]
    found = np.full(values.size, np.inf)
    found[::2] = list(problem.mapper(chi2, values[::2]))
    middle = float(np.median(found[::2]))
    between = np.flatnonzero(_beside(found < 0.5 * (found.min() + middle)) & np.isinf(found))
    found[between] = list(problem.mapper(chi2, values[between]))
    best = int(np.argmin(found))
    if middle - found[best] < TELLING or best in (0, values.size - 1):
        return None
    value = float(values[best])
    possible = values[found < found[best] + DOUBT]
    return Valley(place, value, max(SURE * value, 0.5 * float(np.ptp(possible))))


def beside_own_unknowns(problem: Problem, u: Vector, place: int, whitener: Whitener) -> Vector:
    """Return u with the jaw's inertia where χ² is least with each run's own unknowns fitted beside it.

    Downhill from where it is; `place`: of the inertia among the shared unknowns.
    """
    count = len(problem.shared.items)
    item = problem.shared.items[place]

    def at(value: float, near: Vector) -> _Point:
        value = min(max(value, item.low), item.high)
        there = moved_to(problem, near, place, value)
        own = fit_own(problem, there, whitener, OWN_STEPS)
        return _Point(value, own.chi2, np.concatenate((there[:count], own.u)))

    here = at(float(problem.shared.values(u[:count])[place]), u)
    less, more = (at(here.inertia_kg_m2 * factor, here.u) for factor in (1.0 - STRIDE, 1.0 + STRIDE))
    three, factor = ((less, here, more), 1.0 + STRIDE) if more.chi2 < less.chi2 else ((more, here, less), 1.0 - STRIDE)
    for _ in range(MOST_STRIDES):
        if three[2].chi2 >= three[1].chi2:
            break
        three = (three[1], three[2], at(three[2].inertia_kg_m2 * factor, three[2].u))
    middle = three[1].inertia_kg_m2
    aside = vertex([point.inertia_kg_m2 / middle - 1.0 for point in three], [point.chi2 for point in three])
    return min((*three, at(middle * (1.0 + aside), three[1].u)), key=lambda point: point.chi2).u


def vertex(x: Sequence[float], values: Sequence[float]) -> float:
    """Return where the parabola through three points is least; the middle one where that isn't between them."""
    square, slope, _ = np.polyfit(x, values, 2)
    least = -0.5 * slope / square if square > 0.0 else math.inf
    return float(least) if min(x) < least < max(x) else x[1]


def _beside(deep: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the neighbours of some places."""
    found = np.zeros_like(deep)
    found[1:] |= deep[:-1]
    found[:-1] |= deep[1:]
    return found


def moved_to(problem: Problem, u: Vector, place: int, value: float) -> Vector:
    """Return u with one of the shared unknowns at a value."""
    item = problem.shared.items[place]
    return np.concatenate((u[:place], [(value - item.centre) / item.scale], u[place + 1 :]))
