"""One run of several, simulated alone."""

import numpy as np
import pytest

from hil_forceps.diagnosis.anew import refresher
from hil_forceps.diagnosis.assemble import Setting, assemble
from hil_forceps.diagnosis.experiment import prepare
from hil_forceps.diagnosis.experiment_driven import prepare_driven
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.spectrum import transform, transform_one
from tests.hidden_effects.generator import make_case

KINDS = ("slow", "trapezoid")


def _fresh(*, driven: bool) -> Problem:
    """Return a problem of two runs whose simulator has taken the noise of what drives it into account."""
    case = make_case({}, 43, scenarios=(KINDS, ()))
    rig = case.assumed.model_copy(update={"drive": None}) if driven else case.assumed
    records, _ = prepare_driven(case.fit) if driven else prepare(case.fit, rig)
    setting: Setting = assemble(records, rig, map)
    return refresher(rig)(setting.problem, np.zeros(setting.problem.size))


@pytest.mark.parametrize("driven", [False, True])
def test_one_run_alone_is_what_it_is_among_others(driven: bool) -> None:
    problem = _fresh(driven=driven)
    u = np.zeros(problem.size)
    theta, nuisances = problem.theta(u), problem.nuisances(u)
    both = problem.simulate_runs(theta, nuisances)
    for run in (0, 1):
        (alone,) = problem.simulate_runs.only(run)(theta, nuisances[run : run + 1])
        for name, values in both[run].items():
            np.testing.assert_array_equal(alone[name], values)


def test_its_flat_vector_is_zero_in_all_others() -> None:
    problem = _fresh(driven=False)
    outputs = problem.simulate(np.zeros(problem.size))
    whole = transform(problem.layout, outputs)
    apart = [transform_one(problem.layout, run, outputs[run]) for run in (0, 1)]
    np.testing.assert_array_equal(apart[0] + apart[1], whole)
    assert not (apart[0] * apart[1]).any()
