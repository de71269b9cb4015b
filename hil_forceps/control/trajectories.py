"""Reference of the jaw angle over the time of an experiment."""

import math
from bisect import bisect_right
from dataclasses import dataclass

PAPER_START_RAD = math.radians(90.0)
PAPER_END_RAD = math.radians(10.0)
PAPER_RAMP_S = 5.0


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Straight lines between points; before the first and after the last point their angles are held.

    `times_s` [s] must increase strictly and have as many entries as `angles_rad` [rad], one at least, all finite:
    ValueError otherwise.
    """

    times_s: tuple[float, ...]
    angles_rad: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.times_s) != len(self.angles_rad) or not self.times_s:
            raise ValueError(
                f"a trajectory needs as many angles as times, one at least; got {len(self.angles_rad)} angles and "
                f"{len(self.times_s)} times"
            )
        if not all(map(math.isfinite, (*self.times_s, *self.angles_rad))):
            raise ValueError("times and angles of a trajectory must be finite")
        if any(later <= earlier for earlier, later in zip(self.times_s, self.times_s[1:], strict=False)):
            raise ValueError("times of a trajectory must increase")

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


PAPER_TRAJECTORY = Trajectory((0.0, PAPER_RAMP_S), (PAPER_START_RAD, PAPER_END_RAD))


def paper_jaw_reference(t_s: float) -> float:
    """Return θ_j^ref [rad] of both of the paper's simulations: 90° until 0 s, to 10° by 5 s, held."""
    return PAPER_TRAJECTORY(t_s)
