"""Where to look for each entry of the catalogue: starting points that cover its shapes, from what the runs contain.

An entry's effect is nearly linear in its amplitudes (parameters that have a neutral value) once its shape is fixed, so
a handful of shapes and the linear sensitivity to the amplitudes at each of them find it.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hil_forceps.rig.catalogue import EFFECTS, Effect

DRIFT_TIMES = (0.15, 0.6, 3.0)  # of the longest run
CREEP_TIMES_S = (0.03, 0.15, 0.7, 3.0)
HYSTERESIS_STRETCHES = (0.03, 0.15, 0.6)  # of the stretch's range
PRESLIDING_ANGLES = (0.003, 0.02, 0.1)  # of the angle's range
PLAY_SHARE = 0.01  # of the angle's range
STRIBECK_QUANTILES = (0.03, 0.1, 0.3, 0.7)  # of the speed while moving
HUMPS = (0.45, 0.15, 0.05)  # of how far the jaw goes to either side, the narrowest last
NARROW_RAD, NARROWER = 0.1, 5.0  # where the jaw turns round and round, humps of this, each so many times narrower
HARMONIC = "harmonic"
LIMIT_SHARES = (0.9985, 0.995, 0.98, 0.85, 0.6)  # of the largest current


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
    if entry.id == "current_saturation":
        # Its parameter is no amplitude: the limit is lowered a little below what the runs reach.
        limits = [share * scene.current_max_A for share in LIMIT_SHARES]
        return [Probe(entry.id, {"limit_A": limit}, (), True) for limit in limits]
    sizes = {p.name: _size(entry, p.typical, scene) for p in entry.parameters if p.neutral is not None}
    if entry.id == "channel_skew":  # each channel is a place of its own
        return [Probe(entry.id, {**dict.fromkeys(sizes, 0.0), name: sizes[name]}, (name,), False) for name in sizes]
    if entry.id == "jaw_presliding":  # neither of its amplitudes can be negative
        return [Probe(entry.id, {**shape, **dict.fromkeys(sizes, 0.0), n: sizes[n]}, (n,), True) for n in sizes]
    if entry.id == "jaw_position_friction":
        return _friction_over_angle(entry.id, sizes["slope_N_m_per_rad"], scene)
    first = next(p for p in entry.parameters if p.neutral is not None)
    return [Probe(entry.id, {**shape, **sizes}, tuple(sizes), len(sizes) == 1 and first.minimum >= 0.0)]


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


def _size(entry: Effect, typical: float, scene: Scene) -> float:
    if entry.id == "wire_slack":
        return 0.02 * scene.stretch_range_m
    if entry.id == "transmission_play":
        return min(typical, PLAY_SHARE * scene.angle_range_rad)
    if entry.id == "wire_hardening":
        return 0.05 / max(scene.stretch_range_m, 1e-9) ** 2
    if entry.id == "amplifier_deadband":
        return 0.01 * scene.current_max_A
    return typical


def _shapes(entry: Effect, scene: Scene) -> list[dict[str, float]]:
    """Return values of the parameters that are no amplitudes, one mapping per place to look."""
    looked_at: dict[str, tuple[str, Sequence[float]]] = {
        "stribeck_friction": ("speed_rad_per_s", scene.speeds_rad_per_s),
        "film_friction": ("speed_rad_per_s", scene.speeds_rad_per_s),
        "presliding_friction": ("angle_rad", [share * scene.angle_range_rad for share in PRESLIDING_ANGLES]),
        "loaded_presliding": ("angle_rad", [share * scene.angle_range_rad for share in PRESLIDING_ANGLES]),
        "jaw_presliding": ("angle_rad", [share * float(np.ptp(scene.jaw_reach_rad)) for share in PRESLIDING_ANGLES]),
        "viscous_drift": ("time_constant_s", [share * scene.duration_s for share in DRIFT_TIMES]),
        "torque_constant_drift": ("time_constant_s", [share * scene.duration_s for share in DRIFT_TIMES]),
        "wire_hysteresis": ("stretch_m", [share * scene.stretch_range_m for share in HYSTERESIS_STRETCHES]),
        "wire_creep": ("time_constant_s", CREEP_TIMES_S),
        "cogging": (HARMONIC, scene.harmonics_cogging),
        "torque_ripple": (HARMONIC, scene.harmonics_ripple),
    }
    if entry.id not in looked_at:
        return [{}]
    name, values = looked_at[entry.id]
    return [{name: value} for value in values]


def quantiles_of_speed(omega: np.ndarray[tuple[int], np.dtype[np.float64]]) -> tuple[float, ...]:
    """Return the speeds at which friction that falls with speed is looked for."""
    speed = np.abs(omega)
    moving = speed[speed > 0.02 * float(speed.max(initial=0.0))]
    if moving.size == 0:
        return (0.1,)
    return tuple(float(np.clip(q, 1e-3, 1e3)) for q in np.quantile(moving, STRIBECK_QUANTILES))
