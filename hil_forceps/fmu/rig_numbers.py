"""What a rig's numbers are called, and what unit, range and meaning they have: for the variables of units."""

from functools import cache
from typing import NamedTuple

from hil_forceps.rig.catalogue import EFFECTS
from hil_forceps.rig.quantities import Quantity
from hil_forceps.rig.sections import DriveLaw, Forceps, Motor, Section


class Number(NamedTuple):
    """A number of a rig file."""

    unit: str
    minimum: float
    maximum: float
    meaning: str


@cache
def rig_numbers() -> dict[str, Number]:
    """Return the numbers of plant, drive and effects by their dotted names."""
    known = {**_section("forceps", Forceps), **_section("motor", Motor), **_section("drive", DriveLaw)}
    for effect in EFFECTS:
        for each in effect.parameters:
            meaning = f"{each.meaning}: {effect.summary}; {effect.equation}"
            known[f"effects.{effect.id}.{each.name}"] = Number(each.unit, each.minimum, each.maximum, meaning)
    return known


def _section(name: str, of: type[Section]) -> dict[str, Number]:
    found = {}
    for key, field in of.model_fields.items():
        quantity = next(each for each in field.metadata if isinstance(each, Quantity))
        found[f"{name}.{key}"] = Number(quantity.unit, quantity.low, quantity.high, field.description or "")
    return found
