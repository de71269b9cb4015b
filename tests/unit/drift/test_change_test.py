"""The test for a change: its rate of false alarms, its power, and where it says that a change began."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from hil_forceps.drift.change_test import Change, change_test, column_of, design, possible
from hil_forceps.drift.family import Estimated, instrument_trend
from hil_forceps.drift.result import When
from hil_forceps.drift.scatter import Scatter, drawn
from hil_forceps.drift.series import Followed, follow

RATE = 0.05
OF_EIGHT = RATE / 8.0  # the rate of a parameter among eight


def null_series(seed: int, sessions: int, scatter: Scatter) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng([seed, sessions])
    deviations = rng.uniform(0.7, 1.4, sessions)
    return drawn(rng, deviations, scatter, 1)[:, 0], deviations


def alarms(series: int, sessions: int, scatter: Scatter, rate: float) -> int:
    found = 0
    for seed in range(series):
        values, deviations = null_series(seed, sessions, scatter)
        found += change_test(values, deviations, [], rate, np.random.default_rng(seed)).p_value <= rate
    return found


def within(found: int, of: int, rate: float) -> bool:
    """Tell whether a count is within the two-sided 99.8 % interval of a binomial of this rate."""
    low, high = stats.binom.interval(0.998, of, rate)
    return bool(low <= found <= high)


def test_series_without_a_change_are_alarms_at_the_stated_rate() -> None:
    assert within(alarms(60, 15, Scatter(0.3, 3.0), 0.1), 60, 0.1)


@pytest.mark.long
@pytest.mark.parametrize("sessions", [15, 50])
@pytest.mark.parametrize(
    "scatter", [Scatter(0.0, 3.0), Scatter(0.6, 1.0), Scatter(0.9, 5.0), Scatter(1.0, 1.0), Scatter(1.0, 30.0)], ids=str
)
def test_the_rate_holds_for_scatters_of_all_kinds(sessions: int, scatter: Scatter) -> None:
    found = alarms(100, sessions, scatter, RATE)
    assert found <= stats.binom.ppf(0.999, 100, RATE)


def test_without_scatter_there_are_no_more_alarms_than_stated() -> None:
    assert alarms(30, 12, Scatter(0.0, 0.0), RATE) <= stats.binom.ppf(0.999, 30, RATE)


def steady_instrument(seed: int) -> list[Estimated]:
    sessions = tuple(When(f"s{k:03}", "2026-01-01T00:00:00Z") for k in range(20))
    found = []
    for place in range(8):
        values, deviations = null_series(1000 * seed + place, 20, Scatter(0.5, 2.0))
        found.append(Estimated(f"forceps.p{place}_N_m", "N_m", 1.0, sessions, tuple(100.0 + values), tuple(deviations)))
    return found


@pytest.mark.long
def test_an_instrument_with_eight_steady_parameters_is_an_alarm_at_the_stated_rate() -> None:
    instruments = 60
    found = 0
    for seed in range(instruments):
        trend = instrument_trend("a", steady_instrument(seed), RATE, seed)
        found += any(parameter.changes for parameter in trend.parameters)
    assert within(found, instruments, RATE)


def worn(seed: int, *, sessions: int, onset: int, rise: float, over: int, scatter: Scatter) -> Followed:
    rng = np.random.default_rng([seed, 77])
    deviations = 0.004 * rng.uniform(0.7, 1.4, sessions)
    wear = rise * np.clip((np.arange(sessions) - onset + 1) / over, 0.0, 1.0)
    return follow(1.0 + wear + drawn(rng, deviations, scatter, 1)[:, 0], deviations, OF_EIGHT, rng)


def test_friction_that_rises_by_30_percent_over_50_sessions_is_found_where_it_begins() -> None:
    found = [worn(s, sessions=100, onset=50, rise=0.3, over=50, scatter=Scatter(0.0, 0.03)) for s in range(6)]
    assert all(each.changes for each in found)
    firsts = [each.changes[0] for each in found]
    assert all(first.kind == "slope" and first.size > 0.0 for first in firsts)
    # The kink of a slope of 0.006 a session in a scatter of 0.03 is known to ± 5 sessions (least squares).
    assert np.median([abs(first.onset.likeliest - 50) for first in firsts]) <= 7
    assert sum(first.onset.low <= 50 <= first.onset.high for first in firsts) >= stats.binom.ppf(0.001, 6, 0.95)
    assert np.mean([first.total for first in firsts]) == pytest.approx(0.3, rel=0.1)


def test_a_step_is_found_at_its_session() -> None:
    found = [worn(s, sessions=40, onset=20, rise=-0.2, over=1, scatter=Scatter(0.3, 0.02)) for s in range(4)]
    firsts = [each.changes[0] for each in found]
    assert all(first.kind == "step" and abs(first.onset.likeliest - 20) <= 1 for first in firsts)
    assert np.mean([first.total for first in firsts]) == pytest.approx(-0.2, rel=0.1)


def test_a_second_change_is_found_beside_the_first() -> None:
    rng = np.random.default_rng(5)
    deviations = np.full(80, 0.004)
    series = 1.0 + 0.2 * (np.arange(80) >= 25) - 0.15 * (np.arange(80) >= 55)
    series = series + drawn(rng, deviations, Scatter(0.0, 0.02), 1)[:, 0]
    changes = follow(series, deviations, OF_EIGHT, rng).changes
    assert [(change.kind, change.onset.likeliest) for change in changes] == [("step", 25), ("step", 55)]


def test_a_single_session_that_lies_apart_is_no_change_and_does_not_hide_one() -> None:
    rng = np.random.default_rng(6)
    deviations = np.full(40, 0.004)
    series = 1.0 + drawn(rng, deviations, Scatter(0.0, 0.02), 1)[:, 0]
    series[12] += 0.4
    steady = follow(series, deviations, OF_EIGHT, rng)
    assert steady.apart == (12,)
    assert not steady.changes
    series += 0.15 * (np.arange(40) >= 25)
    stepped = follow(series, deviations, OF_EIGHT, rng)
    assert [change.onset.likeliest for change in stepped.changes] == [25]


def test_few_sessions_are_no_test() -> None:
    found = follow(np.array([1.0, 2.0, 3.0, 4.0]), np.full(4, 0.01), RATE, np.random.default_rng(0))
    assert np.isnan(found.p_value)
    assert not found.changes


def test_a_change_begins_at_the_session_that_it_first_touches() -> None:
    assert column_of(Change("step", 2), 4).tolist() == [0.0, 0.0, 1.0, 1.0]
    assert column_of(Change("slope", 2), 4).tolist() == [0.0, 0.0, 1.0, 2.0]
    assert design([Change("step", 1)], 3).tolist() == [[1.0, 0.0], [1.0, 1.0], [1.0, 1.0]]
    assert Change("slope", 1) in possible(10)
    assert len(possible(1000)) < 200


def test_the_same_seed_gives_the_same_numbers() -> None:
    one, other = (instrument_trend("a", steady_instrument(3), RATE, 7) for _ in range(2))
    assert [p.p_value for p in one.parameters] == [p.p_value for p in other.parameters]
