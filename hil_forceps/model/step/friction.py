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
    """A torque over a step, by its mean and slope."""

    mean: float
    slope: float


class Crossing(NamedTuple):
    """A speed that crosses zero: a parabola over the step, by its value, slope and bend, and what acts on the mass."""

    begin: float
    rise: float
    bend: float
    back_bend: float  # once friction acts in the other direction
    inertia_per_step: float
    forward_level: float  # of friction against the speed at the start
    backward_level: float  # and against the opposite speed


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
    crossing = Crossing(begin, rise, bend, back_bend, inertia_per_step, first, opposite)
    end, more_slope = _end_behind(crossing, holding, r)
    slope += more_slope
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
def _part(torque: Line, less: float, first: float, last: float) -> Line:
    """Return mean and slope of a torque less a constant, from the share `first` of the step to `last`; else it is 0."""
    length, square, cube = last - first, last**2 - first**2, last**3 - first**3
    start = torque.mean - 0.5 * torque.slope - less
    return Line(
        start * length + 0.5 * torque.slope * square,
        6.0 * start * (square - length) + torque.slope * (4.0 * cube - 3.0 * square),
    )


@inlined
def _end_behind(c: Crossing, holding: Line, r: Response) -> tuple[float, float]:
    """Return the speed at the end of a step in which a mass stops or turns round, and what slope its friction gains.

    `holding`: the torque that holds it at rest. Both results are continuous, also where the speed at the start becomes
    0: a finite difference would divide a jump by its step.
    """
    both = c.forward_level + c.backward_level
    steepness = math.sqrt(max(0.0, c.rise * c.rise - 4.0 * c.bend * c.begin))  # of the speed where it crosses zero
    crosses = min(1.0, 2.0 * c.begin / (steepness - c.rise))  # shares of the step: here, ...
    rests, back, slope = crosses, steepness - both / c.inertia_per_step, 0.0
    if back > 0.0:  # it turns round, and perhaps once more
        rests = min(1.0, crosses + back / c.back_bend) if c.back_bend > 0.0 else 1.0
        slope = _part(Line(-both, 0.0), 0.0, crosses, rests).slope
        if rests == 1.0:
            return (c.back_bend * (1.0 - crosses) - back) * (1.0 - crosses), slope
    leaves = rests  # ... and where friction can't hold it any more
    torque = holding.mean + holding.slope * (rests - 0.5)
    forward = torque > c.forward_level
    if -c.backward_level <= torque <= c.forward_level:
        forward, leaves = holding.slope > 0.0, 1.0
        if holding.slope != 0.0:
            level = c.forward_level if forward else -c.backward_level
            leaves = min(1.0, 0.5 + (level - holding.mean) / holding.slope)
        slope += _part(holding, c.forward_level, rests, leaves).slope
    if not forward:
        slope += _part(Line(-both, 0.0), 0.0, leaves, 1.0).slope
    over = _part(holding, c.forward_level if forward else -c.backward_level, leaves, 1.0)
    speed = r.speed_of_mean * over.mean + r.speed_of_slope * over.slope
    if c.rise < 0.0 < c.bend and back < 0.0:
        # Where the parabola only just touches zero, it tells the speed. Where the mass turns, or was at rest before,
        # what holds it does. Between, both have a share.
        share = min(1.0, 4.0 * c.bend * c.begin / (c.rise * c.rise)) * -back * c.inertia_per_step / both
        beyond = max(0.0, 1.0 + 0.5 * c.rise / c.bend)
        speed += share * (c.bend * beyond * beyond - speed)
        slope *= 1.0 - share
    return speed, slope


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
