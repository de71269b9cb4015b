"""Presets of motors and drives: what data sheets and the pages of the drives say, each value with where it stands.

One YAML file a motor (`motors/`) and a drive's profile (`drives/`); its name is the preset's. All SI.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict

from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import ProfileName
from hil_forceps.rig.validation.problems import nearest
from hil_forceps.rig.yaml_loader import load_document

FOLDER = Path(__file__).parent
_STRICT = ConfigDict(strict=True, frozen=True, extra="forbid")


class Fact(BaseModel):
    """A value and where it is from, in the words of its source."""

    model_config = _STRICT

    value: float | int | str
    source: str


class MotorValues(BaseModel):
    """What a data sheet says of a motor; of an actuator or a servo, at its own shaft."""

    model_config = _STRICT

    torque_constant_N_m_per_A: Fact
    inertia_kg_m2: Fact | None = None
    viscous_N_m_s_per_rad: Fact | None = None
    coulomb_N_m: Fact | None = None
    nominal_current_A: Fact | None = None
    nominal_torque_N_m: Fact | None = None
    nominal_speed_rad_per_s: Fact | None = None
    no_load_current_A: Fact | None = None
    no_load_speed_rad_per_s: Fact | None = None
    encoder_counts_per_rev: Fact | None = None


class MotorPreset(BaseModel):
    """A motor: its values, and for an actuator with a drive inside what that is set to."""

    model_config = _STRICT

    title: str
    source: str
    about: str = ""
    drive: ProfileName | None = None  # the only one that it goes with
    values: MotorValues
    motor_driver: Mapping[str, Fact] = {}


class DrivePreset(BaseModel):
    """A drive's profile: what a rig's sections have for it."""

    model_config = _STRICT

    title: str
    page: str
    tells_one_turn: bool = False  # all of the motion has to be within one turn of its encoder
    takes_current_limit: bool = False  # the service tells it one
    max_sample_age_s: Fact
    speed_max_rad_per_s: Fact | None = None
    drive: Mapping[str, Fact]
    bench: Mapping[str, Fact]
    motor_driver: Mapping[str, Fact] = {}


@cache
def motors() -> Mapping[str, MotorPreset]:
    """Return the motors by name."""
    return {path.stem: MotorPreset.model_validate(_data(path)) for path in _files("motors")}


@cache
def drives() -> Mapping[str, DrivePreset]:
    """Return the drives by the name of their profile."""
    return {path.stem: DrivePreset.model_validate(_data(path)) for path in _files("drives")}


def motor_preset(name: str) -> MotorPreset:
    """Return a motor; UserError where there is none of that name."""
    found = motors().get(name)
    if found is None:
        raise UserError(f"--motor {name}: {_remedy(name, motors())}")
    return found


def drive_preset(name: str) -> DrivePreset:
    """Return a drive; UserError where there is none of that name."""
    found = drives().get(name)
    if found is None:
        raise UserError(f"--drive {name}: {_remedy(name, drives())}")
    return found


def _remedy(name: str, known: Mapping[str, object]) -> str:
    guess = nearest(name, known)
    meant = f"did you mean {guess}? " if guess else ""
    return f"there is no such preset; {meant}`hil-forceps init --list` has them all"


def _files(kind: Literal["motors", "drives"]) -> list[Path]:
    return sorted((FOLDER / kind).glob("*.yaml"))


def _data(path: Path) -> object:
    return load_document(path.read_text(encoding="utf-8"), path.name).data
