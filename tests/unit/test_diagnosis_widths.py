"""A dead zone is sought at other widths, and inertias at the rig's word: a fit stays where it begins."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.anew import refresher
from hil_forceps.diagnosis.assemble import assemble
from hil_forceps.diagnosis.options import Options, without_load_noise
from hil_forceps.diagnosis.experiment import prepare
from hil_forceps.diagnosis.fit import chi2_of, fit
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.ringing import INERTIA, MOTOR_INERTIA, at_the_rig_s_word, moved_to
from hil_forceps.diagnosis.spectrum import Whitener, white_noise
from hil_forceps.diagnosis.unknowns import Unknown, Unknowns
from hil_forceps.diagnosis.widths import BETTER, FACTORS, at_better_widths
from tests.hidden_effects.generator import RIG, make_case

Vector = NDArray[np.float64]

WIDTH_M = 4e-7


def slack(start_m: float) -> tuple[Problem, Vector, Whitener]:
    """Problem of a run made with a slack, where a fit begins that takes it to be `start_m` wide, and noise."""
    case = make_case({"wire_slack": {"half_width_m": WIDTH_M}}, 43, scenarios=(("multisine",), ()))
    records, _ = without_load_noise(prepare(case.fit, RIG)[0], [], RIG, Options())
    setting = assemble(records, RIG, map)
    shared = setting.problem.shared.with_effect("wire_slack", {"half_width_m": start_m}, {"half_width_m": 0.0})
    problem = setting.problem.with_shared(shared)
    return problem, np.zeros(problem.size), problem.whitener(white_noise(problem.layout, 3.0 * setting.first_power))


def width_of(problem: Problem, u: Vector) -> float:
    return float(problem.shared.values(u[: len(problem.shared.items)])[-1])


@pytest.mark.parametrize("start_m", [1.5e-7, 1.2e-6])
def test_a_dead_zone_gets_as_wide_as_it_is(start_m: float) -> None:
    problem, u, whitener = slack(start_m)
    found = fit(problem, u, whitener, steps=0)
    wider, v = at_better_widths(problem, found, whitener, refresher(RIG))
    assert abs(np.log(width_of(wider, v) / WIDTH_M)) < 0.5 * np.log(max(FACTORS))
    chi2 = [chi2_of(wider, wider.measured - wider.predicted(at), whitener, at) for at in (found.u, v)]
    assert chi2[1] < chi2[0] - BETTER
    assert wider.simulate_runs is not problem.simulate_runs  # the rounding is taken beside the new width


def test_without_a_dead_zone_nothing_is_tried() -> None:
    problem, u, whitener = slack(WIDTH_M)
    bare = problem.with_shared(Unknowns(problem.shared.items[:-1]))
    found = fit(bare, np.delete(u, len(bare.shared.items)), whitener, steps=0)
    same, v = at_better_widths(bare, found, whitener, refresher(RIG))
    assert same is bare
    assert v is found.u


def pulled(problem: Problem, deviations: float) -> tuple[Problem, Vector]:
    """Hold the jaw's inertia to a valley 15 % above the rig's word, and the motor's that far below it."""
    names, items = problem.shared.names, problem.shared.items
    jaw, motor = names.index(INERTIA), names.index(MOTOR_INERTIA)
    there: Unknown = items[jaw]._replace(centre=1.15 * items[jaw].centre, precision=9.0)
    held = problem.with_shared(Unknowns((*items[:jaw], there, *items[jaw + 1 :])))
    u = np.zeros(held.size)
    u[motor] = -deviations
    return held, u


def test_inertias_far_from_the_rig_s_word_begin_there_again() -> None:
    problem, _, _ = slack(WIDTH_M)
    names = problem.shared.names
    jaw, motor = names.index(INERTIA), names.index(MOTOR_INERTIA)
    held, u = pulled(problem, 4.0)
    again = at_the_rig_s_word(held, u)
    assert again is not None
    back, v = again
    assert back.shared.items[jaw] == problem.shared.items[jaw]
    assert v[[jaw, motor]] == pytest.approx([0.0, 0.0])
    assert np.array_equal(np.delete(v, [jaw, motor]), np.delete(u, [jaw, motor]))
    assert at_the_rig_s_word(*pulled(problem, 2.0)) is None
    assert at_the_rig_s_word(back, moved_to(back, u, motor, 0.5 * problem.shared.items[motor].centre)) is None
    assert at_the_rig_s_word(problem.with_shared(Unknowns(())), u) is None
