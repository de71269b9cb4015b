"""Position, speed and acceleration of the reference: values densely on both sides of every limit."""

import itertools
import math

import pytest

from hil_forceps.control.gate.limiter import AccelerationLimiter
from hil_forceps.control.gate.verdicts import Bounds, GateVerdict, Motion, Step
from hil_forceps.rig.sections import Limits

DT_S = 1e-3
LIMITS = Limits(
    position_min_rad=-1.0, position_max_rad=2.0, speed_max_rad_per_s=10.0, acceleration_max_rad_per_s2=1000.0
)
BOUNDS: Bounds = (-1.0, 2.0)
LIMITER = AccelerationLimiter(LIMITS)


def limit(position: float, speed: float, requested: float, dt_s: float = DT_S) -> Step:
    return LIMITER.step((position, speed, 0.0), requested, dt_s, BOUNDS)


def run(motion: Motion, requested: float, ticks: int) -> tuple[list[float], GateVerdict]:
    positions, verdict = [motion[0]], GateVerdict.PASSED
    for _ in range(ticks):
        motion, verdict = LIMITER.step(motion, requested, DT_S, BOUNDS)
        positions.append(motion[0])
    return positions, verdict


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("over", [-1e-6, -1e-9, 0.0, 1e-9, 1e-6, 1e-3, 0.1])
def test_speed_limit_from_both_sides(sign: float, over: float) -> None:
    asked = sign * (10.0 + over)
    motion, verdict = limit(0.0, sign * 9.5, asked * 1e-3)
    if over <= 0.0:
        assert (motion, verdict) == ((asked * 1e-3, asked * 1e-3 / 1e-3, 0.0), GateVerdict.PASSED)
    else:
        assert verdict is GateVerdict.LIMITED_SPEED
    assert abs(motion[1]) <= 10.0 * (1 + 1e-12)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_full_speed_is_reached_where_the_way_is_long(sign: float) -> None:
    motion, verdict = limit(0.5, sign * 5.0, 0.5 + sign * 0.2, dt_s=1e-2)
    assert verdict is GateVerdict.LIMITED_SPEED
    assert motion == pytest.approx((0.5 + sign * 0.1, sign * 10.0, 0.0))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("before", [-3.0, -1.0, 0.0, 2.5])
@pytest.mark.parametrize("over", [-1e-6, -1e-9, 1e-9, 1e-6, 1e-2])
def test_acceleration_limit_from_both_sides(sign: float, before: float, over: float) -> None:
    asked = before + sign * (1.0 + over)
    motion, verdict = limit(0.5, before, 0.5 + asked * 1e-3)
    if over < 0.0:
        assert (motion[0], verdict) == (0.5 + asked * 1e-3, GateVerdict.PASSED)
    else:
        assert verdict is GateVerdict.LIMITED_ACCELERATION
        # As near to the request as braking for it allows.
        assert abs(motion[1] - before) <= 1.0 + 1e-12
        assert sign * (asked - motion[1]) >= 0.0


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_acceleration_is_used_to_the_full_where_the_way_is_long(sign: float) -> None:
    motion, verdict = limit(0.5, 0.0, 0.5 + sign * 9e-3)
    assert verdict is GateVerdict.LIMITED_ACCELERATION
    assert motion == pytest.approx((0.5 + sign * 1e-3, sign * 1.0, 0.0))
    braking, _ = limit(0.5, sign * 5.0, 0.5)
    assert braking[1] == pytest.approx(sign * 4.0)


@pytest.mark.parametrize(("bound", "outward"), [(2.0, 1.0), (-1.0, -1.0)])
@pytest.mark.parametrize("over", [-1e-7, -1e-10, 0.0, 1e-10, 1e-7, 1e-3, 1.0, 1e6])
def test_bounds_from_both_sides(bound: float, outward: float, over: float) -> None:
    # A slow creep towards the bound, so that only the bound itself can limit.
    motion, verdict = limit(bound - outward * 1e-6, 0.0, bound + outward * over)
    assert -1.0 <= motion[0] <= 2.0
    room = outward * (bound - motion[0])
    assert motion[1] ** 2 / 2000.0 <= room + 1e-15
    if over > 0.0:
        assert verdict is GateVerdict.LIMITED_POSITION
    elif over == -1e-7:
        assert (motion[0], verdict) == (bound + outward * over, GateVerdict.PASSED)


@pytest.mark.parametrize(("bound", "outward"), [(2.0, 1.0), (-1.0, -1.0)])
@pytest.mark.parametrize("dt_s", [1e-4, 1e-3, 5e-3])
def test_the_room_to_brake_is_used_to_the_last(bound: float, outward: float, dt_s: float) -> None:
    """v dt + v²/(2a) = room: a request just below that speed passes, one just above does not, and is cut to it."""
    room = 1e-2
    stoppable = -1000.0 * dt_s + math.sqrt((1000.0 * dt_s) ** 2 + 2000.0 * room)
    begin, speed = bound - outward * room, outward * stoppable
    inside, passed = limit(begin, speed, begin + speed * dt_s * (1 - 1e-9), dt_s)
    assert passed is GateVerdict.PASSED
    assert inside[1] == pytest.approx(speed)
    cut, verdict = limit(begin, speed, begin + speed * dt_s * (1 + 1e-6), dt_s)
    assert verdict is GateVerdict.LIMITED_POSITION
    assert cut[1] == pytest.approx(speed, rel=1e-9) or abs(cut[1]) < stoppable


@pytest.mark.parametrize(("bound", "outward"), [(2.0, 1.0), (-1.0, -1.0)])
def test_at_a_bound_the_way_back_is_free(bound: float, outward: float) -> None:
    back = bound - outward * 5e-4
    assert limit(bound, 0.0, back) == ((back, (back - bound) / DT_S, 0.0), GateVerdict.PASSED)
    assert limit(bound, 0.0, bound) == ((bound, 0.0, 0.0), GateVerdict.PASSED)


@pytest.mark.parametrize(("bound", "outward"), [(2.0, 1.0), (-1.0, -1.0)])
def test_brakes_in_time_at_full_speed_whatever_is_asked(bound: float, outward: float) -> None:
    positions, verdict = run((bound - outward * 0.3, 0.0, 0.0), bound + outward * 5.0, 399)
    assert all(-1.0 <= position <= 2.0 for position in positions)
    assert abs(positions[-1] - bound) < 1e-6
    speeds = [abs(b - a) / 1e-3 for a, b in itertools.pairwise(positions)]
    assert max(speeds) > 9.9  # it did use the room
    assert verdict is GateVerdict.LIMITED_POSITION


def test_what_is_pushed_beyond_a_bound_by_rounding_stays_at_it() -> None:
    """A motion that no step of its own led to: too fast to stop. The bound holds all the same."""
    assert limit(1.999, 9.0, 2.5)[0][0] == 2.0
    assert limit(-0.999, -9.0, -2.5)[0][0] == -1.0


def test_a_jump_is_approached_without_swinging() -> None:
    positions, verdict = run((0.0, 0.0, 0.0), 0.8, 299)
    assert positions[-1] == 0.8
    assert verdict is GateVerdict.PASSED
    assert max(positions) <= 0.8 + 10.0 * 1e-3
    assert sum(b < a for a, b in itertools.pairwise(positions)) <= 3
    # No slower than the textbook's trapezoid by more than a few steps: 10 ms of each ramp and 70 ms at full speed.
    assert next(k for k, position in enumerate(positions) if position > 0.79) <= 95


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_request_out_of_reach_is_approached_as_fast_as_it_could_be_stopped_at(sign: float) -> None:
    """v dt + v²/(2a) = the way there."""
    motion, verdict = limit(0.0, sign * 5.0, sign * 0.0125)
    assert verdict is GateVerdict.LIMITED_SPEED
    assert motion[1] == pytest.approx(sign * (-1.0 + math.sqrt(1.0 + 2.0 * 1000.0 * 0.0125)))


@pytest.mark.parametrize("dt_s", [1e-9, 999e-9, 1e-3, 3e-3, 2e-2])
def test_what_is_within_all_limits_passes_bit_for_bit(dt_s: float) -> None:
    for part in (-0.999, -0.5, 0.0, 1e-300, 0.3, 0.999):
        reach = min(10.0, 1000.0 * dt_s) * dt_s
        requested = 0.1 + part * min(reach, 0.01)
        motion, verdict = limit(0.1, 0.0, requested, dt_s)
        assert (motion[0], verdict) == (requested, GateVerdict.PASSED)
        assert motion[1:] == ((requested - 0.1) / dt_s, 0.0)
