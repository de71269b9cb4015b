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

from math import copysign, isfinite, sqrt
from typing import Final

from hil_forceps.control.gate.kernel import Vector, kernel
from hil_forceps.control.gate.verdicts import Bounds, GateVerdict, Motion, Step
from hil_forceps.rig.sections import Limits

# Looked up once: a member of an Enum costs as much as a call when asked for by its class, at every tick.
_PASSED: Final = GateVerdict.PASSED
_POSITION: Final = GateVerdict.LIMITED_POSITION
_SPEED: Final = GateVerdict.LIMITED_SPEED
_ACCELERATION: Final = GateVerdict.LIMITED_ACCELERATION


class AccelerationLimiter:
    """Limits of speed and acceleration."""

    __slots__ = ("_acceleration", "_speed")

    def __init__(self, limits: Limits) -> None:
        self._speed, self._acceleration = limits.speed_max_rad_per_s, limits.acceleration_max_rad_per_s2

    def step(self, motion: Motion, requested_rad: float, dt_s: float, bounds: Bounds) -> Step:
        """Return the next motion and why; see `limited`."""
        return limited(motion, requested_rad, dt_s, bounds, self._speed, self._acceleration)

    def passing(self, motion: Motion, requested_rad: Vector, dt_s: float, bounds: Bounds) -> tuple[int, Motion]:
        """Return how many requests in a row, `dt_s` apart, pass as they are, and the motion after them."""
        return passing_requests(motion, requested_rad, dt_s, bounds, self._speed, self._acceleration)


def limited(
    motion: Motion, requested_rad: float, dt_s: float, bounds: Bounds, speed_max: float, acceleration_max: float
) -> Step:
    """Return the next motion and why; `requested_rad` is finite, `dt_s` positive, the position within bounds.

    Plain numbers in and out, so that it can be compiled, too.
    """
    position, speed, _ = motion
    low, high = bounds
    change = acceleration_max * dt_s
    wanted = (requested_rad - position) / dt_s
    room = high - position if wanted > 0.0 else position - low
    # The greatest v that after a step v·dt still can brake within the room: v dt + v²/(2a) = room. The textbook root
    # −a dt + √(a² dt² + 2 a room) cancels when a is great; this is the same number.
    stoppable = 2.0 * room / (dt_s + sqrt(dt_s * dt_s + 2.0 * room / acceleration_max))
    magnitude = abs(wanted)
    # Beside a bound of 1e-252 a distance rounds to nothing; the bounds hold exactly.
    if magnitude > stoppable or not low <= requested_rad <= high:
        verdict = _POSITION
    elif magnitude > speed_max:
        verdict = _SPEED
    elif abs(wanted - speed) > change:
        verdict = _ACCELERATION
    else:
        return (requested_rad, wanted, 0.0), _PASSED
    # A request out of reach is approached so that it could be stopped at, or the output would swing about it.
    way = abs(requested_rad - position)
    to_stop_there = 2.0 * way / (dt_s + sqrt(dt_s * dt_s + 2.0 * way / acceleration_max))
    towards = min(magnitude, stoppable, speed_max, to_stop_there)
    # What the speed is now comes last: no other limit can ask for more braking than the acceleration allows.
    allowed = max(speed - change, min(speed + change, copysign(towards, wanted)))
    return (max(low, min(high, position + allowed * dt_s)), allowed, 0.0), verdict


_limited: Final = kernel(limited)


@kernel
def passing_requests(
    motion: Motion, requested_rad: Vector, dt_s: float, bounds: Bounds, speed_max: float, acceleration_max: float
) -> tuple[int, Motion]:
    """Return how many requests in a row, `dt_s` apart, are finite and within all limits, and the motion after them."""
    passed = 0
    for request in requested_rad:
        if not isfinite(request):
            break
        after, verdict = _limited(motion, request, dt_s, bounds, speed_max, acceleration_max)
        if verdict != _PASSED:
            break
        motion = after
        passed += 1
    return passed, motion
