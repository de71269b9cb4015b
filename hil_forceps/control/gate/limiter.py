"""The limits of the reference: position, speed, acceleration. Pure.

What passes, passes unchanged, or moved as little as the limits ask. With Δt the time between two outputs and
v = Δθ/Δt the speed of the later, for any requests and any times:

- low ≤ θ ≤ high,
- |v| ≤ speed_max,
- |v − v_before| ≤ acceleration_max·Δt,
- there is always room to brake: v² / (2 acceleration_max) ≤ distance to the bound ahead.

The last makes the others possible for ever: braking by acceleration_max·Δt at each step covers a lower Riemann sum of
the continuous braking, so never more than v²/(2a), whatever the steps. Bounds may change between steps as long as the
one ahead does not come nearer. The bounds hold exactly, all else up to the rounding of floats.
"""

from math import copysign, sqrt
from typing import Final

from hil_forceps.control.gate.verdicts import Bounds, GateVerdict, Motion, Step
from hil_forceps.rig.sections import Limits

# Looked up once: a member of an Enum costs as much as a call when asked for by its class, at every tick.
_PASSED: Final = GateVerdict.PASSED


class AccelerationLimiter:
    """Limits of speed and acceleration."""

    __slots__ = ("_acceleration", "_speed")

    def __init__(self, limits: Limits) -> None:
        self._speed, self._acceleration = limits.speed_max_rad_per_s, limits.acceleration_max_rad_per_s2

    def step(self, motion: Motion, requested_rad: float, dt_s: float, bounds: Bounds) -> Step:
        """Return the next motion and why; `requested_rad` is finite, `dt_s` positive, the position within bounds."""
        position, speed, _ = motion
        low, high = bounds
        change = self._acceleration * dt_s
        wanted = (requested_rad - position) / dt_s
        room = high - position if wanted > 0.0 else position - low
        # As `_stoppable_speed`, without the call, which each tick would make.
        stoppable = 2.0 * room / (dt_s + sqrt(dt_s * dt_s + 2.0 * room / self._acceleration))
        magnitude = abs(wanted)
        # Beside a bound of 1e-252 a distance rounds to nothing; the bounds hold exactly.
        if magnitude > stoppable or not low <= requested_rad <= high:
            verdict = GateVerdict.LIMITED_POSITION
        elif magnitude > self._speed:
            verdict = GateVerdict.LIMITED_SPEED
        elif abs(wanted - speed) > change:
            verdict = GateVerdict.LIMITED_ACCELERATION
        else:
            return (requested_rad, wanted, 0.0), _PASSED
        # A request out of reach is approached so that it could be stopped at, or the output would swing about it.
        towards = min(magnitude, stoppable, self._speed, self._stoppable_speed(abs(requested_rad - position), dt_s))
        # What the speed is now comes last: no other limit can ask for more braking than the acceleration allows.
        allowed = max(speed - change, min(speed + change, copysign(towards, wanted)))
        return (max(low, min(high, position + allowed * dt_s)), allowed, 0.0), verdict

    def _stoppable_speed(self, room_rad: float, dt_s: float) -> float:
        """Return the greatest v that after a step v·dt still can brake within the room: v dt + v²/(2a) = room."""
        # The textbook root −a dt + √(a² dt² + 2 a room) cancels when a is great; this is the same number.
        return 2.0 * room_rad / (dt_s + sqrt(dt_s * dt_s + 2.0 * room_rad / self._acceleration))
