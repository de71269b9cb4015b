"""No sequence of requests at no times brings a reference out of the gate that its limits forbid."""

import math

from hypothesis import example, given
from hypothesis import strategies as st

from hil_forceps.control.gate import CLOSED, Gate, GateVerdict
from hil_forceps.rig.sections import Limits

MAX_GAP_S = 0.02


def limits_of(low: float, width: float, speed: float, acceleration: float) -> Limits:
    return Limits(
        position_min_rad=low,
        position_max_rad=low + width,
        speed_max_rad_per_s=speed,
        acceleration_max_rad_per_s2=acceleration,
    )


limits = st.builds(
    limits_of,
    st.floats(-10.0, 10.0),
    st.floats(1e-3, 20.0),
    st.floats(1e-2, 1e4),
    st.floats(1e-1, 1e8),
)
requests = st.one_of(st.floats(), st.floats(-30.0, 30.0), st.sampled_from([-1e300, 1e300, 0.0]))
# Jittering, late, repeated, backward and far too late ticks.
waits_ns = st.one_of(
    st.integers(900_000, 1_100_000),
    st.integers(1, 20_000_000),
    st.sampled_from([-1_000_000, 0, 1, 20_000_000, 20_000_001]),
)


@given(limits, st.floats(0.0, 1.0), st.lists(st.tuples(requests, waits_ns), max_size=60))
@example(limits_of(1e-252, 0.25, 275.0, 1.77e7), 1.0, [(0.0, 900_000)] * 5)  # distances that round to nothing
def test_limits_are_never_exceeded(given_limits: Limits, where: float, ticks: list[tuple[float, int]]) -> None:
    low, high = given_limits.position_min_rad, given_limits.position_max_rad
    top, steepest = given_limits.speed_max_rad_per_s, given_limits.acceleration_max_rad_per_s2
    gate = Gate(given_limits, MAX_GAP_S)
    start = min(high, low + where * (high - low))
    state = gate.open(start, 0)
    now_ns = 0
    last: tuple[int, float, float] | None = None  # time, reference, speed
    for requested, wait_ns in ticks:
        now_ns += wait_ns
        before = state
        state, reference, verdict = gate.step(state, requested, now_ns)
        if reference is None:
            assert state in (before, CLOSED)
            assert verdict.value.startswith("denied")
            continue
        assert math.isfinite(requested)
        assert low <= reference <= high
        if last is None:
            assert (reference, verdict) == (start, GateVerdict.OPENED)
            last = (now_ns, reference, 0.0)
            continue
        dt_s = (now_ns - last[0]) * 1e-9
        assert 0.0 < dt_s <= MAX_GAP_S * (1 + 1e-12)
        # Differences of angles carry the rounding of the angles themselves.
        rounding = 4e-16 * (1.0 + abs(low) + abs(high))
        moved = reference - last[1]
        assert abs(moved) <= top * dt_s * (1 + 1e-9) + rounding
        speed = state.speed_rad_per_s
        assert abs(moved - speed * dt_s) <= rounding + 1e-9 * abs(moved)
        assert abs(speed - last[2]) <= steepest * dt_s * (1 + 1e-9) + rounding / dt_s
        ahead = high - reference if speed > 0.0 else reference - low
        assert speed * speed / (2.0 * steepest) <= ahead + 1e-9 * abs(moved) + rounding * (
            1.0 + abs(speed) / (steepest * dt_s)
        )
        last = (now_ns, reference, speed)


@given(limits, requests, st.integers(-(10**12), 10**12))
def test_a_closed_gate_lets_nothing_pass(given_limits: Limits, requested: float, now_ns: int) -> None:
    state, reference, verdict = Gate(given_limits).step(CLOSED, requested, now_ns)
    assert (state, reference, verdict) == (CLOSED, None, GateVerdict.DENIED_CLOSED)


@given(limits, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_held_request_within_the_bounds_is_reached_and_kept(given_limits: Limits, begin: float, end: float) -> None:
    low, high = given_limits.position_min_rad, given_limits.position_max_rad
    gate = Gate(given_limits, MAX_GAP_S)
    target = min(high, low + end * (high - low))
    state = gate.open(min(high, low + begin * (high - low)), 0)
    far = high - low
    reference: float | None = None
    speed, acceleration = given_limits.speed_max_rad_per_s, given_limits.acceleration_max_rad_per_s2
    # Bounded time for it: both ramps and the way at full speed, with a step to spare for each phase.
    steps = min(3000, 20 + math.ceil(2e2 * (2.0 * math.sqrt(far / acceleration) + far / speed)))
    for tick in range(steps):
        state, reference, verdict = gate.step(state, target, tick * 10_000_000)
        assert reference is not None
    assert reference is not None
    if steps < 3000:
        assert abs(reference - target) <= 1e-6 * far
        assert verdict in (GateVerdict.PASSED, GateVerdict.LIMITED_POSITION)
