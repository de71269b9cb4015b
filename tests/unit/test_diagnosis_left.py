"""What is left beside a model, and when that makes it doubtful."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from hil_forceps.diagnosis.diagnose import Findings, Options, investigate
from hil_forceps.diagnosis.error_rates import UNEXPLAINED_SHARE
from hil_forceps.diagnosis.judge import BOTH_OVER_CHANCE, FITTED_OVER_CHANCE, LEAST_SHARE, judge
from hil_forceps.diagnosis.lack_of_fit.curves import Leftover, memory_over_way
from tests.hidden_effects.generator import RIG, generate, true_rig
from tests.hidden_effects.generator_scenarios import SCENARIOS

HIDDEN = "wire_permanent_stretch"
STRETCHED = {HIDDEN: {"stretch_m": 6.0e-5}}
PLAY = "transmission_play"
KINDS = ("multisine", "chirp", "trapezoid")


def found_without(
    *ids: str, hidden: Mapping[str, Mapping[str, float]] = STRETCHED, kinds: tuple[str, ...] = KINDS
) -> Findings:
    """Return what is found in runs with something hidden when entries are missing from the catalogue."""
    true = true_rig(RIG, hidden, {})
    runs = [generate(true, replace(SCENARIOS[kind], duration_s=4.0), 40 + k, name=kind) for k, kind in enumerate(kinds)]
    return investigate(runs, RIG, Options(without=frozenset(ids), hold_out=kinds[-1:]))


@pytest.fixture(scope="module")
def right() -> Findings:
    """The whole catalogue."""
    return found_without()


def left_times(look: Leftover | None, times: float) -> Leftover:
    """Return a look that finds so many times of what chance gives."""
    assert look is not None
    return look._replace(gain=times * look.threshold)


def with_left(found: Findings, fitted: float, unseen: float) -> Findings:
    """Return findings that leave so many times of what chance gives."""
    return found._replace(after=left_times(found.after, fitted), unseen=left_times(found.unseen, unseen))


@pytest.mark.slow
@pytest.mark.xdist_group("left")
def test_what_both_leave_is_doubted_though_neither_alone_would_be(right: Findings) -> None:
    assert right.choice.model.effects == (HIDDEN,)
    assert judge(right).verdict == "effects"
    more, less = 1.1 * BOTH_OVER_CHANCE, 0.9 * BOTH_OVER_CHANCE
    assert judge(with_left(right, more, more)).verdict == "unnamed"
    assert judge(with_left(right, more, less)).verdict == "effects"
    assert judge(with_left(right, less, more)).verdict == "effects"
    assert judge(with_left(right, more, more)._replace(unseen=None)).verdict == "effects"


def explaining(found: Findings, gain: float) -> Findings:
    """Return the same with names that lessen χ² by so much."""
    fit = found.baseline.fit._replace(chi2=found.choice.model.fit.chi2 + gain)
    return found._replace(baseline=replace(found.baseline, fit=fit))


@pytest.mark.slow
@pytest.mark.xdist_group("left")
def test_many_times_chance_is_doubted_though_it_is_a_small_share(right: Findings) -> None:
    left = 1.1 * FITTED_OVER_CHANCE * right.after.threshold
    found = explaining(right, left / (0.5 * (LEAST_SHARE + UNEXPLAINED_SHARE)))
    assert judge(with_left(found, 0.9 * FITTED_OVER_CHANCE, 0.0)).verdict == "effects"
    many = with_left(found, 1.1 * FITTED_OVER_CHANCE, 0.0)
    assert judge(many).verdict == "unnamed"
    driven = tuple(record._replace(mode="driven") for record in many.records)
    assert judge(many._replace(records=driven)).verdict == "effects"


@pytest.mark.slow
@pytest.mark.xdist_group("left")
def test_a_large_effect_may_leave_many_times_chance(right: Findings) -> None:
    found = explaining(right, 1.1 * FITTED_OVER_CHANCE * right.after.threshold / (0.9 * LEAST_SHARE))
    assert judge(with_left(found, 1.1 * FITTED_OVER_CHANCE, 0.0)).verdict == "effects"
    assert judge(with_left(found, 1.1 * FITTED_OVER_CHANCE, 1.1 * BOTH_OVER_CHANCE)).verdict == "effects"


@pytest.mark.slow
@pytest.mark.xdist_group("left")
def test_one_of_those_tied_that_the_runs_held_out_bear_out_is_enough(right: Findings) -> None:
    found = with_left(right, 0.0, 200.0)._replace(unseen_of_rivals={("wire_slack",): left_times(right.unseen, 100.0)})
    assert judge(found).verdict == "unnamed"
    borne_out = found._replace(unseen_of_rivals={("wire_slack",): left_times(right.unseen, 0.5)})
    verdict = judge(borne_out)
    assert verdict.verdict == "effects"
    assert [named.id for named in verdict.effects] == [HIDDEN]
    assert verdict.reasons[-1] == f"in the runs held out {HIDDEN} leaves 200.0 times chance, wire_slack 0.5"


@pytest.mark.slow
@pytest.mark.xdist_group("left")
def test_what_no_zero_of_the_jaw_s_sensor_can_be_is_left(right: Findings) -> None:
    assert not right.after.stands_out
    lacking = found_without(HIDDEN)
    assert lacking.choice.model.effects == ()
    verdict = judge(lacking)
    assert verdict.verdict == "unnamed"
    assert verdict.varies_over[0] == "theta_j_rad: constant"


@pytest.mark.slow
@pytest.mark.xdist_group("left")
def test_a_play_that_no_entry_is_shows_over_the_direction_and_is_no_skew() -> None:
    found = found_without(PLAY, hidden={PLAY: {"half_width_rad": 8.0e-5}})
    assert "channel_skew" in found.choice.model.effects
    verdict = judge(found)
    assert verdict.verdict == "unnamed"
    assert verdict.varies_over[0] == "wire: direction"


@pytest.mark.slow
@pytest.mark.xdist_group("left")
@pytest.mark.parametrize(
    ("effect_id", "values", "over"),
    [
        ("torque_ripple", {"harmonic": 6.0, "sine": 3.0e-4}, "current and 4 to 12 times a turn"),
        ("torque_ripple", {"harmonic": 18.0, "sine": 3.0e-4}, "current and 13 to 24 times a turn"),
        ("cogging", {"harmonic": 7.0, "sine_N_m": 4.0e-7}, "4 to 12 times a turn"),
        ("cogging", {"harmonic": 24.0, "sine_N_m": 1.0e-6}, "13 to 24 times a turn"),
    ],
)
def test_what_recurs_many_times_a_turn_is_no_noise(effect_id: str, values: dict[str, float], over: str) -> None:
    """In three harmonics of a turn a ripple with 1500 of χ² in it went for noise of a band, and all for consistent."""
    found = found_without("torque_ripple", "cogging", hidden={effect_id: values}, kinds=("spin", "multisine"))
    verdict = judge(found)
    assert verdict.verdict == "unnamed"
    assert verdict.varies_over[0] == f"motor: {over}"


def test_a_direction_is_forgotten_over_the_way_after_each_reversal() -> None:
    rng = np.random.default_rng(5)
    way = np.convolve(rng.standard_normal(3000), np.ones(30) / 30.0)[:3000]
    way[:20] = way[500:620] = 0.0  # at rest, also at first
    angle = np.cumsum(way)
    expected, state = np.zeros(angle.size), 0.0
    for k, step in enumerate(np.diff(angle, prepend=angle[0])):
        if step != 0.0:
            state = np.sign(step) + (state - np.sign(step)) * np.exp(-abs(step) / 2.0)
        expected[k] = state
    np.testing.assert_allclose(memory_over_way(angle, 2.0), expected, atol=1e-9)
    assert np.ptp(expected) > 1.5
    assert not memory_over_way(np.full(9, 0.3), 1.0).any()
