"""All parameters that can be fitted, as one flat vector: those of the plant, then those of every effect."""

import math
from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from hil_forceps.rig.catalogue import EFFECTS, Parameter
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.schema import Rig

Vector = NDArray[np.float64]

_MOTOR = "torque_constant_N_m_per_A"
PLANT_NAMES = tuple(f"{'motor' if key == _MOTOR else 'forceps'}.{key}" for key in PlantParameters._fields)
_EFFECT_PARAMETERS: Mapping[str, Parameter] = {
    f"effects.{effect.id}.{parameter.name}": parameter for effect in EFFECTS for parameter in effect.parameters
}
NAMES: tuple[str, ...] = (*PLANT_NAMES, *_EFFECT_PARAMETERS)
_INDEX = {name: position for position, name in enumerate(NAMES)}
_NO_LIMIT = "effects.current_saturation.limit_A"


def index(name: str) -> int:
    """Return the place of a dotted name in the vector; KeyError for an unknown one."""
    return _INDEX[name]


def off_value(name: str) -> float:
    """Return the value of an effect's parameter while the effect is off; KeyError for an unknown one.

    A shape has no neutral value and keeps the catalogue's typical one; a limit of the current is infinite.
    """
    if name == _NO_LIMIT:
        return math.inf
    parameter = _EFFECT_PARAMETERS[name]
    return parameter.typical if parameter.neutral is None else parameter.neutral


def neutral() -> Vector:
    """Return the part of the vector after the plant's values, with every effect off."""
    return np.array([off_value(name) for name in _EFFECT_PARAMETERS])


def vector(rig: Rig) -> Vector:
    """Return the vector of a rig; UserError that names every unknown value of the plant."""
    theta = np.concatenate((np.array(rig.plant()), neutral()))
    for effect_id, values in rig.effects.items():
        for name, value in values.items():
            theta[_INDEX[f"effects.{effect_id}.{name}"]] = value
    return theta


def rig_with(rig: Rig, theta: Vector, effect_ids: Collection[str]) -> Rig:
    """Return the rig with the vector's values and only the named effects; UserError when the result is no valid rig."""
    changes: dict[str, object] = {name: float(theta[_INDEX[name]]) for name in PLANT_NAMES}
    effects: dict[str, dict[str, float]] = {}
    for effect in EFFECTS:
        if effect.id in effect_ids:
            effects[effect.id] = {
                parameter.name: float(theta[_INDEX[f"effects.{effect.id}.{parameter.name}"]])
                for parameter in effect.parameters
            }
    if unknown := set(effect_ids) - set(effects):
        raise ValueError(f"not in the catalogue: {', '.join(sorted(unknown))}")
    # The whole section is replaced: effects that are left out must not stay.
    return rig.with_changes({**changes, "effects": effects})
