"""Curves without physics find what a model lacks, and where; beside a right model they find no more than chance."""

from hil_forceps.diagnosis.inference.dispersion import over_dispersion
from hil_forceps.diagnosis.inference.fit import fit
from hil_forceps.diagnosis.lack_of_fit.omnibus_test import LackOfFit, omnibus_test
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
    assert left.families[0][0] == "motor"
    # Over a sixth of a turn finer waves and those over the angle do the same; the true family is no worse.
    gains = {family[:2]: family[2] for family in left.families}
    assert gains["motor", "4 to 12 times a turn"] > 0.99 * left.gain
    slack = left_beside_known_parameters(STICKING, {"wire_slack": {"half_width_m": 4e-6}}, 8300)
    assert slack.significant
    assert slack.families[0][0] == "wire"
