"""What is steady shows: the drive's integral hides it in the angle, and the fit adds the integral to the angle."""

import numpy as np
import pytest

from hil_forceps.diagnosis.anew import courses_of
from hil_forceps.diagnosis.options import Options, fit_baseline
from hil_forceps.diagnosis.hypotheses.entries import Probe
from hil_forceps.diagnosis.experiment import prepare
from hil_forceps.diagnosis.validation.heldout import floors_of
from hil_forceps.diagnosis.linear import columns, responses
from hil_forceps.diagnosis.predict import ClosedLoop
from hil_forceps.diagnosis.probing import probe_columns
from hil_forceps.diagnosis.score import score
from hil_forceps.diagnosis.spectrum import Noise, make_layout
from tests.hidden_effects.generator import RIG, make_case

OFFSET_A = 1.5e-4
KINDS = ("multisine", "trapezoid")


def test_a_steady_offset_of_a_seventh_of_the_current_s_noise_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    case = make_case({"current_offset": {"offset_A": OFFSET_A}}, 51, scenarios=(KINDS, ()))
    records, _ = prepare(case.fit, case.assumed)

    def found() -> tuple[float, float]:
        """Return the offset's gain and what it is of the true one."""
        setting, _, baseline, whitener = fit_baseline(records, case.assumed, Options())
        assert setting.simulator.integral_per_s in (pytest.approx(15.0 / 1.2), 0.0)
        problem, fit = baseline.problem, baseline.fit
        place = Probe("current_offset", {"offset_A": OFFSET_A}, ("offset_A",), False)
        columns, groups = probe_columns(problem, fit.u, [place])
        fitted, white = whitener.apply(fit.jacobian), whitener.apply(columns)
        residual = whitener.apply(fit.residual)
        scores = score(fitted, problem.prior_weights(), fit.u, white, groups, residual, 0.01, 0)
        return float(scores.gains[0]), float(scores.amplitudes[0][0])

    gain, amplitude = found()
    monkeypatch.setattr(ClosedLoop, "integral_per_s", 0.0)
    without, _ = found()
    assert gain > 25.0
    assert gain > 4.0 * without
    assert amplitude == pytest.approx(1.0, abs=0.25)


def test_the_linear_loop_says_the_same_of_a_steady_torque() -> None:
    case = make_case({}, 52, scenarios=(("multisine",), ()))
    records, _ = prepare(case.fit, case.assumed)
    setting, _, baseline, _ = fit_baseline(records, case.assumed, Options())
    simulator, problem = setting.simulator, baseline.problem
    assert isinstance(simulator, ClosedLoop)
    courses = courses_of(setting, baseline)
    answers = responses(RIG.plant(), RIG.require_drive(), courses[0].time_s.size, 1.0e-3, simulator.integral_per_s)
    torque = [-1.35e-2 * OFFSET_A * np.ones_like(courses[0].time_s)]
    linear = columns(problem.layout, [answers], "motor", [each[None] for each in torque])[:, 0]
    place = Probe("current_offset", {"offset_A": OFFSET_A}, ("offset_A",), False)
    simulated = probe_columns(problem, baseline.fit.u, [place])[0][:, 0]
    motor = next(part for part in problem.layout.parts if part.channel == "theta_m_rad")
    # The offset of a sensor acts like a torque; both integrals end at the same, and steady is the first bin.
    assert abs(linear[motor.start]) == pytest.approx(abs(simulated[motor.start]), rel=0.1)


def test_floors_count_the_angle_as_it_was_measured() -> None:
    layout = make_layout([["theta_m_rad", "theta_j_rad"]], [np.ones(4000)], [1e-3])
    motor = np.array([name == "theta_m_rad" for name in layout.band_channel])
    added = 12.5
    summed = 1.0 + (added / (2.0 * np.pi * layout.band_Hz)) ** 2
    power = np.where(motor, 1e-8 * summed, 4e-8)
    floors = floors_of(Noise(power, np.zeros(power.size, dtype=np.complex128)), layout, added)
    assert floors["theta_m_rad"] == pytest.approx(1e-4, rel=1e-6)
    assert floors["theta_j_rad"] == pytest.approx(2e-4, rel=1e-6)
