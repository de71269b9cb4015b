"""What an entry of the catalogue of effects says of itself: plain data, without any physics."""

import math
from typing import Literal, NamedTuple

Location = Literal["motor", "wire", "jaw", "sensor", "timing"]
# What runs contain (`hypotheses.entries.Scene`), where the values at which an entry is looked for scale with it.
RunExtent = Literal[
    "",  # nothing: numbers as they are
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
    """Values of a shape parameter at which its entry is looked for: shares of what the runs contain."""

    of: RunExtent
    shares: tuple[float, ...]


class Size(NamedTuple):
    """How large an amplitude is taken where its entry is looked for: by what the runs contain."""

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
    typical: float  # a size to begin from: visible, not large
    meaning: str
    plausible: float = math.inf  # the largest that hardware has; what fits beyond only acts like it
    search_grid: Grid | None = None  # of a shape
    size: Size | None = None  # of an amplitude, where it is not the typical one
    hidden: tuple[float, float] | None = None  # range of a shape where tests hide the effect; even in the logarithm


class Effect(NamedTuple):
    """An entry of the catalogue."""

    id: str
    location: Location
    summary: str
    equation: str
    parameters: tuple[Parameter, ...]
    source: str
    shown_by: str  # what data can show it
    by_angle: bool = False  # depends on where the angle's zero is
    # What of a step of the plant it changes: the level of dry friction, torques, or the law of the wire; else it only
    # shifts constants of the linear plant, or acts on the path of the current or on a sensor.
    changes: Literal["friction", "torque", "wire", "nothing else"] = "nothing else"
    dry_friction_of: Literal["motor", "jaw"] | None = None  # part of what holds that body at rest
    corrected: bool = True  # estimators can take it out of their samples
    recurs_with: Literal["angle", "angle and current"] | None = None  # torque that is a wave over the motor's angle
    one_by_one: bool = False  # each amplitude is looked for alone
