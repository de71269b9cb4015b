"""A frozen gate holds its reference, goes on when the limit is kept again, and latches when that lasts too long."""

import itertools
import math

import pytest

from hil_forceps.control.gate import GateState, GateTrip
from tests.unit.control.gate.bench import (
    BENCHES,
    FEEDBACK,
    GAP_NS,
    HOLD_NS,
    MS,
    Bench,
    S,
    V,
    failing,
    frozen,
    latched,
    running,
)


@pytest.mark.parametrize("has_output", [True, False])
def test_a_gap_closes_for_good_and_says_so(has_output: bool) -> None:
    for wait_ns, verdict in ((GAP_NS, V.PASSED if has_output else V.OPENED), (GAP_NS + 1, V.DENIED_GAP)):
        bench = running() if has_output else Bench()
        assert bench.tick(0.0, wait_ns=wait_ns)[1] is verdict
    assert bench.gate.state is S.CLOSED
    assert bench.gate.trip == GateTrip("gap", (GAP_NS + 1) * 1e-9, GAP_NS * 1e-9, "s", bench.now_ns)
    assert bench.tick(0.0) == (None, V.DENIED_CLOSED)
    bench.sample(0.7)
    bench.gate.open(bench.now_ns)
    assert bench.gate.step(0.0, bench.now_ns) == (0.7, V.OPENED)
    assert bench.gate.trip is None


@pytest.mark.parametrize("state", [S.FROZEN, S.FAILING])
def test_a_gap_latches_a_gate_that_is_frozen_and_keeps_its_reason(state: GateState) -> None:
    bench = BENCHES[state]()
    trip = bench.gate.trip
    assert bench.tick(0.0, wait_ns=GAP_NS + 1) == (None, V.DENIED_GAP)
    assert (bench.gate.state, bench.gate.trip) == (S.LATCHED, trip)


def test_a_freeze_may_last_as_long_as_it_is_told() -> None:
    bench = Bench(feedback=FEEDBACK._replace(hold_s=1.0))
    bench.tick(0.0)
    bench.tick(0.0, theta=0.5)
    for _ in range(100):
        assert bench.tick(0.0, wait_ns=10 * MS)[1] is V.FROZEN
    assert bench.tick(0.0, wait_ns=1)[1] is V.DENIED_LATCHED


# -- freeze and latch --------------------------------------------------------------------------------------------------


def test_a_single_noisy_sample_freezes_nothing() -> None:
    bench = running()
    for tick in range(80):
        assert bench.tick(0.0, current=6.0 if tick % 8 == 3 else 0.7)[1] is V.PASSED


def test_beyond_a_limit_the_reference_is_held_and_goes_on_when_that_is_over() -> None:
    bench = frozen()
    trip = bench.gate.trip
    assert trip is not None
    assert (trip.check, trip.limit, trip.unit, trip.time_ns) == ("current", 0.8, "A", bench.now_ns)
    assert trip.value == pytest.approx(0.9)
    for _ in range(7):
        assert bench.tick(0.3, current=0.1) == (0.0, V.FROZEN)
    passed, verdict = bench.tick(1e-4, current=0.1)
    assert (passed, verdict) == (1e-4, V.PASSED)
    assert (bench.gate.state, bench.gate.trip) == (S.OPEN, None)


def test_while_it_is_frozen_the_limits_hold_as_well() -> None:
    """At full speed it does not stop at once, but as fast as the acceleration allows, and comes back."""
    bench = running()
    passed = [0.0]
    while passed[-1] < 0.3:
        passed.append(bench.tick(5.0, theta=passed[-1])[0])
    angles = [bench.tick(5.0, theta=passed[-1] + 0.2)[0]]
    held = bench.gate._hold_rad
    angles += [bench.tick(math.nan)[0] for _ in range(40)]
    speeds = [(b - a) / 1e-3 for a, b in itertools.pairwise([passed[-1], *angles])]
    changes = [abs(b - a) for a, b in itertools.pairwise(speeds)]
    assert max(changes) <= 1.0 + 1e-9
    assert angles[-1] == held == passed[-1]


def test_a_freeze_lasts_no_longer_than_it_may_and_then_latches() -> None:
    bench = frozen()
    began_ns, trip = bench.now_ns, bench.gate.trip
    while bench.now_ns < began_ns + HOLD_NS:
        assert bench.tick(0.3, current=0.9) == (0.0, V.FROZEN)
    assert bench.gate.state is S.FROZEN
    assert bench.tick(0.3, current=0.9, wait_ns=1) == (None, V.DENIED_LATCHED)
    assert (bench.gate.state, bench.gate.trip) == (S.LATCHED, trip)
    for _ in range(20):
        assert bench.tick(0.3) == (None, V.DENIED_LATCHED)


def test_what_cannot_be_does_not_recover() -> None:
    bench = failing()
    assert bench.gate.trip == GateTrip("encoder_jump", 0.2, 100.0 * 1e-9 * MS + 0.01, "rad", bench.now_ns)
    began_ns = bench.now_ns
    while bench.now_ns < began_ns + HOLD_NS:
        assert bench.tick(0.3, theta=0.0) == (0.0, V.FROZEN)
    assert bench.tick(0.3, theta=0.0) == (None, V.DENIED_LATCHED)


def test_what_cannot_be_goes_before_what_is_beyond_a_limit() -> None:
    bench = frozen()
    bench.tick(0.3, theta=0.5, current=0.9)
    assert bench.gate.state is S.FAILING
    assert bench.gate.trip is not None
    assert bench.gate.trip.check == "encoder_jump"
    first = bench.gate.trip
    for _ in range(20):
        bench.tick(0.3, theta=0.5, current=0.9)
    assert bench.gate.trip == first
    bench = frozen()  # the freeze began before, and its time runs on
    began_ns = bench.now_ns
    bench.tick(0.3, theta=1.2, wait_ns=10 * MS)
    while bench.now_ns < began_ns + HOLD_NS:
        assert bench.tick(0.3)[1] is V.FROZEN
    assert bench.tick(0.3)[1] is V.DENIED_LATCHED


def test_a_latch_wants_to_be_cleared_and_then_opened_at_the_measured_angle() -> None:
    bench = latched()
    bench.gate.open(bench.now_ns)
    assert bench.gate.state is S.LATCHED
    bench.gate.clear()
    assert bench.tick(0.2) == (None, V.DENIED_CLOSED)
    bench.sample(0.2)
    bench.gate.open(bench.now_ns)
    assert bench.gate.step(0.9, bench.now_ns) == (0.2, V.OPENED)
    assert bench.gate.trip is None


@pytest.mark.parametrize("state", [S.OPEN, S.FROZEN, S.FAILING])
def test_clearing_is_for_latches_alone(state: GateState) -> None:
    bench = BENCHES[state]()
    bench.gate.clear()
    assert bench.gate.state is state


@pytest.mark.parametrize("wait_ns", [MS, 10 * MS])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("over", [-1e-3, -1e-9, 1e-9, 1e-3, 10.0])
def test_jumps_from_both_sides_in_open_and_frozen(wait_ns: int, sign: float, over: float) -> None:
    for state in (S.OPEN, S.FROZEN):
        bench = BENCHES[state]()
        bench.tick(0.0, theta=sign * (100.0 * wait_ns * 1e-9 + 0.01 + over), wait_ns=wait_ns)
        assert bench.gate.state is (S.FAILING if over > 0.0 else state)


def test_without_bounds_of_the_feedback_it_is_not_judged() -> None:
    bench = Bench(feedback=None)
    for tick in range(40):
        assert bench.tick(0.0, theta=1.0 * (tick % 2), current=9.0)[0] == 0.0
    assert bench.gate.state is S.OPEN


def test_an_angle_that_is_no_number_fails() -> None:
    bench = running()
    bench.tick(0.0, theta=math.nan)
    assert bench.gate.state is S.FAILING
