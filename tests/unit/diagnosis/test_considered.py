"""Where friction holds a mass, constants are considered, not estimated: else its mean passes for one of them."""

import numpy as np

from hil_forceps.diagnosis.preparation.even_rows import EvenRun
from hil_forceps.diagnosis.preparation.records import record_of
from hil_forceps.diagnosis.preparation.sensor_noise import sensor_noise
from hil_forceps.diagnosis.state_space.layout import JAW_ZERO
from hil_forceps.diagnosis.state_space.passes import pass_all
from hil_forceps.model import parameters
from tests.hidden_effects.drawn_cases import draw, make


def test_the_zero_of_the_jaw_sensor_is_not_told_by_a_jaw_that_sticks() -> None:
    case = make(draw("none", 35, usual=True))  # 30 % of the load; a run that begins amid motion
    noise = sensor_noise(case.fit, case.assumed)
    records = [record_of(EvenRun.whole(run), case.assumed, noise) for run in case.fit]
    for run in pass_all(records, parameters.vector(case.true), map).runs:
        zero, variance = run.filtered.course[:, JAW_ZERO], run.filtered.variance[:, JAW_ZERO]
        # It is 0. Friction that is taken for white noise within its level tells −13.7 mrad ± 0.1 within 200 rows.
        assert np.all(np.abs(zero) < 5.0 * np.sqrt(variance) + 5e-5)
