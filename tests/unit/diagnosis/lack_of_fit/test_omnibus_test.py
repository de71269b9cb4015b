"""Curves without physics find what a model lacks, and where; beside a right model they find no more than chance."""

import numpy as np
import pytest

from hil_forceps.diagnosis.inference.dispersion import over_dispersion
from hil_forceps.diagnosis.inference.fit import fit
from hil_forceps.diagnosis.lack_of_fit.omnibus_test import Family, LackOfFit, omnibus_test
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from tests.hidden_effects.generator import RIG, true_rig
from tests.unit.diagnosis.simulated_runs import POOL, STICKING, known_of, records_of, runs_of

KINDS = ("multisine", "trapezoid", "chirp", "teleoperation")


def left_beside_known_parameters(rig: Rig, effects: dict[str, dict[str, float]], seed: int) -> LackOfFit:
    runs = runs_of(true_rig(rig, effects, {}), KINDS, seed)
    return omnibus_test(
        fit(records_of(runs, rig), parameters.vector(rig), known_of(rig), POOL.map), POOL.map, 0, over_dispersion
    )


def test_beside_the_right_model_nothing_is_left_with_friction_or_without() -> None:
    for rig in (RIG, STICKING):
        assert not left_beside_known_parameters(rig, {}, 8200).significant


def test_what_is_left_is_found_over_its_variable() -> None:
    wave = {"cogging": {"sine_N_m": 2e-5, "cosine_N_m": -1e-5, "harmonic": 7.0}}
    left = left_beside_known_parameters(STICKING, wave, 8300)
    assert left.significant
    assert left.families[0].place == "motor"
    # Over a sixth of a turn finer waves and those over the angle do the same; the true family is no worse.
    gains = {(family.place, family.variable): family.gain for family in left.families}
    assert gains["motor", "4 to 12 times a turn"] > 0.99 * left.gain
    slack = left_beside_known_parameters(STICKING, {"wire_slack": {"half_width_m": 4e-6}}, 8300)
    assert slack.significant
    assert slack.families[0].place == "wire"


def left(*gains: float) -> LackOfFit:
    families = [Family("motor", f"variable {number}", gain, 4) for number, gain in enumerate(gains)]
    return LackOfFit(16.0, tuple(sorted(families, key=lambda family: -family.gain)))


def test_what_replicates_leave_is_no_lack_of_fit() -> None:
    found = left(60.0, 30.0)
    beside = found.calibrated([left(55.0, -3.0), left(48.0, -1.0), left(62.0, -2.0)])
    assert beside.gain == pytest.approx(30.0)  # of the second, of which replicates show nothing
    assert beside.families[0].variable == "variable 1"
    assert beside.families[1].gain < 4.0


@pytest.mark.parametrize("noncentrality", [10.0, 50.0])
def test_false_alarms_of_a_biased_test_are_as_seldom_as_without_bias(noncentrality: float) -> None:
    """Where a test is biased, calibrated gains exceed a threshold about as often as unbiased ones."""
    rng = np.random.default_rng(0)
    cost, many = Family("", "", 0.0, 4).cost, 2000
    central = rng.chisquare(4, many) - cost
    threshold = float(np.quantile(central, 0.95))
    made = rng.noncentral_chisquare(4, noncentrality, (many, 4)) - cost
    beyond = [
        Family("", "", row[0], 4).calibrated([Family("", "", g, 4) for g in row[1:]]).gain > threshold for row in made
    ]
    assert np.mean([row[0] > threshold for row in made]) > 0.6  # not calibrated
    assert np.mean(beyond) < 0.1  # 0.05, and a third more variance by the mean of three


def test_a_family_that_says_nothing_stays_as_it_is() -> None:
    nothing = Family("wire", "turn", 0.0, 0)
    assert nothing.calibrated([nothing, nothing]) == nothing
    huge = Family("wire", "turn", 1e6, 4)
    assert huge.calibrated([Family("wire", "turn", 50.0, 4)]) == huge
