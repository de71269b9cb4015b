"""Rows behind a hold count once the filter has forgotten the error of its load."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from hil_forceps.diagnosis.evidence import pass_all
from hil_forceps.diagnosis.state_space.layout import JAW, LOAD_CELL
from hil_forceps.diagnosis.state_space.passes import LOAD_TIME_CONSTANTS, MAX_MEMORY_ROWS, load_memory_rows
from hil_forceps.model import parameters
from tests.unit.diagnosis.simulated_runs import POOL, STICKING, records_of, runs_of


@pytest.mark.parametrize("slope_variance", [1e-6, 1e-5])
def test_the_memory_is_that_of_the_steady_filter(slope_variance: float) -> None:
    (record,) = records_of(runs_of(STICKING, ("hold",), 7720), STICKING)
    d = record.series
    d = d._replace(load_slope_variance=np.full(d.load_slope_variance.size, slope_variance))
    f, h = np.array([[1.0, d.period_s], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    noise = np.array([[d.noise_variance[LOAD_CELL - 1]]])
    p = solve_discrete_are(f.T, h.T, np.diag([0.0, slope_variance]), noise)
    gain = f @ p @ h.T / (h @ p @ h.T + noise)
    slowest = float(np.abs(np.linalg.eigvals(f - gain @ h)).max())
    rows = load_memory_rows(d)
    assert 3 < rows < MAX_MEMORY_ROWS
    assert rows == pytest.approx(-LOAD_TIME_CONSTANTS / np.log(slowest), abs=1.5)


def test_no_row_counts_until_the_load_is_forgotten() -> None:
    (record,) = records_of(runs_of(STICKING, ("hold",), 7720), STICKING)
    (passed,) = pass_all([record], parameters.vector(STICKING), POOL.map).runs
    d = record.series
    rows = load_memory_rows(d)
    assert rows > d.fading_rows
    ends = np.flatnonzero(d.friction_free_j[:-1] & ~d.friction_free_j[1:])
    assert ends.size
    for end in ends:
        assert not passed.counts[end : end + rows, JAW].any()


def test_without_a_load_cell_there_is_nothing_to_forget() -> None:
    (record,) = records_of(runs_of(STICKING, ("hold",), 7720), STICKING)
    d = record.series
    assert load_memory_rows(d._replace(load_N_m=np.full(d.load_N_m.size, np.nan))) == 0
