"""Sensitivities are those of a load that is swung: what its noise leads to is no evidence."""

import numpy as np
import pytest

from hil_forceps.diagnosis import shaking
from hil_forceps.diagnosis.anew import refresher
from hil_forceps.diagnosis.options import Options, fit_baseline, without_load_noise
from hil_forceps.diagnosis.hypotheses.entries import Probe
from hil_forceps.diagnosis.experiment import prepare
from hil_forceps.diagnosis.extension import extend
from hil_forceps.diagnosis.fit import fit, hold
from hil_forceps.diagnosis.predict import ClosedLoop
from tests.hidden_effects.generator import make_case

HALF_WIDTH_M = 1.4e-7
TURNS = 2  # what rounding did is taken anew with the width that is found, as a diagnosis does: narrow by 8 %, then by 5
STRAIGHT, BENT = ("slow", "trapezoid"), ("grasp", "teleoperation")  # as their loads are


def found_width_m(kinds: tuple[str, str]) -> tuple[float, ClosedLoop]:
    """Return the width of a slack as it is fitted, and the simulation that it was fitted with."""
    case = make_case({"wire_slack": {"half_width_m": HALF_WIDTH_M}}, 10401, scenarios=(kinds, ()))
    records, _ = prepare(case.fit, case.assumed)
    records, _ = without_load_noise(records, [], case.assumed, Options())
    _, _, baseline, whitener = fit_baseline(records, case.assumed, Options())
    probe = Probe("wire_slack", {"half_width_m": HALF_WIDTH_M}, ("half_width_m",), False)
    held = hold(baseline.fit.jacobian, len(baseline.problem.shared.items), whitener)
    model = extend(baseline, probe, np.ones(1), whitener, held)
    problem, fitted = model.problem, model.fit
    for _ in range(TURNS):
        problem = refresher(case.assumed)(problem, fitted.u)
        fitted = fit(problem, fitted.u, whitener, steps=6)
    place = problem.shared.names.index("effects.wire_slack.half_width_m")
    assert isinstance(problem.simulate_runs, ClosedLoop)
    return float(problem.shared.values(fitted.u[: len(problem.shared.items)])[place]), problem.simulate_runs


@pytest.mark.long
@pytest.mark.parametrize(("kinds", "most"), [(STRAIGHT, 0.05), (BENT, 0.1)], ids=["straight", "bent"])
def test_a_slack_is_as_wide_as_it_is(kinds: tuple[str, str], most: float) -> None:
    width_m, _ = found_width_m(kinds)
    assert width_m == pytest.approx(HALF_WIDTH_M, rel=most)


@pytest.mark.long
def test_swung_loads_make_a_slack_wider(monkeypatch: pytest.MonkeyPatch) -> None:
    width_m, loop = found_width_m(BENT)
    up, down = loop.stand_ins
    for record, high, low in zip(loop.calmed().records, up.records, down.records, strict=True):
        assert record.tau_w_N_m is not None
        assert high.tau_w_N_m is not None
        assert low.tau_w_N_m is not None
        np.testing.assert_allclose(0.5 * (high.tau_w_N_m + low.tau_w_N_m), record.tau_w_N_m, atol=1e-12)
        swing = float(np.std(0.5 * (high.tau_w_N_m - low.tau_w_N_m)) / np.std(record.tau_w_N_m))
        assert 0.02 < swing <= shaking.MOST_SWING * 1.001
    monkeypatch.setattr(shaking, "SWING", 0.0)
    without_m, _ = found_width_m(BENT)
    assert without_m < min(0.85 * HALF_WIDTH_M, 0.97 * width_m)
