"""What each place of the catalogue does to the channels: columns of finite differences, each at a telling size.

Friction, dead zones and limits aren't in proportion to their amplitude: at a hundred times the size that the data
could just show, falling friction makes the motor stick, and its column says nothing about the smaller effect. So such
entries are first simulated in one run, to find the amplitudes at which they would just stand out.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.entries import Probe
from hil_forceps.diagnosis.predict import CURRENT_PATH
from hil_forceps.diagnosis.problem import Matrix, Problem, difference
from hil_forceps.diagnosis.robust import left_by
from hil_forceps.diagnosis.score import Group
from hil_forceps.diagnosis.spectrum import Flat, Layout, Whitener, transform, transform_one

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


def probe_columns(
    problem: Problem, u: Vector, places: Sequence[Probe], run: int | None = None
) -> tuple[Matrix, list[Group]]:
    """Simulate every place, coarsely: one column per amplitude, at the probe's size (not divided by it).

    What is in proportion to its amplitude is played without the encoder's shaking and the load's noise. With `run`,
    only that run: the columns are 0 in all others.
    """
    base, nuisances = problem.theta(u), problem.nuisances(u)
    shaken = problem.simulate_runs.coarse()
    if run is not None:
        shaken, nuisances = shaken.only(run), nuisances[run : run + 1]
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

    def column(task: tuple[Vector, bool]) -> Flat:
        theta, how = task
        moved = difference(simulators[how](theta, nuisances), before[how], 1.0)
        return transform(problem.layout, moved) if run is None else transform_one(problem.layout, run, moved[0])

    columns = list(problem.mapper(column, tasks))
    if not columns:
        return np.empty((problem.layout.size, 0), dtype=np.float32), groups
    return np.nan_to_num(np.stack(columns, axis=1)), groups


def sized_columns(
    problem: Problem, u: Vector, places: Sequence[Probe], fitted: Matrix, whitener: Whitener
) -> tuple[list[Probe], Matrix, list[Group]]:
    """Return the places with telling sizes, their columns and groups; `fitted`: whitened columns of the unknowns."""
    sized = list(places)
    bent = [i for i, probe in enumerate(sized) if probe.effect_id in BENT]
    runs = len(problem.records)
    if bent and runs > 1:
        some, own = probe_columns(problem, u, [sized[i] for i in bent], _telling_run(problem.layout, fitted))
        _resize(sized, bent, _factors(some, own, fitted, whitener, share=1.0 / runs))
    columns, groups = probe_columns(problem, u, sized)
    for _ in range(SIZINGS):
        some, own = columns_of(columns, groups, bent)
        factors = _factors(some, own, fitted, whitener)
        _resize(sized, bent, factors)
        bent = [i for i, factor in zip(bent, factors, strict=True) if factor != 1.0]
        if not bent:
            break
        fresh, own = probe_columns(problem, u, [sized[i] for i in bent])
        for i, group in zip(bent, own, strict=True):
            columns[:, groups[i].first : groups[i].stop] = fresh[:, group.first : group.stop]
    return sized, columns, groups


def _telling_run(layout: Layout, fitted: Matrix) -> int:
    """Return the run that says most about what is fitted."""
    said = np.zeros(max(part.run for part in layout.parts) + 1)
    for part in layout.parts:
        here = fitted[part.start : part.stop]
        said[part.run] += float(np.einsum("ij,ij->", here, here, dtype=np.float64))
    return int(np.argmax(said))


def columns_of(columns: Matrix, groups: Sequence[Group], which: Sequence[int]) -> tuple[Matrix, list[Group]]:
    """Return the columns of some places, and where each has its own among them."""
    own = [np.arange(groups[i].first, groups[i].stop) for i in which]
    stops = np.cumsum([0, *(o.size for o in own)])
    found = [Group(int(a), int(b), groups[i].one_sided) for i, a, b in zip(which, stops, stops[1:], strict=False)]
    return np.ascontiguousarray(columns[:, np.concatenate([np.empty(0, dtype=np.intp), *own])]), found


def _factors(
    columns: Matrix, groups: Sequence[Group], fitted: Matrix, whitener: Whitener, share: float = 1.0
) -> list[float]:
    """Return by what the amplitudes of each place are to be multiplied: 1 but for those that tower above what matters.

    `share`: how much of what all runs show is in the columns.
    """
    left = left_by(fitted, whitener.apply(columns))
    norms = np.sqrt(np.einsum("ij,ij->j", left, left, dtype=np.float64) / share)
    largest = [float(norms[group.first : group.stop].max()) for group in groups]
    return [TELLING / norm if norm > LARGEST else 1.0 for norm in largest]


def _resize(places: list[Probe], which: Sequence[int], factors: Sequence[float]) -> None:
    for i, factor in zip(which, factors, strict=True):
        start = {k: v * factor if k in places[i].amplitudes else v for k, v in places[i].start.items()}
        places[i] = places[i]._replace(start=start)


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
