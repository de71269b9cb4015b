"""From any motion that the gate reaches there is a stop within its limits, whatever is asked for and whenever."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from hil_forceps.control.gate.jerk import JerkLimiter, stop_of, stopping_acceleration
from hil_forceps.control.gate.verdicts import GateVerdict, Motion
from hil_forceps.rig.sections import Limits

# One of the three scales is free to choose: a motion with jerk 1 is any other in other units of time and angle.
speeds = st.floats(-1e3, 1e3)
shares = st.floats(-1.0, 1.0)
waits_s = st.floats(-6.0, 2.0).map(lambda exponent: 10.0**exponent)


@given(speeds, shares, st.floats(1e-2, 1e2), waits_s)
@settings(max_examples=1000)
def test_a_step_of_the_stop_leads_to_one_that_reaches_no_further(
    speed: float, share: float, acceleration_max: float, dt_s: float
) -> None:
    acceleration = share * acceleration_max
    before = stop_of(speed, acceleration, 1.0, acceleration_max)
    next_acceleration = stopping_acceleration(speed, acceleration, dt_s, 1.0, acceleration_max)
    assert abs(next_acceleration) <= acceleration_max
    assert abs(next_acceleration - acceleration) <= dt_s * (1 + 1e-9) + 1e-12 * acceleration_max
    next_speed = speed + next_acceleration * dt_s
    moved = next_speed * dt_s
    after = stop_of(next_speed, next_acceleration, 1.0, acceleration_max)
    rounding = 1e-9 * (before.highest_rad - before.lowest_rad + abs(moved)) + 1e-12
    assert before.lowest_rad - rounding <= min(moved, moved + after.lowest_rad)
    assert max(moved, moved + after.highest_rad) <= before.highest_rad + rounding
    assert after.speed_rad_per_s <= before.speed_rad_per_s * (1 + 1e-9) + 1e-12


limits = st.builds(
    lambda low, width, speed, acceleration: Limits(
        position_min_rad=low,
        position_max_rad=low + width,
        speed_max_rad_per_s=speed,
        acceleration_max_rad_per_s2=acceleration,
    ),
    st.floats(-10.0, 10.0),
    st.floats(1e-2, 20.0),
    st.floats(1e-1, 1e3),
    st.floats(1.0, 1e5),
)
jerks = st.floats(1.0, 8.0).map(lambda exponent: 10.0**exponent)
requests = st.one_of(st.floats(-30.0, 30.0), st.sampled_from([-1e300, 1e300, 0.0]), st.floats(-1e-2, 1e-2))
ticks_s = st.one_of(st.floats(0.9e-3, 1.1e-3), st.floats(1e-5, 2e-2))


@given(limits, jerks, st.floats(0.0, 1.0), st.lists(st.tuples(requests, ticks_s), max_size=60))
def test_limits_are_never_exceeded(
    given_limits: Limits, jerk: float, where: float, ticks: list[tuple[float, float]]
) -> None:
    low, high = given_limits.position_min_rad, given_limits.position_max_rad
    top, steepest = given_limits.speed_max_rad_per_s, given_limits.acceleration_max_rad_per_s2
    limiter = JerkLimiter(given_limits, jerk)
    motion: Motion = (min(high, low + where * (high - low)), 0.0, 0.0)
    for requested, dt_s in ticks:
        before = motion
        motion, verdict = limiter.step(motion, requested, dt_s, (low, high))
        position, speed, acceleration = motion
        assert low <= position <= high
        assert (verdict is GateVerdict.PASSED) <= (position == requested)
        assert abs(speed) <= top * (1 + 1e-9)
        assert abs(acceleration) <= steepest * (1 + 1e-9)
        assert abs(acceleration - before[2]) <= jerk * dt_s * (1 + 1e-9) + 1e-12 * steepest
        rounding = 4e-16 * (1.0 + abs(low) + abs(high))
        assert abs(position - before[0] - speed * dt_s) <= 4.0 * rounding + 1e-9 * (high - low)
        assert math.isclose(speed, before[1] + acceleration * dt_s, rel_tol=1e-9, abs_tol=1e-9 * top)
        stop = stop_of(speed, acceleration, jerk, steepest)
        assert low - 1e-9 * (high - low) <= position + stop.lowest_rad
        assert position + stop.highest_rad <= high + 1e-9 * (high - low)
        assert stop.speed_rad_per_s <= top * (1 + 1e-9)
