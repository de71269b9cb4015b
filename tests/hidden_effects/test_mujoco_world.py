"""Effects that MuJoCo's own parameters hide are found with their sizes, beside dry friction, too."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.diagnosis.identification import identify
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.validation.verdict import judge
from hil_forceps.rig import Rig
from tests.hidden_effects.generator import RIG
from tests.hidden_effects.generator_scenarios import SCENARIOS
from tests.hidden_effects.mujoco_world import NOTHING, STEP_S, Hidden, mujoco_run

POOL = ThreadPoolExecutor(2)
# Friction that the rig says and MuJoCo has none of would be found as such.
SMOOTH = RIG.with_changes({"forceps.motor_coulomb_N_m": 0.0, "forceps.jaw_coulomb_N_m": 0.0})
STICKING = RIG.with_changes({"forceps.motor_coulomb_N_m": 2e-4, "forceps.jaw_coulomb_N_m": 1e-4})
FITTED, HELD_OUT = ("multisine", "trapezoid", "hold", "teleoperation"), ("chirp", "slow")

pytestmark = pytest.mark.long  # the first test is for the world of the others


@pytest.mark.parametrize("kind", ["multisine", "hold"])
def test_half_the_step_changes_nothing_that_a_sensor_could_tell(kind: str) -> None:
    coarse = mujoco_run(SMOOTH, SCENARIOS[kind], 5)
    fine = mujoco_run(SMOOTH, SCENARIOS[kind], 5, step_s=0.5 * STEP_S)
    np.testing.assert_array_equal(coarse.columns["theta_m_rad"], fine.columns["theta_m_rad"])
    assert np.abs(coarse.columns["theta_j_rad"] - fine.columns["theta_j_rad"]).max() < 1e-3 * RIG.noise.theta_j_rad


def diagnosed(rig: Rig, hidden: Hidden, seed: int) -> tuple[str, tuple[tuple[str, ...], ...], dict[str, float]]:
    """Return verdict, sets, and the parameters of what is named."""
    runs = [mujoco_run(rig, SCENARIOS[kind], seed + i, hidden) for i, kind in enumerate((*FITTED, *HELD_OUT))]
    even = [EvenRun.whole(run) for run in runs]
    found = judge(identify(even[: len(FITTED)], even[len(FITTED) :], rig, Options(mapper=POOL.map)), rig)
    values = {name: p.value for effect in found.effects for name, p in effect.parameters.items()}
    return found.verdict, found.sets, values


@pytest.mark.parametrize("rig", [SMOOTH, STICKING], ids=["no friction", "friction a tenth of the load"])
def test_nothing_is_named_where_nothing_is_hidden(rig: Rig) -> None:
    assert diagnosed(rig, NOTHING, 100)[0] in {"consistent", "parameters"}


HIDDEN = [
    (SMOOTH, Hidden("jaw_viscous_friction", {"viscosity_N_m_s_per_rad": 1e-6})),
    (STICKING, Hidden("jaw_viscous_friction", {"viscosity_N_m_s_per_rad": 5e-6})),
    (STICKING, Hidden("jaw_gravity", {"cosine_N_m": 2e-5})),
    (STICKING, Hidden("jaw_coupling", {"stiffness_N_m_per_rad": 2e-5, "torque_N_m": 1e-5})),
    (STICKING, Hidden("wire_slack", {"half_width_m": 8e-6})),
    (STICKING, Hidden("actuation_delay", {"delay_s": 5e-4})),
]


@pytest.mark.parametrize(("rig", "hidden"), HIDDEN, ids=[hidden.effect_id for _, hidden in HIDDEN])
def test_what_mujoco_hides_is_named_with_its_size(rig: Rig, hidden: Hidden) -> None:
    verdict, sets, values = diagnosed(rig, hidden, 300)
    assert verdict == "effects"
    assert sets[0] == (hidden.effect_id,)
    for name, value in hidden.values.items():
        assert values[name] == pytest.approx(value, rel=0.08)
