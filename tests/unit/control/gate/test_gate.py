"""The gate as a whole: every verdict in every state, and values densely on both sides of every limit."""

import itertools
import math
from collections.abc import Callable
from typing import Any

import pytest

from hil_forceps.control.gate import DEFAULT_MAX_GAP_S, Gate, GateState, GateTrip, GateVerdict
from hil_forceps.control.gate.bounds import FeedbackBounds
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import Limits

MS = 1_000_000
GAP_NS = round(DEFAULT_MAX_GAP_S * 1e9)
AGE_NS = 3 * MS
HOLD_NS = 50 * MS
LSB_RAD = 2.0 * math.pi / (1 << 24)
LIMITS = Limits(
    position_min_rad=-1.0, position_max_rad=2.0, speed_max_rad_per_s=10.0, acceleration_max_rad_per_s2=1000.0
)
PLANT = PlantParameters(2.0e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)
FEEDBACK = FeedbackBounds(
    plant=PLANT,
    jump_speed_rad_per_s=100.0,
    jump_slack_rad=0.01,
    still_s=0.1,
    still_travel_rad=0.02,
    still_travel_alone_rad=0.5,
    strong_A=0.5,
    against_travel_rad=0.3,
    tension_max_N=5.0,
    current_max_A=0.8,
    hold_s=HOLD_NS * 1e-9,
)
S, V = GateState, GateVerdict


class Bench:
    """A gate with its time; a sample comes each millisecond and is asked about at once."""

    def __init__(self, theta: float = 0.0, feedback: FeedbackBounds | None = FEEDBACK, **limits: float) -> None:
        self.gate = Gate(LIMITS.model_copy(update=limits), feedback)
        self.now_ns, self.theta = 0, theta
        self.gate.see(0, 0, theta, 0.0)
        self.gate.open(0)

    def sample(self, theta: float | None = None, current: float = 0.0, wait_ns: int = MS) -> None:
        self.now_ns += wait_ns
        self.theta = self.theta if theta is None else theta
        self.gate.see(self.now_ns, self.now_ns, self.theta, current)

    def tick(self, requested: float, theta: float | None = None, current: float = 0.0, wait_ns: int = MS) -> Any:
        self.sample(theta, current, wait_ns)
        return self.gate.step(requested, self.now_ns)


def closed() -> Bench:
    bench = Bench()
    bench.gate = Gate(LIMITS, FEEDBACK)
    bench.gate.see(0, 0, 0.0, 0.0)
    return bench


def running(**limits: float) -> Bench:
    bench = Bench(feedback=FEEDBACK, **limits)
    assert bench.tick(0.0) == (0.0, V.OPENED)
    return bench


def frozen() -> Bench:
    """Eight samples with too much current."""
    bench = running()
    bench.gate._monitor.restart(bench.now_ns, 0.0)  # type: ignore[union-attr]
    for _ in range(7):
        assert bench.tick(0.0, current=0.9) == (0.0, V.PASSED)
    assert bench.tick(0.3, current=0.9) == (0.0, V.FROZEN)
    return bench


def failing() -> Bench:
    bench = running()
    assert bench.tick(0.3, theta=0.2) == (0.0, V.FROZEN)
    return bench


def latched() -> Bench:
    bench = failing()
    while bench.gate.state is S.FAILING:
        bench.tick(0.3)
    return bench


BENCHES: dict[GateState, Callable[[], Bench]] = {
    S.CLOSED: closed, S.OPEN: running, S.FROZEN: frozen, S.FAILING: failing, S.LATCHED: latched
}  # fmt: skip


def neighbours(value: float) -> list[float]:
    """The value, a float and a unit of the wire to each side of it, and small and large parts of it."""
    off = (0.0, LSB_RAD, -LSB_RAD, *(sign * part * (abs(value) + 1e-3) for sign in (-1, 1) for part in (1e-9, 1e-3, 1)))
    return [math.nextafter(value, -math.inf), math.nextafter(value, math.inf), *(value + each for each in off)]


@pytest.mark.parametrize("state", list(GateState))
def test_the_benches_are_where_they_say(state: GateState) -> None:
    assert BENCHES[state]().gate.state is state


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


# -- what may leave, and when ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("state", list(GateState))
@pytest.mark.parametrize("requested", [*neighbours(-1.0), *neighbours(2.0), *neighbours(0.0), math.nan, math.inf])
def test_in_every_state_only_what_is_within_the_bounds_leaves(state: GateState, requested: float) -> None:
    bench = BENCHES[state]()
    for _ in range(5):
        passed, verdict = bench.tick(requested)
        if state in (S.CLOSED, S.LATCHED):
            assert (passed, verdict) == (None, V.DENIED_CLOSED if state is S.CLOSED else V.DENIED_LATCHED)
        elif state is not S.OPEN:
            assert (passed, verdict) == (0.0, V.FROZEN)
        elif math.isfinite(requested):
            assert abs(passed) <= min(abs(requested), 0.05)
        else:
            assert (passed, verdict) == (None, V.DENIED_NOT_FINITE)
    assert bench.gate.state is state


@pytest.mark.parametrize("requested", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_changes_nothing(requested: float) -> None:
    bench = running()
    assert bench.tick(requested) == (None, V.DENIED_NOT_FINITE)
    assert bench.gate.step(0.001, bench.now_ns) == (0.001, V.PASSED)


def test_each_output_needs_a_sample_of_its_own() -> None:
    bench = running()
    assert bench.gate.step(0.0, bench.now_ns + MS) == (None, V.DENIED_STALE)
    bench.gate.see(bench.now_ns, bench.now_ns, 0.0, 0.0)  # the same stamp again
    assert bench.gate.step(0.0, bench.now_ns + MS) == (None, V.DENIED_STALE)
    assert bench.tick(0.0) == (0.0, V.PASSED)


@pytest.mark.parametrize(("age_ns", "verdict"), [(0, V.PASSED), (AGE_NS, V.PASSED), (AGE_NS + 1, V.DENIED_STALE)])
def test_no_output_comes_from_an_old_sample(age_ns: int, verdict: GateVerdict) -> None:
    bench = running()
    bench.sample()
    assert bench.gate.step(0.0, bench.now_ns + age_ns)[1] is verdict


@pytest.mark.parametrize("wait_ns", [-1, 0])
def test_time_must_increase_between_outputs(wait_ns: int) -> None:
    bench = running()
    bench.gate.see(bench.now_ns + 5, bench.now_ns, 0.0, 0.0)
    assert bench.gate.step(0.0, bench.now_ns + wait_ns) == (None, V.DENIED_TIME)
    assert bench.gate.step(0.0, bench.now_ns + 1) == (0.0, V.PASSED)


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


def test_of_several_reasons_the_first_is_told() -> None:
    """Time, gap, sample, number; each on its own bound."""
    bench = running()
    assert bench.gate.step(math.nan, bench.now_ns) == (None, V.DENIED_TIME)
    assert bench.gate.step(math.nan, bench.now_ns + 1) == (None, V.DENIED_STALE)
    assert bench.gate.step(math.nan, bench.now_ns + GAP_NS) == (None, V.DENIED_STALE)
    bench.gate.see(bench.now_ns + 1, bench.now_ns, 0.0, 0.0)
    assert bench.gate.step(math.nan, bench.now_ns + AGE_NS) == (None, V.DENIED_NOT_FINITE)
    assert bench.gate.step(math.nan, bench.now_ns + AGE_NS + 1) == (None, V.DENIED_STALE)
    assert bench.gate.step(math.nan, bench.now_ns + GAP_NS + 1) == (None, V.DENIED_GAP)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("acceleration", "verdict"), [(99.9, V.PASSED), (100.1, V.LIMITED_JERK)])
def test_it_opens_at_rest(sign: float, acceleration: float, verdict: GateVerdict) -> None:
    assert running(jerk_max_rad_per_s3=1e5).tick(sign * acceleration * 1e-6)[1] is verdict


def test_a_freeze_may_last_as_long_as_it_is_told() -> None:
    bench = Bench(feedback=FEEDBACK._replace(hold_s=1.0))
    bench.tick(0.0)
    bench.tick(0.0, theta=0.5)
    for _ in range(100):
        assert bench.tick(0.0, wait_ns=10 * MS)[1] is V.FROZEN
    assert bench.tick(0.0, wait_ns=1)[1] is V.DENIED_LATCHED


def test_the_limits_are_those_of_the_rig() -> None:
    assert running().tick(1e-4)[1] is V.PASSED
    bench = running()
    assert bench.tick(2e-3) == (pytest.approx(1e-3), V.LIMITED_ACCELERATION)
    assert bench.gate.position_rad == pytest.approx(1e-3)
    assert running(jerk_max_rad_per_s3=1e5).tick(2e-4)[1] is V.LIMITED_JERK
    assert running(window_travel_max_rad=1.0).tick(2e-3) == (pytest.approx(1e-3), V.LIMITED_ACCELERATION)
    assert running().gate.range_rad == 3.0
    assert Gate(LIMITS, max_gap_s=1.0).max_gap_ns == 1_000_000_000
    assert Gate(LIMITS)._max_step_ns == GAP_NS


@pytest.mark.parametrize("has_window", [False, True])
@pytest.mark.parametrize(("wait_ns", "used_ns"), [(MS, MS), (2 * MS, 2 * MS), (2 * MS + 1, 2 * MS), (GAP_NS, 2 * MS)])
def test_what_a_late_tick_left_out_is_not_caught_up_at_once(wait_ns: int, used_ns: int, has_window: bool) -> None:
    bench = Bench()
    travel = {"window_travel_max_rad": 3.0} if has_window else {}
    limits = LIMITS.model_copy(update={"acceleration_max_rad_per_s2": 1e9, **travel})
    bench.gate = Gate(limits, FEEDBACK, max_step_s=0.002)
    bench.sample()
    bench.gate.open(bench.now_ns)
    assert bench.gate.step(0.0, bench.now_ns) == (0.0, V.OPENED)
    passed, verdict = bench.tick(0.5, wait_ns=wait_ns)
    assert verdict is V.LIMITED_SPEED
    assert passed == pytest.approx(limits.speed_max_rad_per_s * used_ns * 1e-9, rel=1e-12)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("over", [-1e-6, -1e-8, 1e-8, 1e-6, 1e-3])
def test_window_from_both_sides(sign: float, over: float) -> None:
    bench = running(window_travel_max_rad=0.1)
    asked = sign * (0.1 + over)
    verdicts, angles = set(), []
    for tick in range(1, 250):
        passed, verdict = bench.tick(asked * (1.0 - max(0.0, 1.0 - tick / 220.0) ** 2))  # with room to brake
        angles.append(sign * passed)
        verdicts.add(verdict)
    assert max(angles) <= 0.1
    assert (V.LIMITED_WINDOW in verdicts) is (over > 0.0)
    assert verdicts <= {V.PASSED, V.LIMITED_WINDOW}
    for _ in range(20):
        passed, verdict = bench.tick(asked)
    assert passed == asked, "what is past counts no longer"


def test_the_windows_bound_is_told_from_that_of_the_position() -> None:
    bench = Bench(1.95, window_travel_max_rad=0.2)
    bench.tick(1.95)
    assert [bench.tick(3.0)[1] for _ in range(30)] == [V.LIMITED_POSITION] * 30
    bench = Bench(-0.95, window_travel_max_rad=0.2)
    bench.tick(-0.95)
    assert [bench.tick(-3.0)[1] for _ in range(30)] == [V.LIMITED_POSITION] * 30


def test_opening_anew_forgets_the_window() -> None:
    bench = running(window_travel_max_rad=0.1)
    bench.sample(0.09)
    bench.gate.open(bench.now_ns)
    assert bench.gate.step(0.0, bench.now_ns) == (0.09, V.OPENED)
    for tick in range(1, 100):
        _, verdict = bench.tick(0.09 + 0.0009 * tick)
        assert verdict is V.PASSED


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


def test_before_it_is_open_nothing_is_implausible() -> None:
    gate = Gate(LIMITS, FEEDBACK)
    for tick in range(100):
        gate.see(tick * MS, tick * MS, 1.5 * (tick % 2), 9.0)
    gate.open(99 * MS)
    assert gate.state is S.OPEN
    assert gate.step(0.0, 99 * MS) == (1.5, V.OPENED)


def test_without_bounds_of_the_feedback_it_is_not_judged() -> None:
    bench = Bench(feedback=None)
    for tick in range(40):
        assert bench.tick(0.0, theta=1.0 * (tick % 2), current=9.0)[0] == 0.0
    assert bench.gate.state is S.OPEN


def test_an_angle_that_is_no_number_fails() -> None:
    bench = running()
    bench.tick(0.0, theta=math.nan)
    assert bench.gate.state is S.FAILING


@pytest.mark.parametrize("gap_s", [0.0, -1.0, math.nan, math.inf])
def test_nonsense_gap_is_refused(gap_s: float) -> None:
    with pytest.raises(ValueError, match=rf"not limits of a gate: .*max_gap_s={gap_s}"):
        Gate(LIMITS, max_gap_s=gap_s)
    with pytest.raises(ValueError, match=rf"not limits of a gate: .*max_step_s={gap_s}"):
        Gate(LIMITS, max_step_s=gap_s)


@pytest.mark.parametrize(
    "change",
    [
        {"position_min_rad": 3.0},
        {"position_min_rad": 2.0},
        {"position_min_rad": math.nan},
        {"position_max_rad": math.inf},
        {"speed_max_rad_per_s": 0.0},
        {"speed_max_rad_per_s": math.inf},
        {"acceleration_max_rad_per_s2": -1.0},
        {"jerk_max_rad_per_s3": 0.0},
        {"jerk_max_rad_per_s3": math.nan},
        {"window_travel_max_rad": 0.0},
        {"window_travel_max_rad": math.inf},
    ],
)
def test_nonsense_limits_are_refused_even_past_the_rig_file(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="not limits of a gate"):
        Gate(LIMITS.model_copy(update=change))


def test_the_codes_of_verdicts_never_change_their_places() -> None:
    assert [verdict.value for verdict in GateVerdict] == [
        "opened", "passed", "limited_position", "limited_speed", "limited_acceleration", "denied_closed",
        "denied_not_finite", "denied_time", "denied_gap", "limited_jerk", "limited_window", "frozen",
        "denied_latched", "denied_stale",
    ]  # fmt: skip
