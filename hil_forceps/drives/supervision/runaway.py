"""Whether a motor runs away from its reference although its drive gives all that it may. Pure.

A drive whose encoder counts against its motor, or whose loop is reversed, turns the motor away from the reference,
faster and faster, until its current is at the limit and stays there; nothing that is sent to it is wrong. What is told
here: the current is at the limit, and sample for sample the motor itself goes further away, and does not slow down. A
load that the drive can hold turns the motor back there at the latest, however it grows. One that it can't hold looks
the same, and has to end in the same way.

Sooner it can't be told: whatever angle and current a reversed drive shows, a load of 2 K_t i shows with a sound one. So
a bound on the load decides, and that is the current limit.
"""

import math
from typing import Final

MIN_CURRENT_LIMIT_SHARE: Final = 0.9  # of the current limit: drives tell a little less where they are at it
SAMPLES_IN_A_ROW: Final = 3
MIN_ERROR_RAD: Final = math.radians(1.0)  # off the reference
MIN_WAY_RATIO: Final = 0.98  # of the way of the sample before: a motor that is braked goes less


class RunawayWatch:
    """Samples in, as they come, with the reference that the drive has; stays tripped once it was."""

    def __init__(self, current_limit_A: float) -> None:
        """ValueError for a limit that is none."""
        if not current_limit_A > 0.0:
            raise ValueError(f"a current limit of {current_limit_A} A is none")
        self.has_tripped = False
        self.off_rad = 0.0  # when that was seen
        self._enough_A = MIN_CURRENT_LIMIT_SHARE * current_limit_A
        self._before_rad = math.nan
        self._way_rad = 0.0  # of the sample before
        self._count = 0

    def see(self, theta_m_rad: float, current_A: float, reference_rad: float) -> bool:
        """Take a sample; a reference that isn't finite is none yet."""
        if abs(current_A) < self._enough_A:
            self._before_rad, self._way_rad, self._count = theta_m_rad, 0.0, 0
            return self.has_tripped
        way_rad, off_rad = theta_m_rad - self._before_rad, theta_m_rad - reference_rad
        is_away = abs(current_A) >= self._enough_A and abs(off_rad) >= MIN_ERROR_RAD and way_rad * off_rad > 0.0
        if is_away and abs(way_rad) >= MIN_WAY_RATIO * abs(self._way_rad):
            self._count += 1
            if self._count >= SAMPLES_IN_A_ROW and not self.has_tripped:
                self.has_tripped, self.off_rad = True, off_rad
        else:
            self._count = 0
        self._before_rad, self._way_rad = theta_m_rad, way_rad if is_away else 0.0
        return self.has_tripped

    def words(self) -> str:
        """Return what was seen, with the remedy."""
        return (
            f"the motor runs away from its reference, by {math.degrees(self.off_rad):+.1f} deg, at the drive's "
            "current limit: encoder and motor have opposite directions, or the load is too large; "
            "set the direction of the encoder in the drive and calibrate again "
            "(motor_driver.encoder_rev_per_pulley_rev changes angles and references alike, and does not help)"
        )
