"""No sequence of requests at no times brings a reference out of the gate that its limits forbid."""

import math

from hypothesis import example, given
from hypothesis import strategies as st

from hil_forceps.control.gate import Gate, GateState, GateVerdict
from hil_forceps.rig.sections import Limits

MAX_GAP_S = 0.02
CLOSED = {GateVerdict.DENIED_GAP, GateVerdict.DENIED_CLOSED}


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
    gate = Gate(given_limits, max_gap_s=MAX_GAP_S)
    start = min(high, low + where * (high - low))
    gate.see(0, 0, start, 0.0)
    gate.open(0)
    now_ns = 0
    last: tuple[int, float, float, float] | None = None  # time, reference, speed and how far that may be off
    for sample, (requested, wait_ns) in enumerate(ticks, 1):
        now_ns += wait_ns
        gate.see(sample, now_ns, start, 0.0)
        reference, verdict = gate.step(requested, now_ns)
        if reference is None:
            assert verdict.value.startswith("denied")
            assert (gate.state is GateState.CLOSED) == (verdict in CLOSED)
            continue
        assert math.isfinite(requested)
        assert low <= reference <= high
        if last is None:
            assert (reference, verdict) == (start, GateVerdict.OPENED)
            last = (now_ns, reference, 0.0, 0.0)
            continue
        dt_s = (now_ns - last[0]) * 1e-9
        assert 0.0 < dt_s <= MAX_GAP_S * (1 + 1e-12)
        # Differences of angles carry the rounding of the angles themselves.
        rounding = 4e-16 * (1.0 + abs(low) + abs(high))
        moved = reference - last[1]
        assert abs(moved) <= top * dt_s * (1 + 1e-9) + rounding
        speed = moved / dt_s
        off = 2.0 * rounding / dt_s  # of a speed that is told by angles
        assert abs(speed - last[2]) <= steepest * dt_s * (1 + 1e-9) + off + last[3]
        ahead = high - reference if speed > 0.0 else reference - low
        assert max(0.0, abs(speed) - off) ** 2 / (2.0 * steepest) <= ahead + 1e-9 * abs(moved) + rounding * (
            1.0 + abs(speed) / (steepest * dt_s)
        )
        last = (now_ns, reference, speed, off)


@given(limits, requests, st.integers(-(10**12), 10**12))
def test_a_closed_gate_lets_nothing_pass(given_limits: Limits, requested: float, now_ns: int) -> None:
    gate = Gate(given_limits)
    gate.see(now_ns, now_ns, 0.0, 0.0)
    assert gate.step(requested, now_ns) == (None, GateVerdict.DENIED_CLOSED)


@given(limits, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_held_request_within_the_bounds_is_reached_and_kept(given_limits: Limits, begin: float, end: float) -> None:
    low, high = given_limits.position_min_rad, given_limits.position_max_rad
    gate = Gate(given_limits, max_gap_s=MAX_GAP_S)
    target = min(high, low + end * (high - low))
    start = min(high, low + begin * (high - low))
    far = high - low
    reference: float | None = None
    speed, acceleration = given_limits.speed_max_rad_per_s, given_limits.acceleration_max_rad_per_s2
    # Bounded time for it: both ramps and the way at full speed, with a step to spare for each phase.
    steps = min(3000, 20 + math.ceil(2e2 * (2.0 * math.sqrt(far / acceleration) + far / speed)))
    for tick in range(steps):
        now_ns = tick * 10_000_000
        gate.see(now_ns, now_ns, start, 0.0)
        if tick == 0:
            gate.open(0)
        reference, verdict = gate.step(target, now_ns)
        assert reference is not None
    assert reference is not None
    if steps < 3000:
        assert abs(reference - target) <= 1e-6 * far
        assert verdict in (GateVerdict.PASSED, GateVerdict.LIMITED_POSITION)
