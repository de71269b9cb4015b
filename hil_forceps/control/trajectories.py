"""Reference of the jaw angle over the time of an experiment."""

import math
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

PAPER_START_RAD = math.radians(90.0)
PAPER_END_RAD = math.radians(10.0)
PAPER_RAMP_S = 5.0


@dataclass(frozen=True, slots=True, init=False)
class Trajectory:
    """Straight lines between points; before the first and after the last point their angles are held.

    `times_s` [s] must increase strictly and have as many entries as `angles_rad` [rad], one at least, all finite:
    ValueError otherwise. Lists, tuples and arrays of numbers are taken, TypeError for anything else.
    """

    times_s: tuple[float, ...]
    angles_rad: tuple[float, ...]

    def __init__(self, times_s: Iterable[float], angles_rad: Iterable[float]) -> None:
        times, angles = _numbers("times_s", times_s), _numbers("angles_rad", angles_rad)
        if len(times) != len(angles) or not times:
            raise ValueError(
                f"times_s and angles_rad: there are {len(times)} times and {len(angles)} angles; give as many of each, "
                "one at least"
            )
        for place, (before, after) in enumerate(pairwise(times), 1):
            if after <= before:
                raise ValueError(f"times_s[{place}]: {after:g} s does not come after {before:g} s; sort the points")
        object.__setattr__(self, "times_s", times)
        object.__setattr__(self, "angles_rad", angles)

    def __call__(self, t_s: float) -> float:
        """Return the angle [rad] at `t_s` [s]; NaN for NaN."""
        if t_s != t_s:  # noqa: PLR0124 - NaN has no place among the points; as an angle the gate stops it
            return t_s
        after = bisect_right(self.times_s, t_s)
        if after == 0:
            return self.angles_rad[0]
        if after == len(self.times_s):
            return self.angles_rad[-1]
        begin_s, begin_rad = self.times_s[after - 1], self.angles_rad[after - 1]
        share = (t_s - begin_s) / (self.times_s[after] - begin_s)
        return begin_rad + share * (self.angles_rad[after] - begin_rad)

    def angles(self, t_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the angles [rad] at these times [s], which are numbers: bit for bit those of single calls."""
        times, angles = np.array(self.times_s), np.array(self.angles_rad)
        after = np.searchsorted(times, t_s, side="right")
        result: NDArray[np.float64] = np.where(after == 0, angles[0], angles[-1])
        inside = (after > 0) & (after < times.size)
        end = after[inside]
        begin_s, begin_rad = times[end - 1], angles[end - 1]
        result[inside] = begin_rad + (t_s[inside] - begin_s) / (times[end] - begin_s) * (angles[end] - begin_rad)
        return result


def _numbers(name: str, values: Any) -> tuple[float, ...]:
    """Return finite numbers as floats; TypeError or ValueError with the place of one that isn't."""
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        raise TypeError(f"{name}: must be a list, tuple or array of numbers, not {type(values).__name__}")
    numbers: list[float] = []
    for place, value in enumerate(values):
        if not isinstance(value, Real):
            raise TypeError(f"{name}[{place}]: must be a number, not {type(value).__name__}")
        number = float(value)
        if not math.isfinite(number):
            raise ValueError(f"{name}[{place}]: is {number}; must be a finite number")
        numbers.append(number)
    return tuple(numbers)


PAPER_TRAJECTORY = Trajectory((0.0, PAPER_RAMP_S), (PAPER_START_RAD, PAPER_END_RAD))


def paper_jaw_reference(t_s: float) -> float:
    """Return θ_j^ref [rad] of both of the paper's simulations: 90° until 0 s, to 10° by 5 s, held."""
    return PAPER_TRAJECTORY(t_s)
