"""The limits of the reference with one of its jerk, too. Pure.

With Δt the time between two outputs, v = Δθ/Δt and a = Δv/Δt: besides the limits of `limiter`, |a| ≤ acceleration_max
and |a − a_before| ≤ jerk_max·Δt, for any requests and any times.

From every motion that is reached there is a stop within all limits, and the next step of that stop is always known
(`stopping_acceleration`). A request passes if such a stop exists behind it. Else the step goes as far from the stop's
own towards the request as one still exists.

The stop is the shortest one of continuous time: jerk until the acceleration brakes at its limit, then jerk the other
way so that speed and acceleration end together. A step of it in discrete time, Δt long whatever Δt is, takes the
acceleration at its end for all of it, so it brakes earlier than the continuous one and reaches no further:
`tests/property/test_gate_jerk.py`.
"""

import math
from typing import Final, NamedTuple

from hil_forceps.control.gate.verdicts import Bounds, GateVerdict, Motion, Step
from hil_forceps.rig.sections import Limits

HALVINGS: Final = 24  # of the way between the stop's step and the request: 1e-7 of it is left


class Stop(NamedTuple):
    """Where a stop leads, relative to where it begins, and its greatest speed."""

    lowest_rad: float
    highest_rad: float
    speed_rad_per_s: float


def stop_of(speed: float, acceleration: float, jerk_max: float, acceleration_max: float) -> Stop:
    """Return the shortest stop from a motion."""
    if _turns_back(speed, acceleration, jerk_max):
        mirrored = stop_of(-speed, -acceleration, jerk_max, acceleration_max)
        return Stop(-mirrored.highest_rad, -mirrored.lowest_rad, mirrored.speed_rad_per_s)
    # As if it came from, or went on to, the speed that it has where the acceleration is zero.
    crest = speed + acceleration * acceleration / (2.0 * jerk_max)
    if crest * jerk_max < acceleration_max * acceleration_max:
        from_crest = crest * math.sqrt(crest / jerk_max)
    else:
        from_crest = 0.5 * crest * (crest / acceleration_max + acceleration_max / jerk_max)
    end = from_crest + acceleration / jerk_max * (crest - acceleration * acceleration / (6.0 * jerk_max))
    lowest = 0.0
    if speed < 0.0:
        turns_s = (acceleration - math.sqrt(max(0.0, acceleration * acceleration + 2.0 * jerk_max * speed))) / jerk_max
        lowest = turns_s * (speed + turns_s * (0.5 * acceleration - turns_s * jerk_max / 6.0))
    return Stop(min(lowest, end), max(0.0, end), max(abs(speed), crest) if acceleration > 0.0 else speed)


def stopping_acceleration(
    speed: float, acceleration: float, dt_s: float, jerk_max: float, acceleration_max: float
) -> float:
    """Return the acceleration of the stop's next step, `dt_s` long."""
    if _turns_back(speed, acceleration, jerk_max):
        return -stopping_acceleration(-speed, -acceleration, dt_s, jerk_max, acceleration_max)
    # With this acceleration of the other sign, eased off from then on, speed ends together with it.
    ease = 2.0 * abs(speed) / (dt_s + math.sqrt(dt_s * dt_s + 2.0 * abs(speed) / jerk_max))
    return max(acceleration - jerk_max * dt_s, -acceleration_max, -math.copysign(ease, speed))


def _turns_back(speed: float, acceleration: float, jerk_max: float) -> bool:
    """Tell whether a motion goes down by the time its acceleration could be zero."""
    return speed + acceleration * abs(acceleration) / (2.0 * jerk_max) < 0.0


class JerkLimiter:
    """Limits of speed, acceleration and jerk."""

    __slots__ = ("_acceleration", "_jerk", "_speed")

    def __init__(self, limits: Limits, jerk_max_rad_per_s3: float) -> None:
        self._speed, self._acceleration = limits.speed_max_rad_per_s, limits.acceleration_max_rad_per_s2
        self._jerk = jerk_max_rad_per_s3

    def step(self, motion: Motion, requested_rad: float, dt_s: float, bounds: Bounds) -> Step:
        """Return the next motion and why."""
        position, speed, acceleration = motion
        wanted_speed = (requested_rad - position) / dt_s
        wanted = (wanted_speed - speed) / dt_s
        asked = (requested_rad, wanted_speed, wanted)
        verdict = self._judge(motion, asked, dt_s, bounds)
        if verdict is GateVerdict.PASSED:
            return asked, verdict
        safe = stopping_acceleration(speed, acceleration, dt_s, self._jerk, self._acceleration)
        change = self._jerk * dt_s
        best = max(acceleration - change, -self._acceleration, min(acceleration + change, self._acceleration, wanted))
        # A request out of reach is approached so that it could be stopped at, or the output would swing about it.
        low, high = bounds
        nearer = (low, min(high, requested_rad)) if wanted_speed > 0.0 else (max(low, requested_rad), high)
        return self._nearest(motion, safe, best, dt_s, bounds, nearer), verdict

    def _judge(self, motion: Motion, asked: Motion, dt_s: float, bounds: Bounds) -> GateVerdict:
        position, speed, acceleration = asked
        low, high = bounds
        if not low <= position <= high:
            return GateVerdict.LIMITED_POSITION
        if abs(speed) > self._speed:
            return GateVerdict.LIMITED_SPEED
        if abs(acceleration) > self._acceleration:
            return GateVerdict.LIMITED_ACCELERATION
        if abs(acceleration - motion[2]) > self._jerk * dt_s:
            return GateVerdict.LIMITED_JERK
        stop = stop_of(speed, acceleration, self._jerk, self._acceleration)
        if stop.speed_rad_per_s > self._speed:
            return GateVerdict.LIMITED_SPEED
        return GateVerdict.PASSED if _is_within(position, stop, bounds) else GateVerdict.LIMITED_POSITION

    def _nearest(self, motion: Motion, safe: float, best: float, dt_s: float, bounds: Bounds, nearer: Bounds) -> Motion:
        """Return the motion whose acceleration is nearest to `best` and that still can stop within `nearer`."""
        if self._can_stop(motion, safe, dt_s, nearer):
            if self._can_stop(motion, best, dt_s, nearer):
                safe = best
            else:
                for _ in range(HALVINGS):
                    between = 0.5 * (safe + best)
                    if self._can_stop(motion, between, dt_s, nearer):
                        safe = between
                    else:
                        best = between
        (position, speed, acceleration), (low, high) = _moved(motion, safe, dt_s), bounds
        return max(low, min(high, position)), speed, acceleration

    def _can_stop(self, motion: Motion, acceleration: float, dt_s: float, bounds: Bounds) -> bool:
        position, speed, _ = _moved(motion, acceleration, dt_s)
        stop = stop_of(speed, acceleration, self._jerk, self._acceleration)
        return stop.speed_rad_per_s <= self._speed and _is_within(position, stop, bounds)


def _moved(motion: Motion, acceleration: float, dt_s: float) -> Motion:
    position, speed, _ = motion
    speed += acceleration * dt_s
    return position + speed * dt_s, speed, acceleration


def _is_within(position: float, stop: Stop, bounds: Bounds) -> bool:
    low, high = bounds
    return low <= position + stop.lowest_rad and position + stop.highest_rad <= high
