"""Dry friction over one step of a linear system, with the instant of a reversal or a stop inside the step.

Torques over a step are given by two numbers: their mean, and the slope of the line that has the same first moment. A
torque that is a over the share s of the step and c from there on has the mean a s + c (1 − s) and the slope
6 (c − a) s (1 − s).
"""

import math
from typing import NamedTuple

from hil_forceps.model.kernel import inlined

MOVING, STOPPED, STUCK = 0, 1, 2


class Response(NamedTuple):
    """Response to a torque over a step: speed and displacement at its end, per unit of its mean and slope."""

    speed_of_mean: float
    speed_of_slope: float
    way_of_mean: float
    way_of_slope: float


class Levels(NamedTuple):
    """Levels of dry friction over a step."""

    start: float
    end: float
    rest: float  # at standstill
    forward: float  # in addition, for a positive speed
    backward: float  # in addition, for a negative speed


@inlined
def friction(
    speed: float, free_speed: float, free_way: float, push: float, inertia_per_step: float, r: Response, levels: Levels
) -> tuple[float, float, int]:
    """Return mean and slope of the friction torque (positive: brakes a positive speed), and the outcome.

    The outcome is `MOVING`, `STOPPED` or `STUCK`. `speed`: at the start, exactly 0 while stuck; `free_speed` and
    `free_way`: at the end of the step without friction; `push`: torque at the start without friction;
    `inertia_per_step`: I/h.
    """
    if speed == 0.0:
        return _held(free_speed, free_way, r, levels)
    sign = 1.0 if speed > 0.0 else -1.0
    extra = levels.forward if speed > 0.0 else levels.backward
    first, last = levels.start + extra, levels.end + extra
    mean, slope = 0.5 * (first + last), last - first
    end = sign * free_speed - r.speed_of_mean * mean - r.speed_of_slope * slope
    if end > 0.0:
        return sign * mean, sign * slope, MOVING
    # Where the speed crosses zero, as a parabola with the speed and acceleration at the start and the speed at the end.
    begin, rise = sign * speed, (sign * push - first) / inertia_per_step
    bend = end - begin - rise
    share = min(1.0, 2.0 * begin / (math.sqrt(max(0.0, rise * rise - 4.0 * bend * begin)) - rise))
    there = first + (last - first) * share
    push_there = inertia_per_step * (rise + 2.0 * bend * share) + there
    before = 0.5 * (first + there)
    rest = 1.0 - share
    opposite = levels.rest + (levels.backward if speed > 0.0 else levels.forward)
    fate = MOVING
    after = -opposite
    if push_there >= -opposite:  # it can't reverse: friction from there on ends at standstill
        fate = STOPPED
        effect = rest * (r.speed_of_mean + 6.0 * r.speed_of_slope * share)
        after = before
        if effect > 0.0:
            needed = sign * free_speed - before * share * (r.speed_of_mean - 6.0 * r.speed_of_slope * rest)
            after = max(-opposite, min(levels.rest + extra, needed / effect))
    mean, slope = before * share + after * rest, 6.0 * (after - before) * share * rest
    return sign * mean, sign * slope, fate


@inlined
def _held(free_speed: float, free_way: float, r: Response, levels: Levels) -> tuple[float, float, int]:
    """Return the friction that holds a mass, limited to its level.

    The torque that would hold it is a line over the step; where the line exceeds the level, the mass breaks away.
    """
    scale = r.way_of_mean * r.speed_of_slope - r.way_of_slope * r.speed_of_mean
    mean = (free_way * r.speed_of_slope - free_speed * r.way_of_slope) / scale
    slope = (free_speed * r.way_of_mean - free_way * r.speed_of_mean) / scale
    last = mean + 0.5 * slope
    sign = 1.0 if last > 0.0 else -1.0
    level = levels.rest + (levels.forward if last > 0.0 else levels.backward)
    first, rise = sign * (mean - 0.5 * slope), sign * slope
    if sign * last > level >= first:
        rest = 1.0 - (level - first) / rise  # share of the step after breakaway
        over, moment = 0.5 * rise * rest * rest, rise * rest * rest * (0.25 - rest / 6.0)
        return mean - sign * over, slope - sign * 12.0 * moment, MOVING
    level = levels.rest + (levels.forward if mean > 0.0 else levels.backward)
    if abs(mean) <= level:
        return mean, slope, STUCK
    return (level if mean > 0.0 else -level), 0.0, MOVING
