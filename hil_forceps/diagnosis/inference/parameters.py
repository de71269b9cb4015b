"""What is fitted: the rig's known parameters with their priors, and parameters of effects within their ranges."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import effect
from hil_forceps.rig.quantities import Parameter

Vector = NDArray[np.float64]

FRICTION_PRIOR_RATIO = 3.0  # times the rig's value: data sheets are wrong by such factors
NO_FRICTION_SHARE = 1e-4  # of the motor's torque: deviation of dry friction that the rig gives as none
# Of the deviation: the least dry friction in a fit. A plant without any is stepped by other rules (`advance.steps_of`),
# and what lies between the two is no response to friction: over a step of 1e-5 it looked like a thousand times as much.
LEAST_FRICTION_SHARE = 1e-5
MAX_RATIO = 10.0  # times what the rig says, either way
# No channel holds a length: both radii times s and the stiffness over s² give the same data. One radius is held;
# without the jaw's angle the other, too.
GAUGE = ("forceps.motor_pulley_radius_m",)
GAUGE_WITHOUT_JAW = ("forceps.jaw_pulley_radius_m",)
# Nor does any channel hold a torque where no load and no torque was measured: all of them times s give the same data.
# And nothing tells dry friction of the jaw from a load.
GAUGE_WITHOUT_TORQUE = ("motor.torque_constant_N_m_per_A", "forceps.jaw_coulomb_N_m")
UNITS = ("N_m_s_per_rad", "N_m_per_A", "N_per_m", "kg_m2", "N_m", "m")  # the first that a key ends in is its own
HELD = frozenset({"channel_skew"})  # of these only what is on is fitted


class Free(NamedTuple):
    """A parameter that is fitted."""

    name: str  # of `model.parameters.NAMES`
    centre: float  # of the prior
    scale: float  # its deviation, or a size for steps where there is none
    low: float
    high: float
    prior: bool
    amplitude: bool  # of an effect: 0 switches it off

    @property
    def place(self) -> int:
        """Place in the vector of parameters."""
        return parameters.index(self.name)

    @property
    def least(self) -> float:
        """The lowest value that is tried."""
        return max(self.low, LEAST_FRICTION_SHARE * self.scale) if "coulomb" in self.name else self.low

    @property
    def unit(self) -> str:
        """Unit of the parameter, as keys of a rig have it; "" for a pure number."""
        if self.name.startswith("effects."):
            _, effect_id, own = self.name.split(".")
            return next(p.unit for p in effect(effect_id).parameters if p.name == own)
        return unit_of(self.name)


def unit_of(key: str) -> str:
    """Return the unit that a rig's key ends in; "" for a pure number."""
    return next((unit for unit in UNITS if key.endswith(f"_{unit}")), "")


def known(rig: Rig, name: str) -> Parameter:
    """Return what a rig says of a parameter of the plant, by its dotted name."""
    section, key = name.split(".")
    found: Parameter = getattr(getattr(rig, section), key)
    return found


def known_parameters(rig: Rig, torque_N_m: float, *, jaw_measured: bool, torque_measured: bool) -> tuple[Free, ...]:
    """Return the rig's parameters with their priors; `torque_N_m`: the largest that the motor gives.

    `torque_measured`: a load cell, or the motor's torque itself, says how large torques are.
    """
    gauge = GAUGE + (() if jaw_measured else GAUGE_WITHOUT_JAW) + (() if torque_measured else GAUGE_WITHOUT_TORQUE)
    found = []
    for name in parameters.PLANT_NAMES:
        told = known(rig, name)
        if name in gauge and told.value is not None:
            continue
        free = _known(name, told, torque_N_m)
        # Beside a torque constant that is held, what the rig says of other torques holds up to a factor only.
        is_length = name in (*GAUGE, *GAUGE_WITHOUT_JAW)
        found.append(free if torque_measured or is_length else free._replace(prior=False))
    return tuple(free for free in found if free.scale > 0.0)


def _known(name: str, known: Parameter, torque_N_m: float) -> Free:
    friction = "coulomb" in name
    low, high = 0.0, math.inf
    if known.minimum is not None and known.maximum is not None:
        low, high = known.minimum, known.maximum
    value = known.value
    if value is None:
        value = math.sqrt(max(low, 1e-12) * min(high, 1e12))
        return Free(name, value, 0.5 * value, low, high, False, False)
    sd = known.sd if known.sd is not None else 0.1 * abs(value)
    if friction:
        sd = max(sd, FRICTION_PRIOR_RATIO * value, NO_FRICTION_SHARE * torque_N_m)
    elif known.minimum is None:
        low, high = value / MAX_RATIO, value * MAX_RATIO
    elif known.sd is None:  # bounds, and nothing said of what is likely between them
        return Free(name, value, sd or 0.1 * (high - low), low, high, False, False)
    return Free(name, value, sd, low, high, True, False)


def effect_parameters(effect_id: str, start: Mapping[str, float]) -> tuple[Free, ...]:
    """Return the parameters of an effect that are fitted from `start` on; a harmonic stays."""
    found = []
    for p in effect(effect_id).parameters:
        value = start[p.name]
        if p.name == "harmonic" or (effect_id in HELD and value == 0.0):
            continue
        scale = max(0.1 * abs(value), 1e-3 * abs(p.typical))
        name = f"effects.{effect_id}.{p.name}"
        found.append(Free(name, value, scale, p.minimum, p.maximum, False, p.neutral is not None))
    return tuple(found)


def start_of(effect_id: str, given: Mapping[str, float]) -> dict[str, float]:
    """Return all parameters of an effect within their ranges: those given, the others as while it is off."""
    values = {}
    for p in effect(effect_id).parameters:
        value = given.get(p.name, p.typical if p.neutral is None else p.neutral)
        values[p.name] = min(max(float(value), p.minimum), p.maximum)
    return values


def with_effect(theta: Vector, effect_id: str, values: Mapping[str, float]) -> Vector:
    """Return a vector with an effect's parameters."""
    changed = theta.copy()
    for name, value in values.items():
        changed[parameters.index(f"effects.{effect_id}.{name}")] = value
    return changed


def without_effect(theta: Vector, effect_id: str) -> Vector:
    """Return a vector with an effect off."""
    changed = theta.copy()
    for p in effect(effect_id).parameters:
        name = f"effects.{effect_id}.{p.name}"
        changed[parameters.index(name)] = parameters.off_value(name)
    return changed


def values_of(theta: Vector, effect_id: str) -> dict[str, float]:
    """Return an effect's parameters in a vector."""
    names = (p.name for p in effect(effect_id).parameters)
    return {name: float(theta[parameters.index(f"effects.{effect_id}.{name}")]) for name in names}
