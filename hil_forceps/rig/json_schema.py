"""JSON schemas of rig and bench files, for editors: what a key means, its unit, its range, which values it may have.

Draft 7, which editors know best. A schema sees one key at a time: what holds between keys is checked where a file is
read (`hil_forceps.rig.validation.consistency`), and so are duplicate keys and everything that is no YAML.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from hil_forceps.rig import units
from hil_forceps.rig.catalogue import EFFECTS, Effect
from hil_forceps.rig.effects import quantity_of as effect_quantity
from hil_forceps.rig.quantities import UNKNOWN, Parameter, Quantity
from hil_forceps.rig.schema import Rig
from hil_forceps.rig.sections import IDEAL, Section

DRAFT: Final = "http://json-schema.org/draft-07/schema#"
Schema = dict[str, Any]
Kind = Literal["rig", "bench"]


def schema(kind: Kind) -> Schema:
    """Return the schema of a rig file, or of a bench file: a rig that has what a bench needs."""
    sections = dict(_sections(kind))
    needed = [key for key, info in Rig.model_fields.items() if info.is_required()]
    return {
        "$schema": DRAFT,
        "title": {"rig": "rig file of hil-forceps", "bench": "bench file of hil-forceps"}[kind],
        "description": "docs/rig-file.md has each key; all numbers are SI, and every key ends in its unit",
        "type": "object",
        "required": [*needed, "drive", "bench"] if kind == "bench" else needed,
        "additionalProperties": False,
        "properties": sections,
    }


def _sections(kind: Kind) -> Iterator[tuple[str, Schema]]:
    for key, info in Rig.model_fields.items():
        model = section_model(info)
        yield key, _effects() if model is None else _section(model, kind)


def section_model(info: FieldInfo) -> type[Section] | None:
    """Return the model of a section of the rig; None for `effects:`."""
    kinds = (info.annotation, *get_args(info.annotation))
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Section)), None)


def _section(model: type[BaseModel], kind: Kind) -> Schema:
    fields = model.model_fields
    return {
        "description": _plain(model.__doc__ or ""),
        "type": "object",
        "required": [name for name, field in fields.items() if field.is_required()],
        "additionalProperties": False,
        "properties": {name: _key(field, kind) for name, field in fields.items()},
    }


def _key(field: FieldInfo, kind: Kind) -> Schema:
    quantity = quantity_of(field)
    unit = f" [{units.show_unit(quantity.unit)}]" if quantity and quantity.unit else ""
    about: Schema = {"description": f"{_plain(field.description or '')}{unit}"}
    if not field.is_required() and field.default is not None:
        about["default"] = list(field.default) if isinstance(field.default, tuple) else field.default
    return about | _values(field, quantity, kind)


def _values(field: FieldInfo, quantity: Quantity | None, kind: Kind) -> Schema:
    annotation = field.annotation
    if annotation is Parameter:
        assert quantity is not None
        return _parameter(quantity, kind)
    if get_origin(annotation) is tuple:
        entry = get_args(annotation)[0]
        items = _choices(entry) if get_origin(entry) is Literal else _number(_needed(quantity))
        # What may be empty is the times alone: "name one at least" holds for names.
        least = {} if quantity else {"minItems": 1}
        return {"type": "array", "items": items, "uniqueItems": True, **least}
    literal = next((part for part in (annotation, *get_args(annotation)) if get_origin(part) is Literal), None)
    if literal is not None:
        return _choices(literal)
    if quantity is None:
        return {"type": "string"}
    number = _number(quantity, whole=_is_whole(annotation))
    can_be_ideal = field.is_required() and type(None) in get_args(annotation)
    return {"anyOf": [number, {"const": IDEAL}]} if can_be_ideal else number


def _needed(quantity: Quantity | None) -> Quantity:
    assert quantity is not None
    return quantity


def _is_whole(annotation: object) -> bool:
    return annotation is int or any(_is_whole(part) for part in get_args(annotation))


def _choices(literal: object) -> Schema:
    """Return the values of a literal; a version may stand in a file as a number."""
    values = list(get_args(literal))
    versions = [float(value) for value in values if isinstance(value, str) and value.replace(".", "", 1).isdigit()]
    return {"enum": [*values, *versions]}


def _number(quantity: Quantity, *, whole: bool = False) -> Schema:
    low = "exclusiveMinimum" if quantity.open_low else "minimum"
    return {"type": "integer" if whole else "number", low: quantity.low, "maximum": quantity.high}


def _parameter(quantity: Quantity, kind: Kind) -> Schema:
    """Return what may be said of a physical parameter; a bench needs its value."""
    number = _number(quantity)
    known: Schema = {
        "type": "object",
        "additionalProperties": False,
        "minProperties": 1,
        "properties": {"value": number, "sd": {"type": "number", "minimum": 0}, "min": number, "max": number},
        "dependencies": {"min": ["max"], "max": ["min"], "sd": ["value"]},
    }
    if kind == "bench":
        return {"anyOf": [number, known | {"required": ["value"]}]}
    return {"anyOf": [number, {"const": UNKNOWN}, known]}


def _effects() -> Schema:
    return {
        "description": "Effects that the plain model lacks, with their parameters; docs/rig-file.md has the catalogue",
        "type": "object",
        "additionalProperties": False,
        "properties": {entry.id: _effect(entry) for entry in EFFECTS},
    }


def _effect(entry: Effect) -> Schema:
    parameters = {}
    for each in entry.parameters:
        unit = f" [{units.show_unit(each.unit)}]" if each.unit else ""
        parameters[each.name] = {"description": f"{_plain(each.meaning)}{unit}"} | _number(effect_quantity(each))
    return {
        "description": f"{_plain(entry.summary)}; {entry.equation}",
        "type": "object",
        "required": [each.name for each in entry.parameters if each.neutral is None],
        "additionalProperties": False,
        "properties": parameters,
    }


def quantity_of(field: FieldInfo) -> Quantity | None:
    """Return the unit and range of a key, or of the entries of its list."""
    return next(_quantities([*field.metadata, field.annotation]), None)


def _quantities(parts: Sequence[object]) -> Iterator[Quantity]:
    for part in parts:
        if isinstance(part, Quantity):
            yield part
        else:
            yield from _quantities(get_args(part))


def _plain(text: str) -> str:
    return text.replace("`", "")
