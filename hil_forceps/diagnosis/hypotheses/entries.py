"""Where to look for each entry of the catalogue: starting points that cover its shapes, from what the runs contain.

An entry's effect is nearly linear in its amplitudes (parameters that have a neutral value) once its shape is fixed, so
a handful of shapes and the linear sensitivity to the amplitudes at each of them find it.
"""

import itertools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hil_forceps.effects.entry import Effect, Parameter, RunExtent
from hil_forceps.rig.catalogue import EFFECTS

STRIBECK_QUANTILES = (0.03, 0.1, 0.3, 0.7)  # of the speed while moving
REST_SHARE = 0.02  # of the usual speed: what is slower is at rest
HUMPS = (0.45, 0.15, 0.05)  # of how far the jaw goes to either side, the narrowest last
NARROW_RAD, NARROWER = 0.1, 5.0  # where the jaw turns round and round, humps of this, each so many times narrower
HARMONIC = "harmonic"


class Scene(NamedTuple):
    """What the runs contain, as far as shapes and sizes depend on it."""

    duration_s: float
    angle_range_rad: float
    jaw_reach_rad: tuple[float, ...]  # how far the jaw goes to either side of 0, with its sign
    speeds_rad_per_s: tuple[float, ...]  # at `STRIBECK_QUANTILES` of |ω_m| while moving
    stretch_range_m: float
    current_max_A: float
    harmonics_cogging: tuple[float, ...]
    harmonics_ripple: tuple[float, ...]

    @property
    def jaw_range_rad(self) -> float:
        """How far the jaw goes to either side together."""
        return float(np.ptp(self.jaw_reach_rad))


class Probe(NamedTuple):
    """One place to look: values of an effect's parameters, and which of them are amplitudes to be fitted."""

    effect_id: str
    start: dict[str, float]  # all parameters; amplitudes at the size for finite differences
    amplitudes: tuple[str, ...]
    one_sided: bool  # the (single) amplitude can't be negative
    together: bool = False  # all amplitudes grow by one factor, as one


def probes(scene: Scene, without: frozenset[str] = frozenset()) -> list[Probe]:
    """Return the places to look for every entry, those in `without` left out."""
    found: list[Probe] = []
    for entry in EFFECTS:
        if entry.id in without:
            continue
        for shape in _shapes(entry, scene):
            found += _with_shape(entry, shape, scene)
    return found


def _with_shape(entry: Effect, shape: Mapping[str, float], scene: Scene) -> list[Probe]:
    sizes = {p.name: _size(p, scene) for p in entry.parameters if p.neutral is not None}
    one_sided = {p.name: p.minimum >= 0.0 for p in entry.parameters}
    if entry.one_by_one:
        off = {**shape, **dict.fromkeys(sizes, 0.0)}
        return [Probe(entry.id, {**off, name: size}, (name,), one_sided[name]) for name, size in sizes.items()]
    if entry.id == "jaw_position_friction":
        return _friction_over_angle(entry.id, sizes["slope_N_m_per_rad"], scene)
    # Without an amplitude, the shape itself is what is looked for.
    alone = not sizes or (len(sizes) == 1 and one_sided[next(iter(sizes))])
    return [Probe(entry.id, {**shape, **sizes}, tuple(sizes), alone)]


def _friction_over_angle(effect_id: str, size: float, scene: Scene) -> list[Probe]:
    """Return friction that rises to either side, and friction that rises and falls again: friction is never negative.

    A jaw that has next to none of it elsewhere shows what rises on one side there only, whatever it is on the other.
    """
    names = ("slope_N_m_per_rad", "curvature_N_m_per_rad2")
    sides = [(size, size), (-size, size)]
    humps = [
        (math.copysign(size, reach), -size / width)
        for reach in scene.jaw_reach_rad
        for width in _hump_widths(abs(reach))
    ]
    return [
        *(Probe(effect_id, dict(zip(names, side, strict=True)), names, False) for side in sides),
        *(Probe(effect_id, dict(zip(names, hump, strict=True)), names, True, True) for hump in humps),
    ]


def _hump_widths(reach_rad: float) -> list[float]:
    widths = [share * reach_rad for share in HUMPS]
    while widths[-1] > NARROW_RAD:
        widths.append(widths[-1] / NARROWER)
    return widths


def _size(parameter: Parameter, scene: Scene) -> float:
    size = parameter.size
    if size is None:
        return parameter.typical
    extent = _extents(scene, size.of)[0]
    value = size.share * extent if size.power == 1 else size.share / max(extent, 1e-9) ** -size.power
    return min(parameter.typical, value) if size.at_most_typical else value


def _shapes(entry: Effect, scene: Scene) -> list[dict[str, float]]:
    """Return values of the parameters that are no amplitudes, one mapping per place to look."""
    grids = [(p.name, p.search_grid) for p in entry.parameters if p.search_grid is not None]
    places = [
        [(name, share * extent) for share in grid.shares for extent in _extents(scene, grid.of)] for name, grid in grids
    ]
    return [dict(place) for place in itertools.product(*places)]


def _extents(scene: Scene, of: RunExtent) -> tuple[float, ...]:
    """Return what the runs contain of something: one number, or some."""
    if of == "":
        return (1.0,)
    extent: float | tuple[float, ...] = getattr(scene, of)
    return extent if isinstance(extent, tuple) else (extent,)


def quantiles_of_speed(omega: np.ndarray[tuple[int], np.dtype[np.float64]]) -> tuple[float, ...]:
    """Return the speeds at which friction that falls with speed is looked for.

    What is slower than `REST_SHARE` of the usual speed is at rest. The usual speed is the median over the way, not over
    time: rests add nothing to the way, and a jump of the load, which makes a mass fast for some rows, next to nothing.
    """
    speed = np.sort(np.abs(omega))
    way = np.cumsum(speed)
    if not way.size or way[-1] <= 0.0:
        return (0.1,)
    usual = speed[np.searchsorted(way, 0.5 * way[-1])]
    moving = speed[speed > REST_SHARE * usual]
    return tuple(float(np.clip(q, 1e-3, 1e3)) for q in np.quantile(moving, STRIBECK_QUANTILES))
