"""Evidence of a pass: Huber's loss, what a pass decides and hands on, and torques that need no step of the model."""

import importlib
from typing import Any

import numba.core.runtime
import numpy as np
import pytest

from hil_forceps.diagnosis.evidence import HUBER, Direction, Passes, Wave, pass_all
from hil_forceps.diagnosis.hypotheses.places import places_of
from hil_forceps.diagnosis.inference.parameters import start_of, with_effect
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.diagnosis.state_space.filter_pass import filter_run
from hil_forceps.diagnosis.state_space.passes import Matrix, Passed
from hil_forceps.diagnosis.state_space.response_pass import response_run
from hil_forceps.model import parameters
from tests.hidden_effects.generator import RIG
from tests.unit.diagnosis.simulated_runs import POOL, STICKING, records_of, runs_of

RUNTIME: Any = numba.core.runtime  # it has no types


@pytest.fixture(scope="module")
def sticking() -> Passes:
    return pass_all(
        records_of(runs_of(STICKING, ("teleoperation",), 7400), STICKING), parameters.vector(STICKING), POOL.map
    )


def with_residuals(run: Passed, residual: Matrix) -> Passed:
    """Return a pass that has these residuals, all of them evidence, of a normal distribution of deviation 1."""
    filtered = run.filtered._replace(residual=residual, log_likelihood=-0.5 * residual**2)
    return run._replace(filtered=filtered, counts=np.ones_like(run.counts))


def test_beyond_three_deviations_the_loss_is_a_line_and_its_slope_the_weighted_residual(sticking: Passes) -> None:
    run = sticking.runs[0]
    residual = run.filtered.residual.copy()
    residual[:, 0] = np.linspace(-40.0, 40.0, residual.shape[0])
    step = 1e-4
    above, below = (with_residuals(run, residual + sign * step).log_likelihood for sign in (1.0, -1.0))
    slope = (above - below) / (2.0 * step)
    np.testing.assert_allclose(-slope, with_residuals(run, residual).influence ** 2 * residual, atol=1e-3)
    assert np.abs(slope).max() == pytest.approx(HUBER, abs=1e-3)


def test_a_model_that_is_far_out_is_worse_the_further_it_is(sticking: Passes) -> None:
    """Of squares that nearly cancel nothing would be left but rounding, and then an overflow."""
    run, found = sticking.runs[0], []
    for size in (1e3, 9e5, 2e6, 1e9, 1e14, 1e120, 1e200):
        residual = np.full_like(run.filtered.residual, size)
        with np.errstate(over="ignore"):
            likelihood = with_residuals(run, residual).log_likelihood
        assert np.isfinite(likelihood).all()
        found.append(float(likelihood.max()))
    assert found[:5] == sorted(found[:5], reverse=True)
    assert len(set(found[:5])) == 5
    assert max(found[4:]) == found[4]


def test_what_does_not_count_has_no_influence(sticking: Passes) -> None:
    run = sticking.runs[0]
    assert not run.influence[~run.counts].any()
    assert (run.influence[run.counts] > 0.0).all()


@pytest.mark.long  # numba compiles for a minute and more
def test_numba_frees_the_arrays_of_a_pass_once(sticking: Passes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no C compiler is. Most functions of a pass count no references to arrays.

    One too many is never freed, one too few is freed twice.
    """
    for name in ("filter_pass", "response_pass", "forcing_pass"):
        module = importlib.import_module(f"hil_forceps.diagnosis.state_space.{name}")
        monkeypatch.setattr(module, name, getattr(module, name).by_numba)
    run, theta = sticking.runs[0], sticking.theta
    further = theta * np.where(np.arange(theta.size) == 0, 1.0 + 1e-4, 1.0)
    RUNTIME._nrt_python.memsys_enable_stats()
    try:
        filter_run(sticking.plant, run.series)
        before = RUNTIME.rtsys.get_allocation_stats()
        for _ in range(3):
            filtered = filter_run(sticking.plant, run.series)
            response_run(physics_of(further), sticking.plant, run.series, filtered, 1.0)
            run.curves(sticking.plant, [("motor", np.ones(run.series.encoder_rad.size))])
        after = RUNTIME.rtsys.get_allocation_stats()
    finally:
        RUNTIME._nrt_python.memsys_disable_stats()
    assert after.mi_alloc > before.mi_alloc
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free


def test_a_pass_that_is_given_its_own_decisions_is_the_same(sticking: Passes) -> None:
    record = records_of(runs_of(STICKING, ("teleoperation",), 7400), STICKING)[0]
    run = sticking.runs[0]
    assert run.filtered.doubtful.any()
    again = pass_all([record.decided_by(run.filtered)], sticking.theta, POOL.map).runs[0]
    for name in ("residual", "course", "doubtful", "surprised"):
        np.testing.assert_array_equal(getattr(again.filtered, name), getattr(run.filtered, name))


def test_given_decisions_hold_for_other_parameters_until_friction_is_another(sticking: Passes) -> None:
    record = records_of(runs_of(STICKING, ("teleoperation",), 7400), STICKING)[0]
    run = sticking.runs[0]
    other = sticking.theta.copy()
    other[parameters.index("forceps.motor_coulomb_N_m")] *= 1.2
    own = pass_all([record], other, POOL.map).runs[0].filtered
    assert (own.doubtful != run.filtered.doubtful).any()  # else the test shows nothing
    decided = record.decided_by(run.filtered)
    passed = pass_all([decided], other, POOL.map).runs[0]
    np.testing.assert_array_equal(passed.filtered.doubtful, run.filtered.doubtful)
    np.testing.assert_array_equal(passed.counts[:, 0], run.counts[:, 0])
    assert not decided.with_friction_of(physics_of(other)).series.switching.given


@pytest.mark.parametrize(
    "wave", [Wave(5.0, False, False, 1e-4), Wave(2.0, True, False, 1e-4), Wave(3.0, True, True, 0.1)]
)
def test_a_wave_answers_as_the_model_with_that_effect_does(wave: Wave) -> None:
    passes = pass_all(records_of(runs_of(RIG, ("multisine",), 7500), RIG), parameters.vector(RIG), POOL.map)
    run = passes.runs[0]
    effect_id, unit = ("torque_ripple", "") if wave.with_current else ("cogging", "_N_m")
    share = 1e-2
    name = ("cosine" if wave.cosine else "sine") + unit
    theta = with_effect(
        passes.theta, effect_id, start_of(effect_id, {"harmonic": wave.harmonic, name: share * wave.amplitude})
    )
    exact, answer = run.answers(passes.plant, [Direction(theta, 1.0 / share)], [wave]).T
    # A torque held over a row instead of one that follows the angle within it: some percent at these speeds.
    assert np.linalg.norm(answer - exact) < 0.08 * np.linalg.norm(exact)


def test_places_and_their_columns_are_in_step() -> None:
    passes = pass_all(records_of(runs_of(RIG, ("multisine",), 7500), RIG), parameters.vector(RIG), POOL.map)
    places, directions, waves = places_of(passes, frozenset())
    taken = sorted(column for place in places for column in range(place.first, place.stop))
    assert taken == list(range(len(directions) + len(waves)))
    for place in places:
        if place.effect_id in {"cogging", "torque_ripple"}:
            sine, cosine = waves[place.first - len(directions)], waves[place.first + 1 - len(directions)]
            assert (sine.cosine, cosine.cosine) == (False, True)
            assert sine.harmonic == place.shape["harmonic"] == cosine.harmonic
