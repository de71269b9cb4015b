"""Numbers with a unit and a range of sense, and parameters of which more or less is known."""

import math
from dataclasses import dataclass
from typing import Annotated, Any, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from hil_forceps.rig import units
from hil_forceps.rig.validation.problems import (
    Problem,
    problems_error,
    remedy_for_text,
    show_number,
    show_value,
    text_error,
)

DEFAULT_RELATIVE_SD = 0.1
UNKNOWN = "unknown"

STRICT = ConfigDict(strict=True, frozen=True, extra="forbid", populate_by_name=True)

Number = Annotated[float, Field(allow_inf_nan=False)]


def _whole(value: object) -> object:
    """Let 1e6 be a whole number too: YAML reads it as a float."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


Whole = Annotated[int, BeforeValidator(_whole)]


class Parameter(BaseModel):
    """What is known of a physical quantity: a value with a standard deviation, bounds, or nothing at all.

    In YAML: a number (sd is 10 % of it), `{value, sd}`, `{min, max}`, `{value, min, max}`, all four, or `unknown`.
    A bare 0 has sd 0: it is taken as exactly zero. Bounds without `sd` leave `sd` None: the bounds say all there is.
    """

    model_config = STRICT

    value: Number | None = None
    sd: Annotated[Number, Field(ge=0.0)] | None = None
    minimum: Number | None = Field(default=None, alias="min")
    maximum: Number | None = Field(default=None, alias="max")

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: object) -> object:
        if isinstance(given, int | float) and not isinstance(given, bool):
            if not math.isfinite(given):
                raise text_error(f"is {show_value(given)}, must be a finite number; correct it")
            return {"value": given, "sd": _default_sd(given)}
        if given == UNKNOWN:
            return dict.fromkeys(("value", "sd", "min", "max"))
        if not isinstance(given, dict):
            remedy = remedy_for_text(given)
            if remedy == "correct it":
                remedy = f"write a number, {{value, sd}}, {{min, max}}, {{value, min, max}} or {UNKNOWN}"
            raise text_error(f"is {show_value(given)}, must say what is known of a number; {remedy}")
        if not given:
            raise text_error(f"is empty; write {UNKNOWN} if nothing is known")
        if set(given) == {"value"} and isinstance(given["value"], int | float):
            return {**given, "sd": _default_sd(given["value"])}
        return given

    @model_validator(mode="after")
    def _check(self) -> Self:
        problems: list[Problem] = []
        if (self.minimum is None) != (self.maximum is None):
            problems.append(Problem((), "has one bound only; give both min and max"))
        if self.sd is not None and self.value is None:
            problems.append(Problem(("sd",), "stands without a value; add value"))
        if self.minimum is not None and self.maximum is not None:
            if not self.minimum < self.maximum:
                text = f"is {show_number(self.minimum)}, not below max {show_number(self.maximum)}; swap or widen them"
                problems.append(Problem(("min",), text))
            elif self.value is not None and not self.minimum <= self.value <= self.maximum:
                bounds = f"min {show_number(self.minimum)} to max {show_number(self.maximum)}"
                text = f"is {show_number(self.value)}, outside {bounds}; widen the bounds"
                problems.append(Problem(("value",), text))
        if problems:
            raise problems_error(problems)
        return self

    @model_serializer
    def _write(self) -> float | str | dict[str, float]:
        if self.value is not None and self.sd == _default_sd(self.value) and self.minimum is None:
            return self.value
        given = {"value": self.value, "sd": self.sd, "min": self.minimum, "max": self.maximum}
        return {key: number for key, number in given.items() if number is not None} or UNKNOWN


def _default_sd(value: float) -> float:
    return DEFAULT_RELATIVE_SD * abs(value)


@dataclass(frozen=True, slots=True)
class Quantity:
    """Unit and range of sense of a number or `Parameter`, as metadata of an annotated field."""

    unit: str  # as in the key's name; "" for a pure number
    low: float
    high: float
    open_low: bool = False  # `low` itself is outside

    def holds(self, number: float) -> bool:
        """Tell whether a number makes sense."""
        return (number > self.low if self.open_low else number >= self.low) and number <= self.high

    def range_text(self) -> str:
        """Say the range in words."""
        text = (
            f"above {show_number(self.low)} and at most {show_number(self.high)}"
            if self.open_low
            else f"{show_number(self.low)} to {show_number(self.high)}"
        )
        return f"{text} {units.show_unit(self.unit)}" if self.unit else text

    def problem(self, number: float) -> str | None:
        """Say what is wrong with a number, with a guess at the unit that was meant; None when nothing is."""
        if self.holds(number):
            return None
        text = f"is {show_number(number)} {units.show_unit(self.unit)}".rstrip() + f", must be {self.range_text()}"
        for unit in units.mix_ups(self.unit) if math.isfinite(number) else ():
            converted = number * (units.factor(unit, self.unit) or math.nan)
            if self.holds(converted):
                return f"{text}; if {show_number(number)} {units.show_unit(unit)} is meant, write {converted:.6g}"
        return f"{text}; correct it"

    def check(self, value: object) -> object:
        """Raise what pydantic expects when the value, or what is known of it, makes no sense."""
        if isinstance(value, Parameter):
            parts = {"value": value.value, "min": value.minimum, "max": value.maximum}
            bare = value.minimum is None
            problems = [
                Problem(() if bare else (key,), text)
                for key, number in parts.items()
                if number is not None and (text := self.problem(number))
            ]
        elif isinstance(value, int | float):
            problems = [Problem((), text)] if (text := self.problem(value)) else []
        else:
            problems = []
        if problems:
            raise problems_error(problems)
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self.check, handler(source))
