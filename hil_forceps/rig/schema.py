"""The rig: what a rig file holds. A rig built or changed in code passes the same checks as one read from a file."""

from collections.abc import Mapping
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from hil_forceps.rig.errors import UserError
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.quantities import Parameter
from hil_forceps.rig.sections import (
    ALGORITHM_IDS,
    AlgorithmId,
    BenchSettings,
    DriveLaw,
    Effects,
    Encoder,
    EstimatorSettings,
    Forceps,
    Limits,
    Motor,
    MotorDriver,
    Noise,
    Recording,
    Section,
)
from hil_forceps.rig.validation import consistency
from hil_forceps.rig.validation.problems import Problem, problems_error, show_path
from hil_forceps.rig.validation.translation import problems_of

__all__ = [
    "ALGORITHM_IDS",
    "AlgorithmId",
    "BenchSettings",
    "DriveLaw",
    "Encoder",
    "EstimatorSettings",
    "Forceps",
    "Limits",
    "Motor",
    "MotorDriver",
    "Noise",
    "Parameter",
    "Recording",
    "Rig",
    "rig_from_data",
    "validate",
]


class Rig(Section):
    """A rig file: what is known of a forceps with its motor and drive, and how the bench runs it."""

    forceps: Forceps
    motor: Motor
    encoder: Encoder
    drive: DriveLaw | None = None
    motor_driver: MotorDriver | None = None
    noise: Noise = Noise()
    recording: Recording = Recording()
    effects: Effects = Field(default_factory=dict)
    bench: BenchSettings = BenchSettings()
    limits: Limits = Limits()
    estimators: EstimatorSettings = EstimatorSettings()

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        if problems := consistency.check(consistency.flatten(self.to_data(), type(self))):
            raise problems_error(problems)
        return self

    def __hash__(self) -> int:
        # Without the effects, whose mappings can't be hashed: equal rigs still have equal hashes.
        return hash((self.forceps, self.motor, self.encoder, self.drive, self.noise, self.bench, self.limits))

    @property
    def drive_profile(self) -> str:
        """What the motor driver speaks: `native`, the project's own protocol, where the rig names none."""
        return "native" if self.motor_driver is None else self.motor_driver.profile

    def to_data(self) -> dict[str, Any]:
        """Return what was given, as plain data in the form that a rig file has."""
        return self.model_dump(by_alias=True, exclude_unset=True)

    def with_changes(self, changes: Mapping[str, object]) -> "Rig":
        """Return a rig with other values, checked as a whole.

        `changes` maps dotted keys to values as a file gives them (`{"encoder.counts_per_rev": 4096, "effects": {}}`);
        a whole section may be given as a mapping, and None removes a key, so that its default holds. UserError when
        the result is no valid rig.
        """
        given: Any = changes
        if not isinstance(given, Mapping) or not all(isinstance(key, str) for key in given):
            raise TypeError(
                'changes: must be a mapping of keys to values, such as {"encoder.counts_per_rev": 4096}, '
                f"not {type(given).__name__}"
            )
        data = self.to_data()
        for dotted, value in changes.items():
            section, _, key = dotted.partition(".")
            target = data.setdefault(section, {}) if key else data
            if not isinstance(target, dict):
                continue  # an earlier change put something else in place of the section: refused below
            if value is None:
                target.pop(key or section, None)
            else:
                target[key or section] = dict(value) if isinstance(value, Mapping) else value
        return rig_from_data(data)

    def plant(self) -> PlantParameters:
        """Return the values of the plant; UserError naming every one that isn't known."""
        named = {f"forceps.{key}": getattr(self.forceps, key) for key in type(self.forceps).model_fields}
        named |= {f"motor.{key}": getattr(self.motor, key) for key in type(self.motor).model_fields}
        unknown = [key for key, parameter in named.items() if parameter.value is None]
        if unknown:
            raise UserError([f"{key}: has no value, but one is needed here; give a value" for key in unknown])
        return PlantParameters(**{key.partition(".")[2]: parameter.value for key, parameter in named.items()})

    def require_drive(self) -> DriveLaw:
        """Return the drive's law; UserError when the rig has none."""
        if self.drive is None:
            raise UserError("drive: the section is missing, and the closed loop can't be simulated without it; add it")
        return self.drive

    def require_bench(self) -> None:
        """UserError with all that keeps a bench from running this rig: no drive, unknown values, no time.

        A rig needs none of this to be a rig: a file without `bench:` may have a drive too fast for the default bus.
        """
        problems: list[str] = []
        for need in (self.plant, self.require_drive):
            try:
                need()
            except UserError as error:
                problems += error.problems
        found = consistency.check_bench(consistency.flatten(self.to_data(), type(self)))
        if problems := [*problems, *map(_without_place, found)]:
            raise UserError(problems)


def _without_place(problem: Problem) -> str:
    return f"{show_path(problem.path)}: {problem.text}" if problem.path else problem.text


def rig_from_data(data: Mapping[str, object]) -> Rig:
    """Validate plain data in the form of a rig file; UserError with every problem, without places in a file."""
    rig, problems = validate(data)
    if rig is None:
        raise UserError([_without_place(problem) for problem in problems])
    return rig


def validate(data: Mapping[str, object]) -> tuple[Rig | None, list[Problem]]:
    """Validate plain data: a rig, or None and every problem, those between keys included."""
    try:
        return Rig.model_validate(data), []
    except ValidationError as error:
        problems = problems_of(error, Rig)
    problems += consistency.check(consistency.flatten(data, Rig, {problem.path for problem in problems}))
    return None, list(dict.fromkeys(problems))
