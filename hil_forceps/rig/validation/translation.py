"""From pydantic's errors to problems in the user's words."""

from collections.abc import Iterator, Mapping
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from hil_forceps.rig import units
from hil_forceps.rig.quantities import Parameter, Quantity
from hil_forceps.rig.validation.problems import PROBLEMS_ERROR, Path, Problem, nearest, remedy_for_text, show_value

_SECTION = ("a mapping of keys", "write `key: value` lines under it")
_WANTED = {
    "float_type": ("a number", ""),
    "int_type": ("a whole number", ""),
    "dict_type": ("a mapping of names to numbers", "write `name: number` lines under it"),
    "model_type": _SECTION,
    "model_attributes_type": _SECTION,
    "tuple_type": ("a list", "put it in [ ]"),
}


def problems_of(error: ValidationError, root: type[BaseModel]) -> list[Problem]:
    """Return every problem of a failed validation of `root`, the guesses at misspelt keys among them."""
    problems: list[Problem] = []
    missing: list[Path] = []
    explained: set[Path] = set()  # keys that are there, misspelt: not missing on top of it
    for details in error.errors(include_url=False):
        path = tuple(step for step in details["loc"] if step != "[key]")
        if details["type"] == "missing":
            missing.append(path)
        elif details["type"] == "extra_forbidden":
            text, meant = _unknown_key(path, _model_at(root, path[:-1]))
            problems.append(Problem(path, text))
            explained |= {(*path[:-1], meant)} if meant else set()
        else:
            problems.extend(_problems_of_one(details, path))
    problems.extend(
        Problem(path, f"is missing; add {'the section' if len(path) == 1 else 'it'}")
        for path in missing
        if path not in explained
    )
    return problems


def _problems_of_one(details: ErrorDetails, path: Path) -> Iterator[Problem]:
    kind = details["type"]
    context: Mapping[str, Any] = details.get("ctx", {})
    shown = show_value(details["input"])
    if kind == PROBLEMS_ERROR:
        for inner in context["problems"]:
            yield Problem((*path, *inner.path), inner.text)
    elif "text" in context:
        yield Problem(path, context["text"])
    elif kind in _WANTED:
        wanted, remedy = _WANTED[kind]
        yield Problem(path, f"is {shown}, must be {wanted}; {remedy or remedy_for_text(details['input'])}")
    elif kind == "literal_error":
        yield Problem(path, f"is {shown}, must be {_literal_remedy(details['input'], context['expected'])}")
    elif kind == "finite_number":
        yield Problem(path, f"is {shown}, must be a finite number; correct it")
    elif kind == "greater_than_equal":
        yield Problem(path, f"is {shown}, must be at least {context['ge']:g}; correct it")
    elif kind == "string_pattern_mismatch":
        yield Problem(path, "is no name; use letters, digits and _")
    else:
        yield Problem(path, f"is {shown}: {details['msg'].lower()}; correct it")


def _literal_remedy(given: object, expected: str) -> str:
    choices = [word.strip("'") for word in expected.replace(" or ", ", ").split(", ")]
    guess = nearest(given, choices) if isinstance(given, str) else None
    remedy = f"did you mean {guess}?" if guess else "choose one"
    return f"{', '.join(choices[:-1])} or {choices[-1]}; {remedy}"


def _model_at(root: type[BaseModel], path: Path) -> type[BaseModel] | None:
    """Return the model of the section at `path`, None where there is none."""
    model: type[BaseModel] | None = root
    for step in path:
        info = model.model_fields.get(str(step)) if model else None
        model = _model_in(info.annotation) if info else None
    return model


def _model_in(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for inner in get_args(annotation) if (found := _model_in(inner))), None)


def _unknown_key(path: Path, model: type[BaseModel] | None) -> tuple[str, str | None]:
    """Return what to say about an unknown key, and the known key that was meant, if that can be told."""
    given = str(path[-1])
    fields = model.model_fields if model else {}
    for key, info in fields.items():
        unit = unit_of(info)
        if unit and (text := unit_mix_up(given, key, unit)):
            return text, key
    names = [info.alias or key for key, info in fields.items()]
    if guess := nearest(given, names):
        return f"unknown key; did you mean {guess}?", guess
    if len(path) == 1 or model is Parameter:
        return f"unknown key; known are {', '.join(names)}", None
    return f"unknown key; remove it or see docs/rig-file.md for the keys of {path[-2]}", None


def unit_of(info: FieldInfo) -> str | None:
    """Return the unit of a field, as it stands in the key's name."""
    return next((item.unit for item in info.metadata if isinstance(item, Quantity)), None)


def unit_mix_up(given: str, key: str, unit: str) -> str | None:
    """Say what is wrong with a key that lacks the unit of `key`, or has another; None when it is something else."""
    base = key.removesuffix(f"_{unit}")
    if given == base:
        return f"lacks its unit; write {key} and give it in {units.show_unit(unit)}"
    if not given.startswith(f"{base}_"):
        return None
    ratio = units.factor(given.removeprefix(f"{base}_"), unit)
    if ratio is None:
        return None
    return f"is in another unit; write {key} and multiply the value by {ratio:.10g}"
