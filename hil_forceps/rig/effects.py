"""What a rig file holds under `effects:`, checked against the catalogue."""

import math
from collections.abc import Iterator, Mapping

from hil_forceps.rig.catalogue import EFFECT_IDS, Effect, Parameter, effect
from hil_forceps.rig.quantities import Quantity
from hil_forceps.rig.validation.problems import Problem, nearest, problems_error, remedy_for_text, show_value
from hil_forceps.rig.validation.translation import unit_mix_up


def quantity_of(parameter: Parameter) -> Quantity:
    """Return unit and range of an effect's parameter."""
    return Quantity(parameter.unit, parameter.minimum, parameter.maximum)


def check_effects(given: object) -> object:
    """Raise what pydantic expects when the mapping of effects has a problem; paths are relative to it."""
    if isinstance(given, Mapping):
        problems = [problem for effect_id, values in given.items() for problem in _problems(str(effect_id), values)]
        if problems:
            raise problems_error(problems)
    return given


def _problems(effect_id: str, values: object) -> Iterator[Problem]:
    if effect_id not in EFFECT_IDS:
        guess = nearest(effect_id, EFFECT_IDS)
        remedy = f"did you mean {guess}?" if guess else "see docs/rig-file.md for the ids"
        yield Problem((effect_id,), f"is no effect of the catalogue; {remedy}")
    elif not isinstance(values, Mapping):
        text = f"is {show_value(values)}, must be a mapping of names to numbers; write `name: number` lines under it"
        yield Problem((effect_id,), text)
    else:
        yield from _parameter_problems(effect(effect_id), {str(name): value for name, value in values.items()})


def _parameter_problems(entry: Effect, values: Mapping[str, object]) -> Iterator[Problem]:
    known = {parameter.name: parameter for parameter in entry.parameters}
    meant: set[str] = set()
    for name, value in values.items():
        if name in known:
            if text := _value_problem(known[name], value):
                yield Problem((entry.id, name), text)
        else:
            text, guess = _unknown_name(name, entry)
            meant |= {guess} if guess else set()
            yield Problem((entry.id, name), text)
    for name, parameter in known.items():
        if parameter.neutral is None and name not in values and name not in meant:
            yield Problem((entry.id, name), f"is missing; add it ({parameter.meaning})")


def _value_problem(parameter: Parameter, value: object) -> str | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"is {show_value(value)}, must be a number; {remedy_for_text(value)}"
    if not math.isfinite(value):
        return f"is {show_value(value)}, must be a finite number; correct it"
    return quantity_of(parameter).problem(value)


def _unknown_name(name: str, entry: Effect) -> tuple[str, str | None]:
    """Return what to say about a name that the effect doesn't have, and the one that was meant, if that can be told."""
    for parameter in entry.parameters:
        if parameter.unit and (text := unit_mix_up(name, parameter.name, parameter.unit)):
            return text, parameter.name
    names = [parameter.name for parameter in entry.parameters]
    guess = nearest(name, names)
    remedy = f"did you mean {guess}?" if guess else f"known are {', '.join(names)}"
    return f"unknown parameter; {remedy}", guess
