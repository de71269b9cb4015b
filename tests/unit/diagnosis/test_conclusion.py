"""From runs to the whole result by the filter: verdict, gain on runs held out, extended rig, next experiment."""

import numpy as np
import pytest

from hil_forceps.diagnosis.conclude import Conclusion, diagnose
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.result import to_json
from tests.hidden_effects.generator import make_case
from tests.unit.diagnosis.simulated_runs import POOL, STICKING

pytestmark = pytest.mark.xdist_group("conclusion")  # what they look at is made once, for all

SLACK_M = 6.0e-6


@pytest.fixture(scope="module")
def slack() -> Conclusion:
    """A slack wire beside friction of a tenth of the load."""
    kinds = (("multisine", "trapezoid", "slow"), ("teleoperation",))
    case = make_case({"wire_slack": {"half_width_m": SLACK_M}}, 77, scenarios=kinds, rig=STICKING)
    held_out = tuple(run.name for run in case.held_out)
    return diagnose(case.runs, case.assumed, Options(hold_out=held_out, mapper=POOL.map))


def test_the_effect_is_named_with_its_size_and_is_in_the_extended_rig(slack: Conclusion) -> None:
    told = slack.diagnosis
    assert told.verdict == "effects"
    assert [effect.id for effect in told.effects] == ["wire_slack"]
    width = told.effects[0].parameters["half_width_m"]
    assert width.low < SLACK_M < width.high
    assert slack.extended.effects["wire_slack"]["half_width_m"] == width.value


def test_the_gain_is_that_of_runs_which_were_held_out(slack: Conclusion) -> None:
    told = slack.diagnosis
    assert told.held_out == ("3_teleoperation",)
    jaw = told.gain["theta_j_rad"]
    assert jaw.baseline_rmse > 1.5 * jaw.extended_rmse
    assert jaw.explained_share > 0.9
    assert jaw.low <= jaw.explained_share <= jaw.high
    # What is left is little more than sensors and load cell make: where friction holds, a simulation parts by chance.
    # And what is simulated is no copy of the measurement.
    assert jaw.extended_rmse < 2.0 * jaw.floor_rmse
    shown = next(run for run in told.runs if run.held_out)
    assert not np.array_equal(shown.extended["theta_j_rad"][1000:], shown.measured["theta_j_rad"][1000:])


def test_the_next_experiment_moves_and_would_tell_something(slack: Conclusion) -> None:
    following = slack.diagnosis.next_experiment
    assert following is not None
    assert slack.trajectory is not None
    assert following.predicted_separation > 1.0
    assert to_json(slack.diagnosis)["next_experiment"]["name"] == following.name
