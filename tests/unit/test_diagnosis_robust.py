"""Scatter by blocks: 1 for stationary noise, more where a column lives where the noise is strong."""

import numpy as np
import pytest

from hil_forceps.diagnosis.robust import inflations, left_by
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


def test_a_column_that_holds_nothing_explains_nothing() -> None:
    rng = np.random.default_rng(2)
    fitted = rng.standard_normal((500, 3)).astype(np.float32)
    fitted[:, 1] = 0.0
    columns = rng.standard_normal((500, 2)).astype(np.float32)
    left = left_by(fitted, columns)
    assert np.all(np.isfinite(left))
    assert np.abs(fitted.T @ left).max() < 1e-3
    assert np.array_equal(left_by(np.zeros((500, 1), np.float32), columns), columns)
