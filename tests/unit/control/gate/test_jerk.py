"""Jerk of the reference: the stop, its steps, and values densely on both sides of every limit."""

import itertools
import math

import pytest

from hil_forceps.control.gate.jerk import JerkLimiter, stop_of, stopping_acceleration
from hil_forceps.control.gate.verdicts import Bounds, GateVerdict, Motion, Step
from hil_forceps.rig.sections import Limits

DT_S = 1e-3
JERK = 1e5
LIMITS = Limits(
    position_min_rad=-1.0, position_max_rad=2.0, speed_max_rad_per_s=10.0, acceleration_max_rad_per_s2=1000.0
)
BOUNDS: Bounds = (-1.0, 2.0)
LIMITER = JerkLimiter(LIMITS, JERK)


def limit(motion: Motion, requested: float, dt_s: float = DT_S, bounds: Bounds = BOUNDS) -> Step:
    return LIMITER.step(motion, requested, dt_s, bounds)


def simulated_stop(speed: float, acceleration: float, jerk: float, acceleration_max: float) -> tuple[float, ...]:
    """Lowest and highest place and the greatest speed of the stop, by small steps of `stopping_acceleration`."""
    position = lowest = highest = 0.0
    fastest, dt_s = abs(speed), 1e-4
    for _ in range(1_000_000):
        acceleration = stopping_acceleration(speed, acceleration, dt_s, jerk, acceleration_max)
        speed += acceleration * dt_s
        position += speed * dt_s
        lowest, highest, fastest = min(lowest, position), max(highest, position), max(fastest, abs(speed))
        if abs(speed) < 1e-7 and abs(acceleration) < 1e-3:
            break
    return lowest, highest, fastest


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("acceleration_max", [0.5, 2.0, 50.0])
@pytest.mark.parametrize(
    ("speed", "acceleration"),
    [
        *((1.0, a) for a in (-0.5, -0.3, 0.0, 0.4, 0.5)),
        *((0.02, a) for a in (-0.5, -0.25, -0.1, 0.0, 0.5)),
        *((0.0, a) for a in (-0.5, 0.5)),
        *((6.0, a) for a in (-0.5, 0.0, 0.5)),
        (0.0, 0.0),
    ],
)
def test_the_closed_form_is_where_small_steps_lead(
    speed: float, acceleration: float, acceleration_max: float, sign: float
) -> None:
    speed, acceleration = sign * speed, sign * acceleration
    lowest, highest, fastest = simulated_stop(speed, acceleration, 2.0, acceleration_max)
    stop = stop_of(speed, acceleration, 2.0, acceleration_max)
    assert stop.lowest_rad == pytest.approx(lowest, abs=5e-4 * (1.0 + abs(lowest)))
    assert stop.highest_rad == pytest.approx(highest, abs=5e-4 * (1.0 + abs(highest)))
    assert stop.speed_rad_per_s == pytest.approx(fastest, abs=1e-3)


def test_stops_known_in_closed_form() -> None:
    # From speed 4 without acceleration, jerk 1: triangle of 2 √4 s; with the acceleration limited to 1: 2.5 trapezoids.
    assert stop_of(4.0, 0.0, 1.0, 10.0) == pytest.approx((0.0, 8.0, 4.0))
    assert stop_of(4.0, 0.0, 1.0, 2.0) == pytest.approx((0.0, 8.0, 4.0))
    assert stop_of(4.0, 0.0, 1.0, 1.0) == pytest.approx((0.0, 10.0, 4.0))
    assert stop_of(-4.0, 0.0, 1.0, 1.0) == pytest.approx((-10.0, 0.0, 4.0))
    assert stop_of(0.5, -1.0, 1.0, 10.0) == pytest.approx((0.0, 1.0 / 6.0, 0.5))  # easing off, to the end
    assert stop_of(-0.5, 1.0, 1.0, 10.0) == pytest.approx((-1.0 / 6.0, 0.0, 0.5))
    assert stop_of(0.0, 1.0, 1.0, 10.0) == pytest.approx((0.0, 0.5**1.5 + 0.5 - 1.0 / 6.0, 0.5))
    assert stop_of(0.0, 0.0, 1.0, 1.0) == (0.0, 0.0, 0.0)
    # Turning back: speed is 0 after 0.5 s, 1/12 down; then a crest of 1/8, and from there to rest.
    assert stop_of(-0.375, 1.0, 1.0, 10.0) == pytest.approx((-1.0 / 12.0, 0.125**1.5 - 1.0 / 24.0, 0.375))
    assert stop_of(0.375, -1.0, 1.0, 10.0) == pytest.approx((-(0.125**1.5) + 1.0 / 24.0, 1.0 / 12.0, 0.375))
    # The same in other units: jerk 8, so times are halved where lengths stay.
    assert stop_of(-0.75, 4.0, 8.0, 10.0) == pytest.approx((-1.0 / 12.0, 0.125**1.5 - 1.0 / 24.0, 0.75))
    assert stop_of(-0.125, 1.0, 1.0, 10.0).speed_rad_per_s == pytest.approx(0.375)  # the crest, where that is faster


def test_the_step_of_a_stop_is_known_in_closed_form() -> None:
    assert stopping_acceleration(4.0, 0.0, 0.5, 1.0, 10.0) == -0.5  # as much jerk as there is
    assert stopping_acceleration(4.0, 0.5, 0.25, 1.0, 10.0) == 0.25
    assert stopping_acceleration(4.0, -1.0, 0.5, 1.0, 1.25) == -1.25  # as much acceleration as there is
    assert stopping_acceleration(0.5, -1.0, 0.5, 1.0, 10.0) == pytest.approx(-0.5 * (math.sqrt(5.0) - 1.0))  # easing
    assert stopping_acceleration(-4.0, 0.0, 0.5, 1.0, 10.0) == 0.5
    assert stopping_acceleration(-0.5, 1.0, 0.5, 1.0, 10.0) == pytest.approx(0.5 * (math.sqrt(5.0) - 1.0))
    assert stopping_acceleration(0.0, 0.0, 0.5, 1.0, 10.0) == 0.0


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("before", [-850.0, -50.0, 0.0, 50.0, 850.0])
@pytest.mark.parametrize("over", [-1e-3, -1e-6, 1e-6, 1e-3])
def test_jerk_limit_from_both_sides(sign: float, before: float, over: float) -> None:
    acceleration = before + sign * (100.0 + over)
    requested = 0.5 + (1.0 + acceleration * DT_S) * DT_S
    motion, verdict = limit((0.5, 1.0, before), requested)
    if over < 0.0:
        assert (motion[0], verdict) == (requested, GateVerdict.PASSED)
        assert motion[2] == pytest.approx(acceleration, abs=1e-7)
    else:
        assert verdict is GateVerdict.LIMITED_JERK
        assert abs(motion[2] - before) <= 100.0 * (1 + 1e-12)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("over", [-1e-3, -1e-6, 1e-6, 1e-3, 50.0])
def test_acceleration_limit_from_both_sides(sign: float, over: float) -> None:
    acceleration = sign * (1000.0 + over)
    requested = 0.5 + (acceleration * DT_S) * DT_S
    motion, verdict = limit((0.5, 0.0, sign * 950.0), requested)
    assert verdict is (GateVerdict.PASSED if over < 0.0 else GateVerdict.LIMITED_ACCELERATION)
    assert abs(motion[2]) <= 1000.0 * (1 + 1e-12)
    far, verdict = limit((0.5, 0.0, sign * 950.0), 0.5 + sign * 0.4)
    assert verdict is GateVerdict.LIMITED_SPEED
    assert far[2] == pytest.approx(sign * 1000.0)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("over", [-1e-6, -1e-9, 1e-9, 1e-6])
def test_speed_limit_from_both_sides(sign: float, over: float) -> None:
    requested = 0.5 + sign * (10.0 + over) * DT_S
    motion, verdict = limit((0.5, sign * 9.99, 0.0), requested)
    # Speeding up to within a hair of the limit can't end there: easing off takes a little more.
    assert verdict is GateVerdict.LIMITED_SPEED
    assert abs(motion[1]) <= 10.0
    motion, verdict = limit((0.5, sign * (10.0 + over), 0.0), requested)
    assert verdict is (GateVerdict.PASSED if over < 0.0 else GateVerdict.LIMITED_SPEED)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("over", [-1e-6, 1e-6])
def test_the_speed_that_easing_off_still_leads_to_counts(sign: float, over: float) -> None:
    """v + a²/(2 j) ≤ speed_max, with a of the step that is asked for."""
    acceleration = 500.0
    speed = 10.0 - acceleration * acceleration / (2.0 * JERK) + over
    requested = sign * speed * DT_S
    verdict = limit((0.0, sign * (speed - acceleration * DT_S), sign * acceleration), requested)[1]
    assert verdict is (GateVerdict.PASSED if over < 0.0 else GateVerdict.LIMITED_SPEED)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_what_is_exactly_at_a_limit_passes(sign: float) -> None:
    """In binary fractions, which floats carry exactly."""
    dt_s, limits = 2.0**-10, LIMITS.model_copy(update={"acceleration_max_rad_per_s2": 1024.0})
    limiter = JerkLimiter(limits, 2.0**17)
    at_full_speed: Motion = (0.5, sign * 10.0, 0.0)
    ahead: Motion = (0.5 + sign * 10.0 * dt_s, sign * 10.0, 0.0)
    assert limiter.step(at_full_speed, ahead[0], dt_s, BOUNDS) == (ahead, GateVerdict.PASSED)
    assert limiter.step(at_full_speed, sign * 9.0, dt_s, (-9.0, 9.0)) == (ahead, GateVerdict.LIMITED_SPEED)
    faster: Motion = (0.5 + sign * dt_s, sign * 1.0, sign * 1024.0)
    assert limiter.step((0.5, 0.0, sign * 896.0), faster[0], dt_s, BOUNDS) == (faster, GateVerdict.PASSED)


@pytest.mark.parametrize(("bound", "outward"), [(2.0, 1.0), (-1.0, -1.0)])
@pytest.mark.parametrize("over", [-1e-6, -1e-9, 1e-9, 1e-6, 1.0])
def test_bounds_from_both_sides(bound: float, outward: float, over: float) -> None:
    """A request whose stop ends just this side of a bound passes, and beyond it does not."""
    room = stop_of(2.0, 0.0, JERK, 1000.0).highest_rad
    begin = bound - outward * (room + 2.0 * DT_S - over)
    motion, verdict = limit((begin, outward * 2.0, 0.0), begin + outward * 2.0 * DT_S)
    if over < 0.0:
        assert verdict is GateVerdict.PASSED
    else:
        assert verdict is GateVerdict.LIMITED_POSITION
        assert -1.0 <= motion[0] <= 2.0


@pytest.mark.parametrize(("bound", "outward"), [(2.0, 1.0), (-1.0, -1.0)])
def test_a_request_beyond_a_bound_is_one_of_position(bound: float, outward: float) -> None:
    assert limit((bound, 0.0, 0.0), bound) == ((bound, 0.0, 0.0), GateVerdict.PASSED)
    motion, verdict = limit((bound, 0.0, 0.0), math.nextafter(bound, outward * math.inf))
    assert (motion[0], verdict) == (bound, GateVerdict.LIMITED_POSITION)
    motion, verdict = limit((bound - outward * 0.5, 0.0, 0.0), bound + outward)
    assert verdict is GateVerdict.LIMITED_POSITION
    assert motion[2] == pytest.approx(outward * 100.0)  # as fast as may be all the same


@pytest.mark.parametrize(("bound", "outward"), [(2.0, 1.0), (-1.0, -1.0)])
def test_brakes_in_time_whatever_is_asked(bound: float, outward: float) -> None:
    motion: Motion = (bound - outward * 0.5, 0.0, 0.0)
    positions = []
    for _ in range(400):
        motion, verdict = limit(motion, bound + outward * 5.0)
        positions.append(motion[0])
    assert all(-1.0 <= position <= 2.0 for position in positions)
    assert abs(positions[-1] - bound) < 1e-4
    assert max(abs(b - a) for a, b in itertools.pairwise(positions)) > 9.9e-3  # it did use the room
    assert verdict is GateVerdict.LIMITED_POSITION


@pytest.mark.parametrize("target", [0.8, -0.8])
def test_a_jump_is_approached_without_swinging(target: float) -> None:
    motion: Motion = (0.0, 0.0, 0.0)
    positions = []
    for _ in range(300):
        motion, _ = limit(motion, target)
        positions.append(motion[0])
    assert positions[-1] == pytest.approx(target, abs=1e-6)
    assert max(abs(position) for position in positions) <= 0.8 + 1e-6
    # The shortest way there takes 110 ms: 0.08 s at full speed, and each ramp 20 ms with its rounded corners.
    assert next(k for k, position in enumerate(positions) if abs(position) > 0.79) <= 120


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_too_near_a_target_it_brakes_as_hard_as_it_can(sign: float) -> None:
    motion, _ = limit((0.0, sign * 5.0, 0.0), sign * 1e-3)
    assert motion[2] == pytest.approx(-sign * 100.0)


def test_a_motion_that_cannot_stop_in_time_stays_within_the_bounds() -> None:
    assert limit((1.999, 9.0, 0.0), 2.5)[0][0] == 2.0
    assert limit((-0.999, -9.0, 0.0), -2.5)[0][0] == -1.0


@pytest.mark.parametrize("rate_Hz", [0.5, 2.0])
def test_a_smooth_motion_within_the_limits_passes_bit_for_bit(rate_Hz: float) -> None:
    """A sine through all signs of speed and acceleration, begun from rest."""
    omega, motion = 2.0 * math.pi * rate_Hz, (0.5, 0.0, 0.0)
    for tick in range(1, 2000):
        t_s = tick * DT_S
        requested = 0.5 + 0.4 * (1.0 - math.exp(-((5.0 * t_s) ** 3))) * math.sin(omega * t_s)
        motion, verdict = limit(motion, requested)
        assert (motion[0], verdict) == (requested, GateVerdict.PASSED), tick
