"""The plant's steps are so short that an entry which is stepped finer gains nothing by that."""

import numpy as np
import pytest

from hil_forceps.diagnosis.evidence import pass_all
from hil_forceps.diagnosis.identification import adapting
from hil_forceps.diagnosis.inference.fit import Fit, chi2_above
from hil_forceps.diagnosis.inference.parameters import start_of, with_effect
from hil_forceps.diagnosis.state_space.advance import MAX_STEP_S, STEPS, steps_in_row
from hil_forceps.model import parameters
from tests.hidden_effects.drawn_cases import LAWS
from tests.hidden_effects.generator import RIG
from tests.unit.diagnosis.simulated_runs import POOL, records_of, runs_of

FRICTION = {"forceps.motor_coulomb_N_m": 2.0e-4, "forceps.jaw_coulomb_N_m": 1.0e-4, "encoder.counts_per_rev": 16384}


@pytest.mark.parametrize("period_s", [2.5e-4, 1e-3, 1.5e-3, 2e-3, 5e-3, 0.01])
def test_steps_of_a_row_are_short_and_divide_among_samples_of_the_drive(period_s: float) -> None:
    steps = steps_in_row(period_s)
    assert steps % STEPS == 0
    assert period_s / steps <= MAX_STEP_S * 1.001
    assert steps == STEPS or period_s / (steps - STEPS) > MAX_STEP_S


def test_slow_runs_of_a_drive_of_2_ms_say_nothing_of_stribeck_friction() -> None:
    """With steps of 0.5 ms χ² fell by 160 beside next to none of it, which is stepped finer near a standstill."""
    rig = RIG.with_changes({**FRICTION, **LAWS["cascade"], "drive.sample_time_s": 2.0e-3})
    theta = parameters.vector(rig)
    records = records_of(runs_of(rig, ("slow", "slow", "slow"), 17100, row_s=2.0e-3), rig)
    passes = pass_all(records, theta, POOL.map)
    adapted = adapting(POOL.map)(records, Fit((), passes, np.eye(0)), first=True)
    next_to_none = start_of("stribeck_friction", {"rise_N_m": 4.0e-7, "speed_rad_per_s": 0.005})
    without = pass_all(adapted, theta, POOL.map)
    beside = pass_all(adapted, with_effect(theta, "stribeck_friction", next_to_none), POOL.map)
    assert abs(chi2_above(Fit((), without, np.eye(0)), beside, ())) < 8.0
