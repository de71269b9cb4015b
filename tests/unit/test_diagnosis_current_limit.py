"""A limit that clips the tips of a few peaks is found, and takes off what it took off the recorded commands."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hil_forceps.diagnosis.anew import refresher
from hil_forceps.diagnosis.current_limit import NARROW, deepest_limits
from hil_forceps.diagnosis.options import Options, fit_baseline, without_load_noise
from hil_forceps.diagnosis.experiment import prepare
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.fit import fit
from hil_forceps.diagnosis.validation.heldout import play
from hil_forceps.diagnosis.predict import LIMIT, ClosedLoop
from hil_forceps.diagnosis.spectrum import Whitener
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from tests.hidden_effects.generator import make_case

SEED = 11717
KINDS = ("multisine", "trapezoid")
CLIPPED = 0.985  # of the largest current


@cache
def fitted(limit_A: float | None) -> tuple[float, Model, Whitener, Rig]:
    """Return the largest current of runs with a limit hidden in them, what was fitted to them, their noise, the rig."""
    effects = {} if limit_A is None else {"current_saturation": {"limit_A": limit_A}}
    case = make_case(effects, SEED, scenarios=(KINDS, ()))
    records, _ = prepare(case.fit, case.assumed)
    records, _ = without_load_noise(records, [], case.assumed, Options())
    _, _, baseline, whitener = fit_baseline(records, case.assumed, Options())
    largest_A = max(float(np.abs(run.channels["current_A"]).max()) for run in records)
    return largest_A, baseline, whitener, case.assumed


@pytest.mark.long
def test_a_limit_is_found_and_none_where_there_is_none() -> None:
    free_A, baseline, whitener, _ = fitted(None)
    # Noise of the current's sensor lies upon its largest value: a limit there or above clips nothing.
    assert all(limit > 0.995 * free_A for limit in deepest_limits(baseline.problem, baseline.fit.u, whitener))
    _, clipped, whitener, _ = fitted(CLIPPED * free_A)
    (found_A,) = deepest_limits(clipped.problem, clipped.fit.u, whitener)
    assert found_A == pytest.approx(CLIPPED * free_A, abs=1.1 * free_A * float(NARROW[0] - NARROW[1]))


@pytest.mark.long
def test_a_limit_fits_beside_any_rounding() -> None:
    """A limit takes off what it took off recorded commands; what shakes the simulated motor has no part in it."""
    free_A, _, _, _ = fitted(None)
    _, clipped, whitener, assumed = fitted(CLIPPED * free_A)
    base = clipped.problem.base.copy()
    base[LIMIT] = CLIPPED * free_A
    stale = replace(clipped.problem, base=base)
    fresh = refresher(assumed)(stale, clipped.fit.u)
    loop = clipped.problem.simulate_runs
    assert isinstance(loop, ClosedLoop)
    stand_ins = tuple(replace(other, clips_as_recorded=False) for other in loop.stand_ins)
    by_itself = replace(stale, simulate_runs=replace(loop, stand_ins=stand_ins, clips_as_recorded=False))
    without, before, after, own = (
        fit(problem, clipped.fit.u, whitener, steps=0).chi2 for problem in (clipped.problem, stale, fresh, by_itself)
    )
    assert before < without - 1000.0
    assert after == pytest.approx(before, abs=200.0)
    assert own > without + 1000.0
    # In the current's own channel only the sensor's noise is left.
    noise_A = assumed.noise.current_A
    there = stale.simulate(clipped.fit.u)
    left = [own["current_A"] - other["current_A"] for own, other in zip(loop.measured(), there, strict=True)]
    assert all(float(np.std(values)) < 1.05 * noise_A for values in left)


def test_runs_held_out_are_foretold_by_commands_of_the_simulation() -> None:
    """Recorded angles show what a limit did in a run: a model that is judged by that run mustn't look there."""
    case = make_case({}, SEED, scenarios=(("multisine",), ()))
    records, _ = prepare(case.fit, case.assumed)
    theta = parameters.vector(case.assumed)
    theta[LIMIT] = 0.9 * float(np.abs(records[0].channels["current_A"]).max())
    played = play(records, case.assumed, theta, 0.0, map).channels[0]
    assert float(np.max(np.abs(played["current_A"]))) == pytest.approx(theta[LIMIT], rel=1e-9)
