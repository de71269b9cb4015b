"""Entries that bend with their amplitude are looked for at sizes that the data could just show."""

import numpy as np
import pytest

from hil_forceps.diagnosis.options import Options, fit_baseline
from hil_forceps.diagnosis.hypotheses.entries import Probe
from hil_forceps.diagnosis.experiment import prepare
from hil_forceps.diagnosis.probing import LARGEST, sized_columns
from hil_forceps.diagnosis.score import score
from tests.hidden_effects.generator import make_case


@pytest.mark.parametrize("too_much", [1.0, 300.0])
def test_falling_friction_is_found_whatever_size_it_is_looked_for_at(too_much: float) -> None:
    hidden = {"stribeck_friction": {"rise_N_m": 4.0e-6, "speed_rad_per_s": 0.3}}
    case = make_case(hidden, 41, scenarios=(("multisine",), ()))
    records, _ = prepare(case.fit, case.assumed)
    _, _, baseline, whitener = fit_baseline(records, case.assumed, Options())
    problem, found = baseline.problem, baseline.fit
    place = Probe("stribeck_friction", {"rise_N_m": 4.0e-6 * too_much, "speed_rad_per_s": 0.3}, ("rise_N_m",), True)
    fitted = whitener.apply(found.jacobian)
    places, columns, groups = sized_columns(problem, found.u, [place], fitted, whitener)
    white, residual = whitener.apply(columns), whitener.apply(found.residual)
    scores = score(fitted, problem.prior_weights(), found.u, white, groups, residual, 0.01, 0)
    assert scores.gains[0] > 60.0
    assert scores.amplitudes[0][0] * places[0].start["rise_N_m"] == pytest.approx(4.0e-6, rel=0.4)
    assert np.sqrt(scores.projected[0, 0]) < 1.1 * LARGEST
