"""The gate: every verdict, and values densely on both sides of every limit."""

import itertools
import math

import pytest

from hil_forceps.control.gate import CLOSED, DEFAULT_MAX_GAP_S, Gate, GateState, GateVerdict
from hil_forceps.rig.sections import Limits

MS = 1_000_000
LIMITS = Limits(
    position_min_rad=-1.0, position_max_rad=2.0, speed_max_rad_per_s=10.0, acceleration_max_rad_per_s2=1000.0
)
GATE = Gate(LIMITS)
GAP_NS = round(DEFAULT_MAX_GAP_S * 1e9)


def moving(position_rad: float, speed_rad_per_s: float = 0.0) -> GateState:
    return GateState(True, True, position_rad, speed_rad_per_s, 0)


def neighbours(value: float) -> tuple[float, float, float]:
    return math.nextafter(value, -math.inf), value, math.nextafter(value, math.inf)


@pytest.mark.parametrize("theta", [*neighbours(-1.0), 0.0, *neighbours(2.0), math.nan, math.inf, -math.inf])
def test_opens_only_within_the_bounds(theta: float) -> None:
    state = GATE.open(theta, 5)
    if -1.0 <= theta <= 2.0:
        assert state == GateState(True, False, theta, 0.0, 5)
        assert GATE.step(state, 0.5, 6) == (GateState(True, True, theta, 0.0, 6), theta, GateVerdict.OPENED)
    else:
        assert state == CLOSED
        assert GATE.step(state, 0.5, 6) == (CLOSED, None, GateVerdict.DENIED_CLOSED)


def test_closed_is_the_default_and_stays() -> None:
    state = CLOSED
    for now_ns in (0, 1, 10 * MS):
        state, reference, verdict = GATE.step(state, 0.0, now_ns)
        assert (state, reference, verdict) == (CLOSED, None, GateVerdict.DENIED_CLOSED)


@pytest.mark.parametrize("requested", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("opened_only", [True, False])
def test_what_is_not_finite_never_passes_and_changes_nothing(requested: float, opened_only: bool) -> None:
    state = GATE.open(0.0, 0) if opened_only else moving(0.0)
    assert GATE.step(state, requested, MS) == (state, None, GateVerdict.DENIED_NOT_FINITE)


def test_first_output_may_come_at_the_instant_of_opening_but_not_before() -> None:
    state = GATE.open(0.3, 7)
    assert GATE.step(state, 0.4, 6) == (state, None, GateVerdict.DENIED_TIME)
    assert GATE.step(state, 0.4, 7)[1:] == (0.3, GateVerdict.OPENED)


@pytest.mark.parametrize("now_ns", [-1, 0])
def test_time_must_increase_between_outputs(now_ns: int) -> None:
    state = moving(0.0)
    assert GATE.step(state, 0.0, now_ns) == (state, None, GateVerdict.DENIED_TIME)
    assert GATE.step(state, 0.0, 1)[1:] == (0.0, GateVerdict.PASSED)


@pytest.mark.parametrize("opened_only", [True, False])
def test_a_gap_closes_for_good(opened_only: bool) -> None:
    state = GATE.open(0.0, 0) if opened_only else moving(0.0)
    assert GATE.step(state, 0.0, GAP_NS)[1] == 0.0
    closed, reference, verdict = GATE.step(state, 0.0, GAP_NS + 1)
    assert (closed, reference, verdict) == (CLOSED, None, GateVerdict.DENIED_GAP)
    assert GATE.step(closed, 0.0, GAP_NS + MS)[1:] == (None, GateVerdict.DENIED_CLOSED)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("over", [-1e-6, -1e-9, 0.0, 1e-9, 1e-6, 1e-3, 0.1])
def test_speed_limit_from_both_sides(sign: float, over: float) -> None:
    asked = sign * (10.0 + over)
    state, reference, verdict = GATE.step(moving(0.0, sign * 9.5), asked * 1e-3, MS)
    assert reference is not None
    if over <= 0.0:
        assert (reference, verdict) == (asked * 1e-3, GateVerdict.PASSED)
    else:
        assert verdict is GateVerdict.LIMITED_SPEED
        assert abs(reference) <= 10.0 * 1e-3
    assert abs(state.speed_rad_per_s) <= 10.0 * (1 + 1e-12)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("before", [-3.0, -1.0, 0.0, 2.5])
@pytest.mark.parametrize("over", [-1e-6, -1e-9, 1e-9, 1e-6, 1e-2])
def test_acceleration_limit_from_both_sides(sign: float, before: float, over: float) -> None:
    asked = before + sign * (1.0 + over)
    state, reference, verdict = GATE.step(moving(0.5, before), 0.5 + asked * 1e-3, MS)
    assert reference is not None
    assert abs(state.speed_rad_per_s - before) <= 1.0 + 1e-12
    if over < 0.0:
        assert (reference, verdict) == (0.5 + asked * 1e-3, GateVerdict.PASSED)
    else:
        assert verdict is GateVerdict.LIMITED_ACCELERATION


@pytest.mark.parametrize(("bound", "outward"), [(2.0, 1.0), (-1.0, -1.0)])
@pytest.mark.parametrize("over", [-1e-7, -1e-10, 0.0, 1e-10, 1e-7, 1e-3, 1.0, 1e6])
def test_bounds_from_both_sides(bound: float, outward: float, over: float) -> None:
    # A slow creep towards the bound, so that only the bound itself can limit.
    state, reference, verdict = GATE.step(moving(bound - outward * 1e-6), bound + outward * over, MS)
    assert reference is not None
    assert -1.0 <= reference <= 2.0
    room = outward * (bound - reference)
    assert state.speed_rad_per_s**2 / 2000.0 <= room + 1e-15
    if over > 0.0:
        assert verdict is GateVerdict.LIMITED_POSITION
    elif over == -1e-7:
        assert (reference, verdict) == (bound + outward * over, GateVerdict.PASSED)


@pytest.mark.parametrize(("bound", "outward"), [(2.0, 1.0), (-1.0, -1.0)])
def test_brakes_in_time_at_full_speed_whatever_is_asked(bound: float, outward: float) -> None:
    state = moving(bound - outward * 0.3)
    positions = []
    for tick in range(1, 400):
        state, reference, verdict = GATE.step(state, bound + outward * 5.0, tick * MS)
        assert reference is not None
        positions.append(reference)
    assert all(-1.0 <= position <= 2.0 for position in positions)
    assert abs(positions[-1] - bound) < 1e-6
    speeds = [abs(b - a) / 1e-3 for a, b in itertools.pairwise(positions)]
    assert max(speeds) > 9.9  # it did use the room
    assert verdict is GateVerdict.LIMITED_POSITION


def test_a_jump_is_approached_without_swinging() -> None:
    state = moving(0.0)
    positions = [0.0]
    for tick in range(1, 300):
        state, reference, verdict = GATE.step(state, 0.8, tick * MS)
        assert reference is not None
        positions.append(reference)
    assert positions[-1] == 0.8
    assert verdict is GateVerdict.PASSED
    assert max(positions) <= 0.8 + 10.0 * 1e-3
    assert sum(b < a for a, b in itertools.pairwise(positions)) <= 3


@pytest.mark.parametrize("dt_ns", [1, 999, MS, 3 * MS, GAP_NS])
def test_what_is_within_all_limits_passes_bit_for_bit(dt_ns: int) -> None:
    for part in (-0.999, -0.5, 0.0, 1e-300, 0.3, 0.999):
        reach = min(10.0, 1000.0 * dt_ns * 1e-9) * dt_ns * 1e-9
        requested = 0.1 + part * min(reach, 0.01)
        assert GATE.step(moving(0.1), requested, dt_ns)[1:] == (requested, GateVerdict.PASSED)


def test_steps_change_no_state_in_place() -> None:
    state = moving(0.1, 0.2)
    before = tuple(state)
    GATE.step(state, 5.0, MS)
    assert tuple(state) == before


@pytest.mark.parametrize("gap_s", [0.0, -1.0, math.nan, math.inf])
def test_nonsense_gap_is_refused(gap_s: float) -> None:
    with pytest.raises(ValueError, match="max_gap_s"):
        Gate(LIMITS, gap_s)


@pytest.mark.parametrize(
    "change",
    [
        {"position_min_rad": 3.0},
        {"position_min_rad": math.nan},
        {"speed_max_rad_per_s": 0.0},
        {"speed_max_rad_per_s": math.inf},
        {"acceleration_max_rad_per_s2": -1.0},
    ],
)
def test_nonsense_limits_are_refused_even_past_the_rig_file(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="limits of a gate"):
        Gate(LIMITS.model_copy(update=change))
