"""A neighbour that suits the fitted runs is found out in those held out."""

from dataclasses import replace

import pytest

from hil_forceps.diagnosis.diagnose import Findings, Options, investigate
from hil_forceps.diagnosis.judge import judge
from tests.hidden_effects.cases import SCENARIO_SETS
from tests.hidden_effects.generator import RIG, WHITE, generate, make_case, true_rig
from tests.hidden_effects.generator_scenarios import SCENARIOS

HIDDEN = "wire_damping"
ALIAS = "wire_creep"  # as quick as a damping in slow motion, and at the end of its range there: the data don't tell
NEIGHBOUR = "wire_hysteresis"
KINDS = ("teleoperation", "slow", "multisine", "trapezoid")  # slow motion to fit, quick to judge
SEED = 90  # with 100 and 110 the fitted runs alone would tell
TRUE = true_rig(RIG, {HIDDEN: {"damping_N_s_per_m": 13.0}}, {})


def found_without(*ids: str) -> Findings:
    """Return what is found in runs of a damped wire when entries are missing from the catalogue."""
    shorter = [replace(SCENARIOS[kind], duration_s=6.0) for kind in KINDS]
    runs = [generate(TRUE, scenario, SEED + k, name=KINDS[k]) for k, scenario in enumerate(shorter)]
    return investigate(runs, RIG, Options(without=frozenset(ids), hold_out=KINDS[-1:]))


@pytest.mark.long
def test_a_neighbour_fails_where_motion_is_another() -> None:
    true, neighbour = found_without(ALIAS), found_without(ALIAS, HIDDEN)
    assert true.choice.model.effects == (HIDDEN,)
    assert neighbour.choice.model.effects == (NEIGHBOUR,)
    assert true.unseen is not None
    assert neighbour.unseen is not None
    assert neighbour.unseen.stands_out
    assert neighbour.unseen.gain > 5.0 * true.unseen.gain
    verdict = judge(neighbour)
    assert verdict.verdict == "unnamed"
    assert verdict.effects == ()
    # The runs held out are enough: had the fitted ones left nothing, they would tell.
    hidden = neighbour._replace(after=neighbour.after._replace(gain=0.0))
    assert judge(hidden).verdict == "unnamed"
    assert judge(hidden).reasons[0].endswith("in the runs held out")
    assert judge(hidden._replace(unseen=None)).verdict != "unnamed"
    assert judge(true).verdict == "effects"


@pytest.fixture(scope="module")
def ringing() -> Findings:
    """The fitted runs tell the jaw's inertia to some percent, and trapezoids make it ring for tens of periods."""
    case = make_case(
        {"viscous_asymmetry": {"difference_N_m_s_per_rad": 4e-6}}, 80003, scenarios=SCENARIO_SETS["work"], noise=WHITE
    )
    return investigate(case.runs, case.assumed, Options(hold_out=tuple(run.name for run in case.held_out)))


@pytest.mark.long
@pytest.mark.xdist_group("ringing")
def test_a_right_model_is_not_doubted_where_the_jaw_rings_only_in_the_runs_held_out(ringing: Findings) -> None:
    assert ringing.choice.model.effects == ("viscous_asymmetry",)
    assert judge(ringing).verdict == "effects"


@pytest.mark.long
@pytest.mark.xdist_group("ringing")
def test_a_right_model_leaves_nothing_there(ringing: Findings) -> None:
    assert ringing.unseen is not None
    assert not ringing.unseen.stands_out
    assert ringing.unseen.gain < 0.1 * (ringing.baseline.fit.chi2 - ringing.choice.model.fit.chi2)


@pytest.mark.long
@pytest.mark.xdist_group("ringing")
def test_how_much_may_be_left_there_hangs_on_whether_a_loop_keeps_errors_small(ringing: Findings) -> None:
    assert ringing.unseen is not None
    explained = ringing.baseline.fit.chi2 - ringing.choice.model.fit.chi2
    doubtful = ringing._replace(unseen=ringing.unseen._replace(gain=0.4 * explained))
    assert judge(doubtful).verdict == "unnamed"
    driven = doubtful._replace(records=tuple(record._replace(mode="driven") for record in doubtful.records))
    assert judge(driven).verdict == "effects"


@pytest.mark.slow
def test_nothing_held_out_nothing_unseen() -> None:
    runs = [generate(TRUE, replace(SCENARIOS["trapezoid"], duration_s=4.0), 7, name="only")]
    assert investigate(runs, RIG, Options()).unseen is None
