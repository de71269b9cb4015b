"""Scatter by blocks: 1 for stationary noise, more where a column lives where the noise is strong."""

import numpy as np
import pytest

from hil_forceps.diagnosis.robust import inflations
from hil_forceps.diagnosis.score import Group
from hil_forceps.diagnosis.spectrum import Layout, fill, make_layout

ROWS, RUNS = 3000, 4


def layout() -> Layout:
    return make_layout([("theta_j_rad",)] * RUNS, [np.ones(ROWS)] * RUNS, [1e-3] * RUNS)


@pytest.mark.parametrize(("strength", "low", "high"), [(1.0, 1.0, 1.9), (3.0, 5.0, 17.0)])
def test_a_column_where_noise_is_strong_meets_more_of_it(strength: float, low: float, high: float) -> None:
    where = layout()
    rng = np.random.default_rng(1)
    dwell = np.sin(np.arange(ROWS) / 90.0) > 0.8
    column = np.zeros((where.size, 2), dtype=np.float32)
    noise = np.zeros(where.size, dtype=np.float32)
    for part in where.parts:
        fill(column[:, 0], part, np.where(dwell, rng.standard_normal(ROWS), 0.0))
        fill(column[:, 1], part, np.where(dwell, 0.0, rng.standard_normal(ROWS)))
        fill(noise, part, np.where(dwell, strength, 1.0) * rng.standard_normal(ROWS))
    fitted = rng.standard_normal((where.size, 1)).astype(np.float32)
    groups = [Group(0, 1, one_sided=False), Group(1, 2, one_sided=False)]
    found = inflations(where, fitted, column, groups, noise)
    assert low <= found[0] <= high
    assert 1.0 <= found[1] <= 1.9
