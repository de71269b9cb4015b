"""Opening the gate: within the bounds, at the measured angle, and never round a freeze or a latch."""

import math

import pytest

from hil_forceps.control.gate import Gate, GateState, GateVerdict
from tests.unit.control.gate.bench import BENCHES, FEEDBACK, LIMITS, MS, Bench, S, V, neighbours, running

# -- opening ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("theta", [*neighbours(-1.0), 0.0, *neighbours(2.0), math.nan, math.inf, -math.inf])
def test_opens_only_within_the_bounds_and_first_says_the_measured_angle(theta: float) -> None:
    bench = Bench(theta)
    answer = bench.gate.step(0.5, 0)
    if -1.0 <= theta <= 2.0:
        assert answer == (theta, V.OPENED)
        assert bench.gate.position_rad == theta
    else:
        assert answer == (None, V.DENIED_CLOSED)
        assert bench.gate.state is S.CLOSED


def test_closed_is_the_default_and_stays() -> None:
    gate = Gate(LIMITS, FEEDBACK)
    assert gate.state is S.CLOSED
    assert gate.trip is None
    assert math.isnan(gate.position_rad)
    for now_ns in (0, 1, 10 * MS):
        gate.see(now_ns, now_ns, 0.0, 0.0)
        assert gate.step(0.0, now_ns) == (None, V.DENIED_CLOSED)
    gate.clear()
    assert gate.state is S.CLOSED


def test_without_a_sample_it_does_not_open() -> None:
    gate = Gate(LIMITS)
    gate.open(0)
    assert gate.state is S.CLOSED


@pytest.mark.parametrize("age_s", [3e-3, 1.0])
@pytest.mark.parametrize(("over_ns", "opens"), [(-1, True), (0, True), (1, False)])
def test_at_an_old_sample_it_does_not_open(age_s: float, over_ns: int, opens: bool) -> None:
    age_ns = round(age_s * 1e9) + over_ns
    gate = Gate(LIMITS.model_copy(update={"max_sample_age_s": age_s}))
    gate.see(0, 0, 0.0, 0.0)
    gate.open(age_ns)
    assert (gate.state is S.OPEN) is opens


def test_opening_again_begins_anew_at_the_measured_angle() -> None:
    bench = Bench(feedback=None)
    bench.tick(0.0)
    assert bench.tick(0.001) == (0.001, V.PASSED)
    bench.sample(0.05)
    bench.gate.open(bench.now_ns)
    assert bench.gate.step(0.5, bench.now_ns) == (0.05, V.OPENED)
    bench.sample(math.nan)
    bench.gate.open(bench.now_ns)
    assert bench.gate.state is S.CLOSED


def test_opening_takes_the_newest_sample_and_stamps_that_go_back_are_none() -> None:
    bench = Bench(0.1, feedback=None)
    bench.gate.see(5, 0, 0.2, 0.0)
    bench.gate.see(5, 0, 0.3, 0.0)
    bench.gate.see(4, 0, 0.4, 0.0)
    bench.gate.open(0)
    assert bench.gate.position_rad == 0.2


@pytest.mark.parametrize("state", [S.FROZEN, S.FAILING, S.LATCHED])
def test_opening_does_not_get_round_a_freeze_or_a_latch(state: GateState) -> None:
    bench = BENCHES[state]()
    trip = bench.gate.trip
    bench.sample(bench.theta + 0.05)
    bench.gate.open(bench.now_ns)
    assert (bench.gate.state, bench.gate.trip) == (state, trip)
    assert bench.gate.position_rad == 0.0


def test_first_output_may_come_at_the_instant_of_opening_but_not_before() -> None:
    gate = Gate(LIMITS)
    gate.see(7, 7, 0.3, 0.0)
    gate.open(7)
    assert gate.step(0.4, 6) == (None, V.DENIED_TIME)
    assert gate.step(0.4, 7) == (0.3, V.OPENED)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("acceleration", "verdict"), [(99.9, V.PASSED), (100.1, V.LIMITED_JERK)])
def test_it_opens_at_rest(sign: float, acceleration: float, verdict: GateVerdict) -> None:
    assert running(jerk_max_rad_per_s3=1e5).tick(sign * acceleration * 1e-6)[1] is verdict


def test_before_it_is_open_nothing_is_implausible() -> None:
    gate = Gate(LIMITS, FEEDBACK)
    for tick in range(100):
        gate.see(tick * MS, tick * MS, 1.5 * (tick % 2), 9.0)
    gate.open(99 * MS)
    assert gate.state is S.OPEN
    assert gate.step(0.0, 99 * MS) == (1.5, V.OPENED)
