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


class Turning(NamedTuple):
    """The speed of a mass as a parabola over the step: its start, slope and bend, and what they come from."""

    begin: float
    rise: float
    bend: float
    back_bend: float  # with the friction of the other direction
    inertia_per_step: float
    speed_of_mean: float
    speed_of_slope: float
    first: float  # level of friction in the direction of `begin`
    opposite: float  # and against it


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
    to = Turning(begin, rise, bend, back_bend, inertia_per_step, r.speed_of_mean, r.speed_of_slope, first, opposite)
    end, moment = _turned(to, holding)
    slope += 12.0 * moment
    mean = (sign * free_speed - end - r.speed_of_slope * slope) / r.speed_of_mean
    return sign * mean, sign * slope, STOPPED if end == 0.0 else MOVING


@inlined
def _holding(free_speed: float, free_way: float, r: Response) -> Line:
    """Return the torque that would hold a mass at rest over the step, where it would have this motion without."""
    scale = r.way_of_mean * r.speed_of_slope - r.way_of_slope * r.speed_of_mean
    return Line(
        (free_way * r.speed_of_slope - free_speed * r.way_of_slope) / scale,
        (free_speed * r.way_of_mean - free_way * r.speed_of_mean) / scale,
    )


@inlined
def _turned(to: Turning, holding: Line) -> tuple[float, float]:
    """Return the speed at the end of a step in which a mass stops or turns round, and a moment of its friction.

    `holding`: the torque that holds it at rest. The moment is that of the change of friction, about the middle of the
    step. Both are continuous, also where the speed at the start becomes 0: a jump would be divided by the step of a
    finite difference.
    """
    both = to.first + to.opposite
    steepness = math.sqrt(max(0.0, to.rise * to.rise - 4.0 * to.bend * to.begin))  # of the speed where it crosses zero
    there = min(1.0, 2.0 * to.begin / (steepness - to.rise))
    moment, rests, back = 0.0, there, steepness - both / to.inertia_per_step
    if back > 0.0:  # it turns round, and perhaps once more
        rests = min(1.0, there + back / to.back_bend) if to.back_bend > 0.0 else 1.0
        moment = -0.5 * both * (rests - there) * (there + rests - 1.0)
        if rests == 1.0:
            return (to.back_bend * (1.0 - there) - back) * (1.0 - there), moment
    torque = holding.mean + holding.slope * (rests - 0.5)
    leaves = rests  # the share of the step at which friction can't hold it any more
    forward = torque > to.first
    if -to.opposite <= torque <= to.first:
        forward = holding.slope > 0.0
        leaves = 1.0
        if holding.slope != 0.0:
            leaves = min(1.0, 0.5 + ((to.first if forward else -to.opposite) - holding.mean) / holding.slope)
        square, cube = leaves**2 - rests**2, leaves**3 - rests**3
        level = holding.mean - 0.5 * holding.slope - to.first
        moment += level * 0.5 * (square - leaves + rests) + holding.slope * (cube / 3.0 - 0.25 * square)
    after, square, cube = 1.0 - leaves, 1.0 - leaves**2, 1.0 - leaves**3
    over = holding.mean - 0.5 * holding.slope - (to.first if forward else -to.opposite)
    speed = to.speed_of_mean * (over * after + 0.5 * holding.slope * square)
    speed += to.speed_of_slope * (6.0 * over * (square - after) + holding.slope * (4.0 * cube - 3.0 * square))
    if not forward:
        moment -= 0.5 * both * after * leaves
    if to.rise < 0.0 < to.bend and back < 0.0:
        # Where the parabola only just touches zero, it tells the speed. Where the mass turns, or was at rest before,
        # what holds it does.
        share = min(1.0, 4.0 * to.bend * to.begin / (to.rise * to.rise)) * -back * to.inertia_per_step / both
        beyond = max(0.0, 1.0 + 0.5 * to.rise / to.bend)
        speed += share * (to.bend * beyond * beyond - speed)
        moment *= 1.0 - share
    return speed, moment


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
