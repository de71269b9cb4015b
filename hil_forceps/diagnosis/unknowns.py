"""What is fitted: known parameters with what is known of them, parameters of effects, and nuisances of each run.

The optimiser sees a vector u of pure numbers: value = centre + scale · u, prior u ~ N(0, 1) where there is a prior.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.inference.parameters import unit_of
from hil_forceps.model import parameters
from hil_forceps.rig import Parameter, Rig
from hil_forceps.rig.catalogue import EffectParameter, effect
from hil_forceps.rig.errors import UserError

Vector = NDArray[np.float64]

FRICTION_SD_OF_TORQUE = 0.3  # a friction's prior is no tighter at first than this share of the torque seen
WIDEST = 20.0  # a known value, friction apart, is not further off than this factor
# No channel holds a length: both radii times s and the stiffness over s² give the same data. One radius is held.
GAUGE = "forceps.motor_pulley_radius_m"
# Without the jaw's angle no channel holds that either: this radius and the jaw's inertia times s, with the stiffness,
# K_t and all of the motor's over s, give the same data. Left open, differences over which friction sticks elsewhere
# passed for evidence of s: it ended 11 % off, where 0.4 % were said and 4 % had been known.
GAUGE_WITHOUT_JAW = "forceps.jaw_pulley_radius_m"
STEP = 1e-3  # of the scale: finite differences


class Unknown(NamedTuple):
    """A number that is fitted."""

    name: str  # dotted, as in `model.parameters.NAMES`
    unit: str
    centre: float
    scale: float
    low: float
    high: float
    prior: bool  # whether u ~ N(0, 1) is known of it
    assumed: float | None  # as the rig has it
    precision: float = 1.0  # of the prior: weight of u²
    told: float = 1.0  # what the precision is when the rig is taken at its word


class Unknowns(NamedTuple):
    """All numbers that are fitted, in their order."""

    items: tuple[Unknown, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Dotted names, in order."""
        return tuple(item.name for item in self.items)

    @property
    def known(self) -> int:
        """How many are parameters of the rig, which come first, and not of an effect."""
        return sum(not item.name.startswith("effects.") for item in self.items)

    def values(self, u: Vector) -> Vector:
        """Return the physical values of a vector; never beyond a bound, whatever rounding makes of it."""
        return np.array(
            [
                min(max(item.centre + item.scale * float(x), item.low), item.high)
                for item, x in zip(self.items, u, strict=True)
            ]
        )

    def bounds(self) -> tuple[Vector, Vector]:
        """Return the least and the greatest u."""
        low = np.array([(item.low - item.centre) / item.scale for item in self.items])
        high = np.array([(item.high - item.centre) / item.scale for item in self.items])
        return low, high

    def prior_weights(self) -> Vector:
        """Return the precision where u has a prior, 0 elsewhere."""
        return np.array([item.precision if item.prior else 0.0 for item in self.items])

    def with_effect(self, effect_id: str, start: Mapping[str, float], free: Mapping[str, float]) -> "Unknowns":
        """Return these with parameters of an effect added, centred on `start`; `free`: which, and the least of each."""
        entry = effect(effect_id)
        added = [_effect_unknown(effect_id, p, start[p.name], free[p.name]) for p in entry.parameters if p.name in free]
        return Unknowns((*self.items, *added))


def _effect_unknown(effect_id: str, p: EffectParameter, start: float, low: float) -> Unknown:
    scale = abs(p.typical) if p.neutral is not None else 0.3 * max(abs(start), abs(p.minimum))
    return Unknown(f"effects.{effect_id}.{p.name}", p.unit, start, scale, low, p.maximum, False, p.neutral)


def known_parameters(rig: Rig, torque_scale_N_m: float, *, jaw_measured: bool = True) -> Unknowns:
    """Return the rig's physical parameters with their priors; `torque_scale_N_m`: what the motor gives in the data.

    Lengths that no channel holds are taken as the rig has them, where it says them.
    """
    held = (GAUGE,) if jaw_measured else (GAUGE, GAUGE_WITHOUT_JAW)
    items = []
    for name in parameters.PLANT_NAMES:
        section, key = name.split(".")
        known: Parameter = getattr(getattr(rig, section), key)
        unit = unit_of(key)
        if name in held and known.value is not None:
            continue
        items.append(_plant_unknown(name, unit, known, torque_scale_N_m))
    return Unknowns(tuple(item for item in items if item.scale > 0.0))


def _plant_unknown(name: str, unit: str, known: Parameter, torque_scale_N_m: float) -> Unknown:
    friction = "coulomb" in name
    low, high = 0.0, math.inf
    if known.minimum is not None and known.maximum is not None:
        low, high = known.minimum, known.maximum
    value = known.value
    if value is None:
        if not (low > 0.0 and high < math.inf):
            raise UserError(f"{name}: is unknown and has no bounds; give {{min, max}} for the diagnosis to search in")
        value = math.sqrt(low * high)
        scale = 0.5 * value
        return Unknown(name, unit, value, scale, low, high, False, None)
    sd = known.sd if known.sd is not None else 0.0
    told = 1.0
    if friction:
        wide = max(sd, FRICTION_SD_OF_TORQUE * torque_scale_N_m)
        sd, told = wide, (wide / sd) ** 2 if sd > 0.0 else 1.0
    elif known.minimum is None:
        low, high = value / WIDEST, value * WIDEST
    if known.minimum is not None and known.sd is None:
        return Unknown(name, unit, value, 0.1 * abs(value) or (high - low) / 10.0, low, high, False, value)
    return Unknown(name, unit, value, sd, low, high, True, value, told=told)


def run_nuisances(count: int, angle_sd_rad: float, integral_sd: float) -> Unknowns:
    """Return the zero of the jaw sensor and the drive's integral at the start, for each of `count` runs."""
    items: list[Unknown] = []
    for i in range(count):
        items.append(Unknown(f"run{i}.theta_j_zero_rad", "rad", 0.0, angle_sd_rad, -math.inf, math.inf, True, 0.0))
        items.append(Unknown(f"run{i}.integral_rad_s", "rad_s", 0.0, integral_sd, -math.inf, math.inf, True, 0.0))
    return Unknowns(tuple(items))


def join(parts: Sequence[Unknowns]) -> Unknowns:
    """Return all unknowns of the parts, in order."""
    return Unknowns(tuple(item for part in parts for item in part.items))
