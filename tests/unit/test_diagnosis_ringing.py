"""The jaw's inertia is found by how the wire rings, from further off than a linear step would find it."""

from dataclasses import replace

import numpy as np
import pytest

from hil_forceps.diagnosis.assemble import assemble
from hil_forceps.diagnosis.diagnose import Options, without_load_noise
from hil_forceps.diagnosis.experiment import prepare
from hil_forceps.diagnosis.fit import fit
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.ringing import INERTIA, in_deepest_valley
from hil_forceps.diagnosis.spectrum import Whitener, white_noise, whitening
from tests.hidden_effects.generator import RIG, make_case


def beside(factor: float, scenario: str) -> tuple[Problem, Whitener]:
    """Problem of a run made with that much of the inertia, and noise as loud as the misfit."""
    case = make_case({}, 41, scenarios=((scenario,), ()), shifts={INERTIA: factor})
    records, _ = without_load_noise(prepare(case.fit, RIG)[0], [], RIG, Options())
    setting = assemble(records, RIG, map)
    problem = setting.problem
    return problem, whitening(problem.layout, white_noise(problem.layout, 30.0 * setting.first_power))


def inertia_of(problem: Problem, u: np.ndarray) -> float:
    return float(problem.shared.values(u[: len(problem.shared.items)])[problem.shared.names.index(INERTIA)])


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_a_valley_far_off_is_found_and_held(factor: float) -> None:
    problem, whitener = beside(factor, "trapezoid")
    true = factor * RIG.plant().jaw_inertia_kg_m2
    rough = fit(problem, np.zeros(problem.size), whitener, steps=10).u
    place = problem.shared.names.index(INERTIA)
    astray = rough.copy()  # some valleys off, where a fit may end
    item = problem.shared.items[place]
    astray[place] = (1.1 * true - item.centre) / item.scale
    found, u = in_deepest_valley(problem, astray, whitener)
    assert inertia_of(found, u) == pytest.approx(true, rel=0.01)
    assert inertia_of(found, fit(found, u, whitener, steps=6).u) == pytest.approx(true, rel=0.01)
    assert found.shared.items[place].assumed == item.assumed  # a shift is told against what the rig says
    assert np.delete(u, place) == pytest.approx(np.delete(rough, place))


def test_without_a_valley_nothing_changes() -> None:
    problem, whitener = beside(1.0, "rest")
    u = np.zeros(problem.size)
    assert in_deepest_valley(problem, u, whitener) == (problem, u)
    deaf = replace(problem, simulate_runs=problem.simulate_runs.coarse(), shared=type(problem.shared)(()))
    assert in_deepest_valley(deaf, u, whitener) == (deaf, u)
