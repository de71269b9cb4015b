"""A limit that clips the tips of a few peaks is found by the simulation itself, where no step leads."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hil_forceps.diagnosis.anew import refresher
from hil_forceps.diagnosis.current_limit import LIMIT, NARROW, deepest_limits
from hil_forceps.diagnosis.diagnose import Options, fit_baseline, without_load_noise
from hil_forceps.diagnosis.experiment import prepare
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.fit import fit
from hil_forceps.diagnosis.spectrum import Whitener
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
    assert all(limit > 0.995 * free_A for limit in deepest_limits(baseline.problem, baseline.fit.u, whitener, free_A))
    _, clipped, whitener, _ = fitted(CLIPPED * free_A)
    (found_A,) = deepest_limits(clipped.problem, clipped.fit.u, whitener, free_A)
    assert found_A == pytest.approx(CLIPPED * free_A, abs=1.1 * free_A * float(NARROW[0] - NARROW[1]))


@pytest.mark.long
def test_a_limit_fits_only_beside_a_rounding_that_was_taken_with_it() -> None:
    free_A, _, _, _ = fitted(None)
    _, clipped, whitener, assumed = fitted(CLIPPED * free_A)
    base = clipped.problem.base.copy()
    base[LIMIT] = CLIPPED * free_A
    stale = replace(clipped.problem, base=base)
    fresh = refresher(assumed)(stale, clipped.fit.u)
    without, before, after = (
        fit(problem, clipped.fit.u, whitener, steps=0).chi2 for problem in (clipped.problem, stale, fresh)
    )
    assert after < without - 1000.0
    assert before > without + 1000.0
