"""What each place of the catalogue does to the channels: columns of finite differences, each at a telling size.

Friction, dead zones and limits aren't in proportion to their amplitude: at a hundred times the size that the data
could just show, falling friction makes the motor stick, and its column says nothing about the smaller effect. So the
places of such entries are simulated again, with amplitudes at which they would just stand out.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.entries import Probe
from hil_forceps.diagnosis.predict import CURRENT_PATH
from hil_forceps.diagnosis.problem import Matrix, Problem, difference
from hil_forceps.diagnosis.robust import left_by
from hil_forceps.diagnosis.score import Group
from hil_forceps.diagnosis.spectrum import Flat, Whitener, transform

Vector = NDArray[np.float64]

BENT = frozenset(
    {
        "stribeck_friction",
        "presliding_friction",
        "loaded_presliding",
        "film_friction",
        "jaw_presliding",
        "transmission_play",
        "load_dependent_friction",
        "coulomb_asymmetry",
        "jaw_position_friction",
        "wire_slack",
        "wire_hysteresis",
        "amplifier_deadband",
    }
)  # whose effect is far from proportional to their amplitude
SHAKEN = BENT | set(CURRENT_PATH)  # what shows otherwise when the motor isn't shaken
TELLING, LARGEST = 12.0, 30.0  # whitened norm of a column; above the second it is made anew, with the first
SIZINGS = 3


def probe_columns(problem: Problem, u: Vector, places: Sequence[Probe]) -> tuple[Matrix, list[Group]]:
    """Simulate every place, coarsely: one column per amplitude, at the probe's size (not divided by it).

    What is in proportion to its amplitude is played without the encoder's shaking and the load's noise.
    """
    base, nuisances = problem.theta(u), problem.nuisances(u)
    shaken = problem.simulate_runs.coarse()
    simulators = {True: shaken, False: shaken.calmed()}
    needed = {probe.effect_id in SHAKEN for probe in places}
    before = {how: simulators[how](base, nuisances) for how in needed}
    tasks: list[tuple[Vector, bool]] = []
    groups = []
    for probe in places:
        first = len(tasks)
        tasks += [
            (_probe_theta(problem, base, probe, moved), probe.effect_id in SHAKEN) for moved in _moved_at_once(probe)
        ]
        groups.append(Group(first, len(tasks), probe.one_sided))

    def run(task: tuple[Vector, bool]) -> Flat:
        theta, how = task
        return transform(problem.layout, difference(simulators[how](theta, nuisances), before[how], 1.0))

    columns = list(problem.mapper(run, tasks))
    if not columns:
        return np.empty((problem.layout.size, 0), dtype=np.float32), groups
    return np.nan_to_num(np.stack(columns, axis=1)), groups


def sized_columns(
    problem: Problem, u: Vector, places: Sequence[Probe], fitted: Matrix, whitener: Whitener
) -> tuple[list[Probe], Matrix, list[Group]]:
    """Return the places with telling sizes, their columns and groups; `fitted`: whitened columns of the unknowns."""
    sized = list(places)
    columns, groups = probe_columns(problem, u, sized)
    bent = [i for i, probe in enumerate(sized) if probe.effect_id in BENT]
    for _ in range(SIZINGS):
        factors = _factors(bent, columns, groups, fitted, whitener)
        bent = list(factors)
        if not bent:
            break
        for i, factor in factors.items():
            start = {k: v * factor if k in sized[i].amplitudes else v for k, v in sized[i].start.items()}
            sized[i] = sized[i]._replace(start=start)
        fresh, own = probe_columns(problem, u, [sized[i] for i in bent])
        for i, group in zip(bent, own, strict=True):
            columns[:, groups[i].first : groups[i].stop] = fresh[:, group.first : group.stop]
    return sized, columns, groups


def _factors(
    which: Sequence[int], columns: Matrix, groups: Sequence[Group], fitted: Matrix, whitener: Whitener
) -> Mapping[int, float]:
    """Return by what the amplitudes of those places are to be multiplied that tower above what matters."""
    if not which:
        return {}
    own = np.concatenate([np.arange(groups[i].first, groups[i].stop) for i in which])
    left = left_by(fitted, whitener.apply(np.ascontiguousarray(columns[:, own])))
    norms = dict(zip(own.tolist(), np.sqrt(np.einsum("ij,ij->j", left, left, dtype=np.float64)), strict=True))
    largest = {i: max(norms[k] for k in range(groups[i].first, groups[i].stop)) for i in which}
    return {i: TELLING / norm for i, norm in largest.items() if norm > LARGEST}


def _moved_at_once(probe: Probe) -> list[tuple[str, ...]]:
    """Return the amplitudes of each column."""
    if probe.together or not probe.amplitudes:
        return [probe.amplitudes]
    return [(name,) for name in probe.amplitudes]


def _probe_theta(problem: Problem, base: Vector, probe: Probe, moved: tuple[str, ...]) -> Vector:
    theta = base.copy()
    for name, value in probe.start.items():
        if name in moved or name not in probe.amplitudes:
            theta[problem.index_of(f"effects.{probe.effect_id}.{name}")] = value
    return theta
