"""A current that clips: by the drive's own limit nothing is named; by one that the rig doesn't have, that limit is."""

from functools import cache

import numpy as np
import pytest

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.diagnosis.identification import identify
from hil_forceps.diagnosis.identified import Identified
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.preparation.command import first_integral
from hil_forceps.diagnosis.validation.verdict import judge
from hil_forceps.model.drive_law import DriveState, law_current, law_vector
from hil_forceps.rig import Rig
from tests.hidden_effects.generator import RIG, true_rig
from tests.unit.diagnosis.simulated_runs import POOL, runs_of

KINDS = ("chirp", "grasp", "teleoperation")
SEED = 7700


@cache
def limit_A() -> float:
    """Return a limit that the current of the runs would pass."""
    return 0.8 * max(float(np.abs(run.columns["current_A"]).max()) for run in runs_of(RIG, KINDS, SEED))


def found_in(true: Rig, rig: Rig) -> Identified:
    runs = [EvenRun.whole(run) for run in runs_of(true, KINDS, SEED)]
    clipped = [float(np.mean(np.abs(even.run.columns["current_A"]) > 0.97 * limit_A())) for even in runs]
    assert max(clipped) > 0.02  # else the test shows nothing
    return identify(runs, [], rig, Options(mapper=POOL.map))


def test_the_drive_s_own_limit_is_no_effect() -> None:
    rig = RIG.with_changes({"drive.current_limit_A": limit_A()})
    assert judge(found_in(rig, rig), rig).verdict == "consistent"


def test_a_limit_that_the_rig_lacks_is_named_with_its_size() -> None:
    true = true_rig(RIG, {"current_saturation": {"limit_A": limit_A()}}, {})
    verdict = judge(found_in(true, RIG), RIG)
    assert [effect.id for effect in verdict.effects] == ["current_saturation"]
    assert verdict.effects[0].parameters["limit_A"].value == pytest.approx(limit_A(), rel=0.01)


@pytest.mark.parametrize("first_rad_s", [0.0, 4e-3, -6e-3])
def test_where_the_integral_began_is_told_by_currents_within_the_limit(first_rad_s: float) -> None:
    law = law_vector(RIG.with_changes({"drive.current_limit_A": limit_A()}).require_drive())
    run = runs_of(RIG, ("grasp",), SEED)[0].columns
    reference, angle = run["theta_m_ref_rad"], run["theta_m_rad"]
    command = law_current(law, reference, angle, DriveState(first_rad_s, float("nan"), 0.0, 0.0))
    noise = 1e-3 * np.random.default_rng(1).standard_normal(command.size)
    current = np.concatenate(([0.0], command[:-1])) + noise
    found = first_integral(law, (reference, angle, current), 1, 1e-3)
    again = law_current(law, reference, angle, DriveState(found.value_rad_s, float("nan"), 0.0, 0.0))
    # As well as the rows before the integral hangs on its limit tell it, and exactly behind that.
    assert np.abs(again - command)[found.forgotten + 1 :].max(initial=0.0) < 1e-12
    assert np.abs(again - command).max() < max(5.0 * found.deviation_A, 1e-5)
