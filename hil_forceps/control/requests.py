"""Whether a trajectory of the jaw asks for more than the gate lets pass, as far as that is known beforehand.

Known is the angle of the motor without the wire's elongation, r_j θ_j / r_m; what compensates it comes on top. Nothing
is asked of the acceleration: lines between points have corners.
"""

from typing import Final, NamedTuple

from hil_forceps.control.compensator import motor_reference_rad
from hil_forceps.control.trajectories import Trajectory
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import Limits

ROUNDING_ERROR_SHARE: Final = 1e-9  # of a limit that was written with the digits of the trajectory's own


class Excess(NamedTuple):
    """A request that the gate would cut: at which point of the trajectory, of what, how much."""

    point: int
    time_s: float
    key: str  # of `limits:`
    asked: float
    limit: float

    @property
    def words(self) -> str:
        """The same for a user, without the trajectory's name."""
        unit = "rad/s" if self.key.endswith("_per_s") else "rad"
        return (
            f"at {self.time_s:g} s the motor reference is {self.asked:.4g} "
            f"{unit} (r_j/r_m times that of the jaw), beyond limits.{self.key} of {self.limit:g}"
        )


def first_excess(trajectory: Trajectory, until_s: float, plant: PlantParameters, limits: Limits) -> Excess | None:
    """Return the first point before `until_s` whose angle, or the speed towards it, is beyond the limits."""
    before: tuple[float, float] | None = None
    for point, (time_s, angle_rad) in enumerate(zip(trajectory.times_s, trajectory.angles_rad, strict=True)):
        if before is not None and before[0] >= until_s:
            return None
        theta = motor_reference_rad(angle_rad, 0.0, plant)
        speed = 0.0 if before is None else abs(theta - before[1]) / (time_s - before[0])
        if speed > limits.speed_max_rad_per_s * (1.0 + ROUNDING_ERROR_SHARE):
            return Excess(point, time_s, "speed_max_rad_per_s", speed, limits.speed_max_rad_per_s)
        if time_s > until_s:  # the run ends on the way there
            theta = motor_reference_rad(trajectory(until_s), 0.0, plant)
        low, high = limits.position_min_rad, limits.position_max_rad
        slack = ROUNDING_ERROR_SHARE * max(abs(low), abs(high))
        if theta > high + slack:
            return Excess(point, time_s, "position_max_rad", theta, high)
        if theta < low - slack:
            return Excess(point, time_s, "position_min_rad", theta, low)
        before = (time_s, theta)
    return None
