"""Within an amplifier's dead zone, and at its limit, an error of the command drives no motor."""

from dataclasses import replace

import numpy as np
import pytest

from hil_forceps.diagnosis import identification
from hil_forceps.diagnosis.inference.dispersion import over_dispersion
from hil_forceps.diagnosis.inference.fit import fit
from hil_forceps.diagnosis.inference.parameters import effect_parameters, values_of, with_effect
from hil_forceps.diagnosis.preparation.sensor_noise import sensor_noise
from hil_forceps.diagnosis.state_space.advance import expected_current_slope, physics_of
from hil_forceps.diagnosis.state_space.covariance import moved
from hil_forceps.diagnosis.state_space.layout import COMMAND_ERROR, OMEGA_M, RECORDED_STATES
from hil_forceps.diagnosis.state_space.transition import transition
from hil_forceps.model import parameters
from hil_forceps.model.composition import Physics
from tests.hidden_effects.drawn_cases import draw, even_parts, make
from tests.hidden_effects.generator import RIG, true_rig

DEAD = "amplifier_deadband"


def plant_with(effects: dict[str, dict[str, float]]) -> Physics:
    return physics_of(parameters.vector(true_rig(RIG, effects, {})))


def test_an_error_passes_outside_the_dead_zone_and_within_the_limit() -> None:
    assert expected_current_slope(plant_with({}), 0.0, 1e-3) == 1.0
    dead = plant_with({DEAD: {"half_width_A": 1e-3}})
    for command_A, share in ((0.0, 0.0), (0.9e-3, 0.0), (1e-3, 0.5), (-1e-3, 0.5), (1.1e-3, 1.0), (-0.5, 1.0)):
        assert expected_current_slope(dead, command_A, 1e-5) == pytest.approx(share, abs=1e-9)
    limited = plant_with({"current_saturation": {"limit_A": 0.2}})
    for command_A, share in ((0.1, 1.0), (0.2, 0.5), (-0.3, 0.0)):
        assert expected_current_slope(limited, command_A, 1e-5) == pytest.approx(share, abs=1e-9)


def test_what_does_not_pass_does_not_move_the_motor() -> None:
    f = transition(plant_with({}), 1e-3, True)
    kept, work = np.ones(RECORDED_STATES), np.empty((RECORDED_STATES, RECORDED_STATES))
    for slope in (0.0, 0.5, 1.0):
        covariance = np.zeros((RECORDED_STATES, RECORDED_STATES))
        covariance[COMMAND_ERROR, COMMAND_ERROR] = 1.0
        moved(f, covariance, kept, slope, work)
        per_A = f[OMEGA_M, COMMAND_ERROR]
        assert covariance[OMEGA_M, OMEGA_M] == pytest.approx((slope * per_A) ** 2)
        assert covariance[OMEGA_M, COMMAND_ERROR] == pytest.approx(slope * per_A)
        assert covariance[COMMAND_ERROR, COMMAND_ERROR] == 1.0


@pytest.mark.long
def test_a_loop_that_hunts_through_a_dead_zone_leaves_little_in_runs_held_out() -> None:
    """An integral that isn't known at the start; its error goes on for the whole run."""
    case = make(replace(draw("triple", 9500, usual=True), effects=(DEAD,)))
    fitted, unseen = even_parts(case)
    noise = sensor_noise([even.run for even in fitted], case.assumed)
    records, others = identification.records_of(
        fitted, unseen, case.assumed, noise, map, parameters.vector(case.assumed)
    )
    theta = with_effect(parameters.vector(case.assumed), DEAD, case.true.effects[DEAD])
    free = (*identification.known_of(case.assumed, records), *effect_parameters(DEAD, values_of(theta, DEAD)))
    found = fit(records, theta, free, map)
    left = identification.left_unseen(found, others, map, 0, over_dispersion)
    assert left.gain < 3.0 * left.threshold  # without the dead zone in the filter it is eleven times the threshold
