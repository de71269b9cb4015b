"""An effect hidden in runs is found with its size; without one nothing is named, held or not."""

from collections.abc import Mapping

import pytest

from hil_forceps.diagnosis.error_rates import STEP_ERROR_SHARE
from hil_forceps.diagnosis.hypotheses.candidate import Search
from hil_forceps.diagnosis.hypotheses.search import Found, search
from hil_forceps.diagnosis.identification import adapting
from hil_forceps.diagnosis.inference.dispersion import over_dispersion
from hil_forceps.diagnosis.inference.parameters import values_of
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from tests.hidden_effects import generator_scenarios
from tests.hidden_effects.generator import RIG, true_rig
from tests.unit.diagnosis.simulated_runs import POOL, STICKING, held, known_of, records_of, runs_of

KINDS = ("multisine", "trapezoid", "chirp", "teleoperation")
HELD = "held_for_a_test"


def found_in(rig: Rig, effects: Mapping[str, Mapping[str, float]], kinds: tuple[str, ...], seed: int) -> Found:
    runs = runs_of(true_rig(rig, effects, {}), kinds, seed)
    wanted = Search(
        records_of(runs, rig),
        known_of(rig),
        POOL.map,
        frozenset(),
        0,
        lambda _: None,
        lambda: False,
        adapting(POOL.map),
        STEP_ERROR_SHARE,
        tied_share=0.0,
        geared=False,
        friction_decides=True,
        most_effects=6,
        weigh=over_dispersion,
    )
    return search(wanted, parameters.vector(rig))


@pytest.mark.parametrize("friction", ["none", "a tenth of the load"])
def test_nothing_is_named_where_nothing_is_hidden(friction: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(generator_scenarios.KINDS, HELD, held)
    monkeypatch.setitem(generator_scenarios.SCENARIOS, HELD, generator_scenarios.Scenario(HELD))
    rig = RIG if friction == "none" else STICKING
    assert found_in(rig, {}, (HELD, "teleoperation", "multisine", "trapezoid"), 8000).best.effects == ()


HIDDEN = [
    pytest.param(RIG, "cogging", {"sine_N_m": 8e-7, "cosine_N_m": -4e-7, "harmonic": 7.0}, id="cogging"),
    pytest.param(STICKING, "wire_slack", {"half_width_m": 4e-6}, id="slack beside friction"),
    pytest.param(
        STICKING,
        "cogging",
        {"sine_N_m": 2e-5, "cosine_N_m": -1e-5, "harmonic": 7.0},
        id="cogging beside friction",
        marks=pytest.mark.long,
    ),
    pytest.param(
        STICKING,
        "jaw_gravity",
        {"sine_N_m": 6e-5, "cosine_N_m": 8e-5},
        id="weight beside friction",
        marks=pytest.mark.long,
    ),
]


@pytest.mark.parametrize(("rig", "effect_id", "values"), HIDDEN)
def test_a_hidden_effect_is_named_first_with_its_size(rig: Rig, effect_id: str, values: dict[str, float]) -> None:
    found = found_in(rig, {effect_id: values}, KINDS, 8100)
    assert found.best.effects == (effect_id,)
    fitted = values_of(found.best.fit.passes.theta, effect_id)
    reach = max(abs(value) for name, value in values.items() if name != "harmonic")
    for name, value in values.items():
        assert fitted[name] == pytest.approx(value, abs=0.0 if name == "harmonic" else 0.1 * reach)
