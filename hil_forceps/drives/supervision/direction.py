"""Whether the motor goes the way of its references, told by the first fraction of a degree. Pure.

A drive whose encoder counts against its motor runs away from a reference; one whose feedback and command count in
opposite directions mirrors it. Both show in a step too small to do harm.

What doesn't show: a wrong sign of `encoder_rev_per_pulley_rev` alone. It turns angles and references together, so the
angle follows all the same, and only the jaw goes the other way.
"""

import math
from enum import Enum
from typing import Final

MIN_WAY_SHARE: Final = 0.25  # of the step, that the angle has to go for a word
MIN_WAY_NOISE_RATIO: Final = 4.0  # over the angle's range at rest, below which nothing is said


class Direction(Enum):
    """What can be said so far."""

    UNDECIDED = "undecided"
    WITH = "with the reference"
    AGAINST = "against the reference"


class DirectionProbe:
    """References and angles in, as they come; says once which way the motor goes."""

    def __init__(self, step_rad: float, noise_rad: float) -> None:
        """`step_rad`: how far the reference will go at most. ValueError where noise would hide that."""
        self.needed_rad = max(MIN_WAY_SHARE * step_rad, MIN_WAY_NOISE_RATIO * noise_rad)
        if not (0.0 < self.needed_rad <= 0.5 * step_rad and math.isfinite(step_rad)):
            raise ValueError(f"a step of {step_rad} rad can't be told from {noise_rad} rad of noise")
        self.direction = Direction.UNDECIDED
        self.asked_rad = 0.0  # by the reference, from the first one on
        self.moved_rad = 0.0  # by the angle, from the first one on
        self._start: tuple[float, float] | None = None

    def see(self, reference_rad: float, theta_m_rad: float) -> Direction:
        """Take the newest reference and the newest angle; the first pair is where both start."""
        if self._start is None:
            self._start = reference_rad, theta_m_rad
        if self.direction is Direction.UNDECIDED:
            self.asked_rad, self.moved_rad = reference_rad - self._start[0], theta_m_rad - self._start[1]
            along_rad = math.copysign(self.moved_rad, self.asked_rad * self.moved_rad)
            if self.asked_rad != 0.0 and abs(along_rad) >= self.needed_rad:
                self.direction = Direction.WITH if along_rad > 0.0 else Direction.AGAINST
        return self.direction

    def words(self) -> str:
        """Return what was seen; where that is wrong, with the remedy."""
        seen = f"the angle moved by {math.degrees(self.moved_rad):+.3f} deg, the reference by "
        seen += f"{math.degrees(self.asked_rad):+.3f} deg"
        if self.direction is Direction.AGAINST:
            return (
                f"{seen}: measured angle and reference have opposite directions; set the direction "
                "of the encoder in the drive and calibrate again, then check the sign of "
                "motor_driver.encoder_rev_per_pulley_rev, which changes both"
            )
        return f"{seen}: the motor does not follow" if self.direction is Direction.UNDECIDED else seen
