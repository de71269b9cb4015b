"""A harmonic that was the wrong one beside fewer entries is put right beside all of them."""

import pytest

from hil_forceps.diagnosis.hypotheses.harmonic_profile import likelier_harmonic
from hil_forceps.diagnosis.inference.fit import fit
from hil_forceps.diagnosis.inference.parameters import effect_parameters, values_of, with_effect
from hil_forceps.model import parameters
from tests.hidden_effects.generator import RIG, true_rig
from tests.unit.diagnosis.simulated_runs import POOL, known_of, records_of, runs_of

KINDS = ("multisine", "trapezoid", "slow")
TRUE = {"sine_N_m": 3e-5, "cosine_N_m": -2e-5, "harmonic": 9.0}


@pytest.mark.parametrize("began_with", [7.0, 9.0, 10.0])
def test_the_true_harmonic_is_found_from_its_neighbours(began_with: float) -> None:
    records = records_of(runs_of(true_rig(RIG, {"cogging": TRUE}, {}), KINDS, 8600), RIG)
    theta = with_effect(parameters.vector(RIG), "cogging", TRUE | {"harmonic": began_with})
    free = (*known_of(RIG), *effect_parameters("cogging", values_of(theta, "cogging")))
    found = likelier_harmonic(fit(records, theta, free, POOL.map), "cogging", POOL.map)
    if began_with == 9.0:
        assert found is None
    else:
        assert found is not None
        assert values_of(found, "cogging") == pytest.approx(TRUE, rel=0.1)
