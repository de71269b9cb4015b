"""Data of an entry in the catalogue of effects, without any physics."""

import math
from typing import Literal, NamedTuple

Location = Literal["motor", "wire", "jaw", "sensor", "timing"]
# Extents of runs (`hypotheses.entries.Scene`), by which starting values of the search can scale.
RunExtent = Literal[
    "",  # absolute values
    "duration_s",
    "angle_range_rad",
    "jaw_range_rad",
    "speeds_rad_per_s",
    "stretch_range_m",
    "current_max_A",
    "harmonics_cogging",
    "harmonics_ripple",
]


class Grid(NamedTuple):
    """Starting values of a shape parameter in the search, as shares of an extent of the runs."""

    of: RunExtent
    shares: tuple[float, ...]


class Size(NamedTuple):
    """Starting size of an amplitude in the search, from an extent of the runs."""

    share: float
    of: RunExtent
    power: int = 1
    at_most_typical: bool = False


class Parameter(NamedTuple):
    """A parameter of an effect."""

    name: str
    unit: str  # "" for a pure number
    minimum: float
    maximum: float
    neutral: float | None  # the value that switches the effect off; None: a shape, meaningless while it is off
    typical: float  # starting size: detectable, not large
    meaning: str
    plausible: float = math.inf  # the largest of known hardware; what fits beyond only resembles the effect
    search_grid: Grid | None = None  # of a shape
    size: Size | None = None  # of an amplitude, where it is not the typical one
    hidden: tuple[float, float] | None = None  # range of a shape in tests with hidden effects, log-uniform


class Effect(NamedTuple):
    """An entry of the catalogue."""

    id: str
    location: Location
    summary: str
    equation: str
    parameters: tuple[Parameter, ...]
    source: str
    shown_by: str  # what data can show it
    by_angle: bool = False  # depends on the zero of the angle
    # What it changes in a step of the plant: the level of dry friction, torques, or the law of the wire. Others only
    # change constants of the linear plant, or act on the path of the current or on a sensor.
    changes: Literal["friction", "torque", "wire", "nothing else"] = "nothing else"
    dry_friction_of: Literal["motor", "jaw"] | None = None  # part of what holds that body at rest
    corrected: bool = True  # estimators can correct their samples for it
    recurs_with: Literal["angle", "angle and current"] | None = None  # torque that is periodic in the motor's angle
    one_by_one: bool = False  # each amplitude is scored alone
