"""Columns of parameters are derivatives: the step of the finite difference doesn't matter, where masses turn, too."""

import numpy as np
import pytest

from hil_forceps.diagnosis.evidence import Direction, pass_all
from hil_forceps.diagnosis.state_space.passes import Matrix
from hil_forceps.model import parameters
from tests.hidden_effects.generator import RIG
from tests.unit.diagnosis.simulated_runs import POOL, known_of, records_of, runs_of

# Little friction on a wire that rings: the motor turns within a row, hundreds of times.
RINGING = RIG.with_changes({"encoder.counts_per_rev": 4096, "forceps.motor_coulomb_N_m": 5e-6})
PARAMETERS = (
    "forceps.jaw_pulley_radius_m",
    "forceps.wire_stiffness_N_per_m",
    "motor.torque_constant_N_m_per_A",
    "forceps.motor_coulomb_N_m",
    "forceps.motor_viscous_N_m_s_per_rad",
)
MAX_CHANGE_SHARE = 1e-3  # of a column: twenty times what it is


@pytest.fixture(scope="module", name="columns")
def columns_by_share() -> dict[float, Matrix]:
    """Return the columns of `PARAMETERS` by the share of a parameter that they are differences over."""
    theta, free = parameters.vector(RINGING), known_of(RINGING)
    passes = pass_all(records_of(runs_of(RINGING, ("slow", "trapezoid"), 10100), RINGING), theta, POOL.map)
    found = {}
    for share in (1e-6, 1e-5):
        directions = []
        for f in (next(f for f in free if f.name == name) for name in PARAMETERS):
            changed, step = theta.copy(), share * theta[f.place]
            changed[f.place] += step
            directions.append(Direction(changed, f.scale / step))
        found[share] = np.concatenate([run.answers(passes.plant, directions).astype(np.float64) for run in passes.runs])
    return found


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_difference_ten_times_as_large_is_ten_times_as_large(columns: dict[float, Matrix], name: str) -> None:
    """Where a step of the plant jumps, one row changes a column by more than all others together."""
    at = PARAMETERS.index(name)
    small, large = (columns[share][:, at] for share in (1e-6, 1e-5))
    assert np.linalg.norm(large - small) < MAX_CHANGE_SHARE * np.linalg.norm(small)
