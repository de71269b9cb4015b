"""Where friction holds a mass, constants are considered, not estimated: else its mean passes for one of them."""

import numpy as np

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.diagnosis.evidence import gram, pass_all
from hil_forceps.diagnosis.identification import known_of
from hil_forceps.diagnosis.inference.fit import directions_of, inverted, moved, penalised, prior_of
from hil_forceps.diagnosis.preparation.records import record_of
from hil_forceps.diagnosis.preparation.sensor_noise import sensor_noise
from hil_forceps.diagnosis.state_space.layout import JAW_ZERO
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


def test_a_step_brings_what_it_promises_where_a_motor_creeps_and_breaks_loose() -> None:
    """Friction of 30 %, ideal encoder: where a motor that sticks told the load, a third of a step cost 466 of χ²."""
    case = make(draw("none", 227, usual=True))
    noise, theta = sensor_noise(case.fit, case.assumed), parameters.vector(case.assumed)
    records = [record_of(EvenRun.whole(run), case.assumed, noise) for run in case.fit]
    first = pass_all(records, theta, map)
    records = [record.decided_by(run.filtered) for record, run in zip(records, first.runs, strict=True)]
    passes, free = pass_all(records, theta, map), known_of(case.assumed, records)
    found = gram(passes, directions_of(free, theta), map)
    step = -inverted(found.information + np.diag(prior_of(free, theta)[1])) @ found.score  # it is at the priors' centre
    for share in (1.0, 0.3, 0.1):
        other = pass_all(records, moved(theta, free, share * step), map)
        gain = 2.0 * (penalised(other, free, passes) - penalised(passes, free, other))
        promised = -share * (2.0 - share) * float(found.score @ step)
        assert gain > promised - 5.0
