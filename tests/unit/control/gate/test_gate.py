"""The gate as a whole: every verdict in every state, and values densely on both sides of every limit."""

import math

import pytest

from hil_forceps.control.gate import Gate, GateState, GateVerdict
from tests.unit.control.gate.bench import BENCHES, FEEDBACK, GAP_NS, LIMITS, MS, Bench, S, V, neighbours, running

AGE_NS = 3 * MS


@pytest.mark.parametrize("state", list(GateState))
def test_the_benches_are_where_they_say(state: GateState) -> None:
    assert BENCHES[state]().gate.state is state


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
