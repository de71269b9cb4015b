"""Whether the motor stays within a following error window around its reference, as servo drives watch it. Pure.

A drive whose encoder counts against its motor leaves the window within the first degrees, whatever its reference does.
So does a sound one that a load moves away. The window therefore is what the rig, or the user of a first run without
load, says that it is (the object 6065h of a CiA 402 drive is the same on the drive's side).
"""

import math


class FollowingErrorWatch:
    """Samples in, as they come, with the reference that the drive has; stays tripped once it was."""

    def __init__(self, max_error_rad: float) -> None:
        """ValueError for a window that is none."""
        if not max_error_rad > 0.0:
            raise ValueError(f"a following error window of {max_error_rad} rad is none")
        self.max_error_rad = max_error_rad
        self.has_tripped = False
        self.error_rad = 0.0  # when it was left
        self.current_A = 0.0  # then

    def see(self, theta_m_rad: float, current_A: float, reference_rad: float) -> bool:
        """Take a sample; a reference that isn't finite is none yet."""
        error_rad = theta_m_rad - reference_rad
        if abs(error_rad) > self.max_error_rad and not self.has_tripped:
            self.has_tripped, self.error_rad, self.current_A = True, error_rad, current_A
        return self.has_tripped

    def words(self) -> str:
        """Return what was seen, with the remedy."""
        return (
            f"following error of {math.degrees(self.error_rad):+.2f} deg at {self.current_A:.3g} A, the limit is "
            f"{math.degrees(self.max_error_rad):.4g} deg: the load or the speed is too large for this limit "
            "(--max-following-error in degrees, limits.following_error_max_rad), or encoder and motor have opposite "
            "directions; without a load set the direction of the encoder in the drive, and calibrate again"
        )
