"""At the true parameters innovations are white; their answers to parameters are those of the filter itself."""

from collections.abc import Callable

import numpy as np
import pytest

from hil_forceps.diagnosis.evidence import Passes, gram, pass_all
from hil_forceps.diagnosis.inference.fit import directions_of, fit
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.diagnosis.state_space.layout import CURRENT, ENCODER, JAW, LOAD_CELL
from hil_forceps.diagnosis.state_space.response_pass import response_run
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from tests.hidden_effects import generator_scenarios
from tests.hidden_effects.generator import RIG
from tests.unit.diagnosis.simulated_runs import (
    POOL,
    STICKING,
    begun_in_the_friction_band,
    held,
    known_of,
    records_of,
    runs_of,
)

HELD, BEGUN = "held_for_a_test", "begun_for_a_test"


@pytest.fixture(autouse=True)
def scenarios(monkeypatch: pytest.MonkeyPatch) -> None:
    makers: dict[str, Callable[..., generator_scenarios.Course]] = {HELD: held, BEGUN: begun_in_the_friction_band}
    for name, maker in makers.items():
        monkeypatch.setitem(generator_scenarios.KINDS, name, maker)
        monkeypatch.setitem(generator_scenarios.SCENARIOS, name, generator_scenarios.Scenario(name))


def passes_of(rig: Rig, kinds: tuple[str, ...], seed: int) -> Passes:
    return pass_all(records_of(runs_of(rig, kinds, seed), rig), parameters.vector(rig), POOL.map)


def innovations(passes: Passes, channel: int) -> np.ndarray:
    return np.concatenate([r.filtered.residual[:, channel][r.counts[:, channel]] for r in passes.runs])


@pytest.mark.parametrize(
    ("rig", "kinds"),
    [(RIG, ("multisine", "trapezoid", "chirp", "slow")), (STICKING, ("teleoperation", HELD, BEGUN, "multisine"))],
    ids=["next to no friction", "friction a tenth of the load"],
)
def test_innovations_at_the_true_parameters_are_white(rig: Rig, kinds: tuple[str, ...]) -> None:
    passes = passes_of(rig, kinds, 7000)
    for channel in (JAW, LOAD_CELL, CURRENT):
        values = innovations(passes, channel)
        # Four standard deviations of variance and correlation of as many white numbers; 3 % for what is approximated.
        allowed = 4.0 / np.sqrt(values.size)
        assert np.mean(values**2) == pytest.approx(1.0, abs=1.5 * allowed + 0.06)
        assert abs(np.mean(values[1:] * values[:-1])) < allowed + 0.03
    counts = innovations(passes, ENCODER)
    assert abs(np.mean(counts[1:] * counts[:-1])) < 0.05
    assert np.mean(counts**2) < 1.0


def test_without_the_law_of_dry_friction_a_hold_is_no_evidence() -> None:
    passes = passes_of(STICKING, (HELD,), 7100)
    run = passes.runs[0]
    assert run.counts[3000:6500, :CURRENT].mean() < 0.05
    assert run.counts[3000:6500, CURRENT].all()


def test_answers_to_known_parameters_are_the_filters_own() -> None:
    """Two whole passes beside each other, each with gains of its own, against the linear answer along one course."""
    passes = passes_of(RIG, ("multisine",), 7200)
    records = records_of(runs_of(RIG, ("multisine",), 7200), RIG)
    free = known_of(RIG)
    for name in ("motor_viscous", "wire_stiffness", "torque_constant", "jaw_pulley"):
        place = next(i for i, f in enumerate(free) if name in f.name)
        direction = directions_of(free, passes.theta)[place]
        run = passes.runs[0]
        answer = response_run(physics_of(direction.theta), passes.plant, run.series, run.filtered, direction.per)
        step = 2e-4 * free[place].scale
        moved = passes.theta.copy()
        moved[free[place].place] += step
        other = pass_all(records, moved, POOL.map).runs[0]
        both = run.counts[:, JAW] & other.counts[:, JAW]
        change = (other.filtered.residual - run.filtered.residual)[both, JAW] * free[place].scale / step
        # The other pass weighs counts by how far they are from its own edges: some 10 % of it, seen in all of these.
        assert np.linalg.norm(change - answer[both, JAW]) < 0.2 * np.linalg.norm(change), name


def test_holds_and_starts_in_the_friction_band_leave_the_parameters_right() -> None:
    off = {"forceps.wire_stiffness_N_per_m": 2.3e4, "forceps.motor_viscous_N_m_s_per_rad": 1.3e-4}
    runs = runs_of(STICKING, (HELD, "teleoperation", BEGUN, "multisine"), 7300)
    assumed = STICKING.with_changes(off)
    found = fit(records_of(runs, assumed), parameters.vector(assumed), known_of(assumed), POOL.map)
    truth = parameters.vector(STICKING)
    for f, value, deviation in zip(found.free, found.values, found.deviations, strict=True):
        true = truth[f.place]
        assert abs(value - true) < 5.0 * deviation, f.name
        assert abs(value - true) < 0.08 * true, f.name
    for name in ("wire_stiffness", "torque_constant", "motor_coulomb", "jaw_coulomb", "motor_viscous"):
        place = next(i for i, f in enumerate(found.free) if name in f.name)
        assert found.values[place] == pytest.approx(truth[found.free[place].place], rel=0.01)


def test_scores_at_the_true_parameters_scatter_as_the_information_says() -> None:
    passes = passes_of(RIG, ("multisine", "chirp", "slow", "spin", "teleoperation", "multisine_mid"), 7400)
    free = known_of(RIG)
    found = gram(passes, directions_of(free, passes.theta), POOL.map)
    normed = found.score / np.sqrt(np.diag(found.information))
    assert np.abs(normed).max() < 4.5
