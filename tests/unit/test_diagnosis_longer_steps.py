"""Sensitivities in longer steps say the way of a fit; the encoder's rounding is taken on from where it was."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.anew import refresher
from hil_forceps.diagnosis.diagnose import Options, fit_baseline
from hil_forceps.diagnosis.experiment import prepare
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.predict import ClosedLoop
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.spectrum import Whitener
from hil_forceps.diagnosis.unknowns import STEP
from tests.hidden_effects.generator import RIG, generate, true_rig
from tests.hidden_effects.generator_scenarios import SCENARIOS


@pytest.fixture(scope="module")
def fitted() -> tuple[Model, Whitener]:
    """Known parameters fitted to two short runs."""
    true = true_rig(RIG, {}, {})
    runs = [generate(true, replace(SCENARIOS[kind], duration_s=3.0), 7, name=kind) for kind in ("multisine", "chirp")]
    _, _, baseline, whitener = fit_baseline(prepare(runs, RIG)[0], RIG, Options())
    return baseline, whitener


def test_longer_steps_say_the_same_way_but_not_what_a_parameter_explains(fitted: tuple[Model, Whitener]) -> None:
    model, whitener = fitted
    problem, u = model.problem, model.fit.u
    outputs = problem.simulate(u)
    exact, coarse = (whitener.apply(problem.jacobian(u, outputs, coarsely=how)) for how in (False, True))
    size, other = np.linalg.norm(exact, axis=0), np.linalg.norm(coarse, axis=0)
    telling = size > 1.0
    assert telling.sum() > 5
    cosine = np.sum(exact * coarse, axis=0)[telling] / (size * other)[telling]
    assert cosine.min() > 0.98
    assert np.abs(exact - coarse).max() > 0.0
    # Without longer steps they are differences of the simulation itself, to the last bit.
    moved = u.copy()
    moved[0] += STEP
    after = problem.simulate(moved)
    channel = "theta_m_rad"
    there = problem.shared_columns(u, outputs, [0])[:, 0]
    part = next(p for p in problem.layout.parts if p.run == 0 and p.channel == channel)
    weighed = (after[0][channel] - outputs[0][channel]) / STEP * part.weights
    spectrum = np.fft.rfft(weighed) * part.scale
    seen = there[part.start : part.stop].view(np.complex64)
    np.testing.assert_allclose(seen[1:], spectrum[1:], rtol=1e-4, atol=1e-6 * float(np.abs(spectrum).max()))


def test_a_rounding_is_taken_on_from_where_it_was(fitted: tuple[Model, Whitener]) -> None:
    model, _ = fitted
    refresh = refresher(RIG)

    def rounding(problem: Problem) -> tuple[NDArray[np.float64], ...]:
        loop = problem.simulate_runs
        assert isinstance(loop, ClosedLoop)
        return loop.encoder_error_rad

    before = model.problem.simulate_runs
    assert isinstance(before, ClosedLoop)
    cold = replace(model.problem, simulate_runs=before.unshaken())
    end = model.problem
    for _ in range(10):
        end = refresh(end, model.fit.u)
    each = (rounding(refresh(problem, model.fit.u)) for problem in (cold, model.problem))
    for anew, taken_on, settled in zip(*each, rounding(end), strict=True):
        size = float(np.linalg.norm(settled))
        assert np.linalg.norm(anew - settled) < 0.05 * size
        assert np.linalg.norm(taken_on - settled) < 0.5 * np.linalg.norm(anew - settled)
