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
    speed_of_speed: float  # the same per unit of the speed at the start
    way_of_speed: float


class Line(NamedTuple):
    """A torque over a step."""

    mean: float
    slope: float


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
    # The speed is taken for a parabola with the speed and acceleration at the start and the speed at the end.
    begin, rise = sign * speed, (sign * push - first) / inertia_per_step
    bend = end - begin - rise
    dips = rise < 0.0 and -rise < 2.0 * bend and rise * rise > 4.0 * bend * begin
    if end > 0.0 and not dips:
        return sign * mean, sign * slope, MOVING
    opposite = levels.rest + (levels.backward if speed > 0.0 else levels.forward)
    holding = _holding(free_speed - r.speed_of_speed * speed, free_way - r.way_of_speed * speed, r)
    holding = Line(sign * holding.mean, sign * holding.slope)
    back_bend = bend + (first + opposite) * (r.speed_of_mean - 1.0 / inertia_per_step)
    more, fate = _turned(begin, rise, bend, back_bend, inertia_per_step, holding, first, opposite)
    return sign * (mean + more.mean), sign * (slope + more.slope), fate


@inlined
def _holding(free_speed: float, free_way: float, r: Response) -> Line:
    """Return the torque that would hold a mass at rest over the step, where it would have this motion without."""
    scale = r.way_of_mean * r.speed_of_slope - r.way_of_slope * r.speed_of_mean
    return Line(
        (free_way * r.speed_of_slope - free_speed * r.way_of_slope) / scale,
        (free_speed * r.way_of_mean - free_way * r.speed_of_mean) / scale,
    )


@inlined
def _turned(
    begin: float,
    rise: float,
    bend: float,
    back_bend: float,
    inertia_per_step: float,
    holding: Line,
    first: float,
    opposite: float,
) -> tuple[Line, int]:
    """Return what a stop or a reversal adds to the friction torque `first`, and the outcome.

    `begin`, `rise`, `bend`: of the parabola that the speed would be with that friction; `back_bend`: of the one that it
    is with `opposite`, once it has turned round; `holding`: what holds the mass at rest. The result is continuous, also
    where the speed at the start becomes 0: a jump would be divided by the step of a finite difference.
    """
    both = first + opposite
    steepness = math.sqrt(max(0.0, rise * rise - 4.0 * bend * begin))  # of the speed where it crosses zero
    there = min(1.0, 2.0 * begin / (steepness - rise))
    mean, moment, rests = 0.0, 0.0, there
    if inertia_per_step * steepness > both:  # it turns round, and perhaps once more
        rests = 1.0
        if back_bend > 0.0:
            rests = min(1.0, there + (inertia_per_step * steepness - both) / (inertia_per_step * back_bend))
        mean = -both * (rests - there)
        moment = 0.5 * mean * (there + rests - 1.0)
    if rests == 1.0:
        return Line(mean, 12.0 * moment), MOVING
    torque = holding.mean + holding.slope * (rests - 0.5)
    leaves = rests  # the share of the step at which friction can't hold it any more
    forward = torque > first
    if -opposite <= torque <= first:
        forward = holding.slope > 0.0
        leaves = 2.0
        if holding.slope != 0.0:
            leaves = 0.5 + ((first if forward else -opposite) - holding.mean) / holding.slope
        until = min(1.0, leaves)
        square, cube = until**2 - rests**2, until**3 - rests**3
        level = holding.mean - 0.5 * holding.slope - first
        mean += level * (until - rests) + 0.5 * holding.slope * square
        moment += level * 0.5 * (square - until + rests) + holding.slope * (cube / 3.0 - 0.25 * square)
    if leaves >= 1.0:
        return Line(mean, 12.0 * moment), STOPPED
    if not forward:
        mean -= both * (1.0 - leaves)
        moment -= 0.5 * both * (1.0 - leaves) * leaves
    return Line(mean, 12.0 * moment), MOVING


@inlined
def _held(free_speed: float, free_way: float, r: Response, levels: Levels) -> tuple[float, float, int]:
    """Return the friction that holds a mass, limited to its level.

    The torque that would hold it is a line over the step; where the line exceeds the level, the mass breaks away.
    """
    mean, slope = _holding(free_speed, free_way, r)
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
