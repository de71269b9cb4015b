"""Where to look for each entry of the catalogue, from the course of the filtered state."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.evidence import Direction, Passes, Wave
from hil_forceps.diagnosis.hypotheses.entries import HARMONIC, Probe, Scene, probes, quantiles_of_speed
from hil_forceps.diagnosis.inference.parameters import start_of, with_effect
from hil_forceps.model.composition import Physics
from hil_forceps.rig.catalogue import EFFECT_IDS, EFFECTS, effect

Vector = NDArray[np.float64]

# Of an amplitude that would show: over a row it must turn no mass round, which dry friction isn't linear in. Columns
# over a tenth of it are the same to 0.1 %; over a hundred times as much they are 1 to 40 % off (decision 0031).
AMPLITUDE_SHARE = 1e-4
ORIGIN_SHARE = 1e-10  # of such an amplitude, in place of none
ONE_SIDED_AMPLITUDE_SHARE = (
    0.05  # of friction that can't be negative, beside next to none  # tuned: by its catalogue size
)
HARMONICS = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0, 14.0, 16.0, 18.0, 21.0, 24.0)
# Torques that recur with the motor's angle, and whether they come with the current: half of all columns.
WAVES = {entry.id: entry.recurs_with == "angle and current" for entry in EFFECTS if entry.recurs_with is not None}


class Place(NamedTuple):
    """An entry of the catalogue with a shape, and its columns among all directions."""

    effect_id: str
    shape: dict[str, float]
    amplitudes: dict[str, float]  # what each column is in units of
    first: int
    stop: int
    one_sided: bool
    looks: int = 1  # of how many it was chosen as one of the best: chance gives the best of many more

    @property
    def cost(self) -> float:
        """What its gain is lessened by for that (Bonferroni, in χ²)."""
        return 2.0 * math.log(self.looks)


class Harmonics(NamedTuple):
    """Harmonics that are looked at, and of how many each was chosen."""

    cogging: tuple[float, ...]
    ripple: tuple[float, ...]
    looks: int


def usual_harmonics(p: Physics) -> tuple[float, ...]:
    """Return the harmonics of the motor's angle that are tested: whole ones, and one turn of the jaw."""
    return (*HARMONICS, p.r_m / p.r_j)


def scene_of(passes: Passes, harmonics: Harmonics | None = None) -> Scene:
    """Return what the runs contain; `harmonics`: of cogging and of ripple, the usual ones where they are whole."""
    p = passes.plant
    courses = [run.course(passes.plant, before=False) for run in passes.runs]
    jaw = np.concatenate([c.theta_j for c in courses])
    reach = tuple(float(v) for v in (jaw.min(), jaw.max()) if abs(v) > 0.02 * np.ptp(jaw))
    usual = usual_harmonics(p)
    return Scene(
        max(float(c.time_s[-1]) + c.period_s for c in courses),
        max(float(np.ptp(c.theta_m)) for c in courses),
        reach,
        quantiles_of_speed(np.concatenate([c.omega_m for c in courses])),
        max(float(np.ptp(c.stretch_m)) for c in courses),
        max(float(np.abs(c.current_A).max()) for c in courses),
        harmonics.cogging if harmonics else usual,
        harmonics.ripple if harmonics else usual,
    )


def places_of(
    passes: Passes, without: frozenset[str], harmonics: Harmonics | None = None
) -> tuple[list[Place], list[Direction], list[Wave]]:
    """Return the places to look at beside the pass's model, and what their columns are: directions, then waves."""
    found = probes(scene_of(passes, harmonics), without)
    directions: list[Direction] = []
    waves: list[Wave] = []
    columns: list[tuple[Probe, int, int]] = []
    for probe in found:
        if probe.effect_id not in WAVES:
            new = _directions(passes.theta, probe)
            columns.append((probe, len(directions), len(directions) + len(new)))
            directions += new
    for probe in found:
        if probe.effect_id in WAVES:
            at = len(directions) + len(waves)
            waves += waves_of(probe)
            columns.append((probe, at, at + 2))
    columns.sort(key=lambda column: EFFECT_IDS.index(column[0].effect_id))
    looks = harmonics.looks if harmonics else 1
    return [place_of(*column, looks) for column in columns], directions, waves


def place_of(probe: Probe, first: int, stop: int, looks: int) -> Place:
    """Return a probe with its columns."""
    shape = {k: v for k, v in probe.start.items() if k not in probe.amplitudes}
    amplitudes = {k: probe.start[k] for k in probe.amplitudes}
    looks = looks if probe.effect_id in WAVES else 1
    return Place(probe.effect_id, shape, amplitudes, first, stop, probe.one_sided, looks)


def waves_of(probe: Probe) -> list[Wave]:
    """Return the columns of a torque that recurs with the motor's angle."""
    with_current = WAVES[probe.effect_id]
    return [
        Wave(probe.start[HARMONIC], name.startswith("cosine"), with_current, probe.start[name])
        for name in probe.amplitudes
    ]


def _directions(theta: Vector, probe: Probe) -> list[Direction]:
    if not probe.amplitudes:
        return [Direction(with_effect(theta, probe.effect_id, start_of(probe.effect_id, probe.start)), 1.0)]
    share = ONE_SIDED_AMPLITUDE_SHARE if probe.effect_id == "jaw_position_friction" else AMPLITUDE_SHARE
    found = []
    for names in [tuple(probe.amplitudes)] if probe.together else [(name,) for name in probe.amplitudes]:
        there, origin = (_scaled(theta, probe, names, factor) for factor in (share, ORIGIN_SHARE))
        found.append(Direction(there, 1.0 / share, origin))
    return found


def _scaled(theta: Vector, probe: Probe, names: Sequence[str], factor: float) -> Vector:
    """Return parameters with `factor` times some amplitudes of a probe, and without its others."""
    shape = {k: v for k, v in probe.start.items() if k not in probe.amplitudes}
    start = start_of(probe.effect_id, shape | {k: factor * probe.start[k] for k in names})
    return with_effect(theta, probe.effect_id, start)


def between(theta: Vector, place: Place, factor: float, first: int) -> tuple[Place, list[Direction]] | None:
    """Return a place whose shape is `factor` times another's, and its columns; None where it has none, or can't.

    `first`: the place of its columns among all. A harmonic stays what it is.
    """
    entry = effect(place.effect_id)
    shapes = {p.name: p for p in entry.parameters if p.neutral is None and p.name != HARMONIC}
    if not shapes or not place.amplitudes:
        return None
    shape = {k: v * factor if k in shapes else v for k, v in place.shape.items()}
    if not all(p.minimum <= shape[name] <= p.maximum for name, p in shapes.items()):
        return None
    probe = Probe(place.effect_id, {**shape, **place.amplitudes}, tuple(place.amplitudes), place.one_sided)
    columns = _directions(theta, probe)
    return place._replace(shape=shape, first=first, stop=first + len(columns)), columns


def estimate(place: Place, sizes: Sequence[float]) -> dict[str, float]:
    """Return an entry's parameters where its columns have these sizes."""
    names = list(place.amplitudes)
    if not names:
        return dict(place.shape)
    scaled = sizes if len(sizes) == len(names) else [sizes[0]] * len(names)
    return {**place.shape, **{n: place.amplitudes[n] * float(s) for n, s in zip(names, scaled, strict=True)}}
