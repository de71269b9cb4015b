"""The jaw's inertia is found by how the wire rings, from further off than a linear step would find it."""

from dataclasses import replace

import numpy as np
import pytest

from hil_forceps.diagnosis.assemble import assemble
from hil_forceps.diagnosis.options import Options, without_load_noise
from hil_forceps.diagnosis.experiment import prepare
from hil_forceps.diagnosis.fit import fit
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.ringing import (
    INERTIA,
    beside_own_unknowns,
    deepest_valley,
    in_deepest_valley,
    in_valley_of,
    moved_to,
    out_of_a_wrong_valley,
)
from hil_forceps.diagnosis.spectrum import Whitener, white_noise, whitening
from hil_forceps.diagnosis.unknowns import Unknowns
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


@pytest.mark.parametrize("off", [0.95, 1.05])
def test_instants_of_jumps_that_suit_a_wrong_inertia_do_not_hold_it_there(off: float) -> None:
    problem, whitener = beside(1.0, "trapezoid")
    true = RIG.plant().jaw_inertia_kg_m2
    place, count = problem.shared.names.index(INERTIA), len(problem.shared.items)
    wrong = moved_to(problem, np.zeros(problem.size), place, off * true)
    bare = replace(problem.with_shared(Unknowns(())), base=problem.theta(wrong))
    u = np.concatenate((wrong[:count], fit(bare, wrong[count:], whitener, steps=6).u))
    valley = deepest_valley(problem, u, whitener)
    assert valley is not None
    u = moved_to(problem, u, place, valley.inertia_kg_m2)
    found = beside_own_unknowns(problem, u, place, whitener)
    assert abs(valley.inertia_kg_m2 / true - 1.0) > 0.01
    assert inertia_of(problem, found) == pytest.approx(true, rel=0.01)  # with this noise its deviation is 0.7 %
    assert np.delete(found[:count], place) == pytest.approx(np.delete(u[:count], place))


def test_an_inertia_pulled_from_its_valley_is_sought_anew_and_one_that_is_not_stays() -> None:
    problem, whitener = beside(1.0, "trapezoid")
    true = RIG.plant().jaw_inertia_kg_m2
    place, count = problem.shared.names.index(INERTIA), len(problem.shared.items)
    item = problem.shared.items[place]
    wrong = item._replace(centre=1.1 * true, precision=(item.scale / (0.005 * true)) ** 2, prior=True)
    held = problem.with_shared(Unknowns((*problem.shared.items[:place], wrong, *problem.shared.items[place + 1 :])))
    pulled = moved_to(held, np.zeros(held.size), place, 1.03 * true)
    assert inertia_of(held, fit(held, pulled, whitener, steps=8).u) > 1.01 * true
    found, u = out_of_a_wrong_valley(held, pulled, whitener)
    assert inertia_of(found, u) == pytest.approx(true, rel=0.01)
    assert inertia_of(found, fit(found, u, whitener, steps=8).u) == pytest.approx(true, rel=0.01)
    assert found.shared.items[place].assumed == item.assumed
    there, v = in_valley_of(found, u, held, pulled)
    assert inertia_of(there, v) == pytest.approx(inertia_of(found, u), rel=1e-9)
    assert np.array_equal(v[count:], u[count:])
    assert there.shared.items[place] == found.shared.items[place]
    still = moved_to(held, pulled, place, 1.09 * true)
    assert out_of_a_wrong_valley(held, still, whitener) == (held, still)
    assert in_valley_of(held, pulled, held, still) == (held, still)


def test_without_a_valley_nothing_changes() -> None:
    problem, whitener = beside(1.0, "rest")
    u = np.zeros(problem.size)
    assert in_deepest_valley(problem, u, whitener) == (problem, u)
    deaf = replace(problem, simulate_runs=problem.simulate_runs.coarse(), shared=type(problem.shared)(()))
    assert in_deepest_valley(deaf, u, whitener) == (deaf, u)
