import numpy as np
import pytest

from hil_forceps.diagnosis.preparation.load_prior import load_prior

NOISE = 1e-5
PERIOD_S = 1e-3


def measured(load: np.ndarray, seed: int = 0) -> np.ndarray:
    return load + NOISE * np.random.default_rng(seed).standard_normal(load.size)


def rows_with(variance: np.ndarray) -> np.ndarray:
    """Rows whose variance stands far above the usual."""
    return np.flatnonzero(variance > 100.0 * np.median(variance) + 1e-30)


def test_a_jump_is_found_at_its_row_and_with_its_size() -> None:
    load = np.where(np.arange(4000) < 1700, 0.0, 1.5e-3)
    prior = load_prior(measured(load), NOISE**2, PERIOD_S)
    rows = rows_with(prior.jump_variance)
    assert rows.size > 0
    assert np.abs(rows - 1699).max() <= 1
    assert np.sqrt(prior.jump_variance.sum()) == pytest.approx(1.5e-3, rel=0.1)
    assert np.abs(prior.course_N_m - load)[[1600, 1690, 1710, 1800]].max() < 3e-6


def test_bends_of_straight_pieces_are_found_and_the_rest_is_next_to_straight() -> None:
    knots, levels = [0, 900, 1500, 2600, 4000], [0.0, 0.0, 1e-3, 1e-3, -5e-4]
    load = np.interp(np.arange(4000), knots, levels)
    prior = load_prior(measured(load), NOISE**2, PERIOD_S)
    rows = rows_with(prior.slope_variance)
    for bend in (900, 1500, 2600):
        assert np.abs(rows - bend).min() <= 20
    assert prior.open_sd_N_m < 0.2 * NOISE
    assert np.std(prior.course_N_m - load) < 0.1 * NOISE


def test_a_load_that_wanders_has_no_breaks() -> None:
    time = np.arange(6000) * PERIOD_S
    load = 1e-3 * np.sin(2.0 * np.pi * 0.7 * time) + 3e-4 * np.sin(2.0 * np.pi * 2.1 * time + 1.0)
    prior = load_prior(measured(load), NOISE**2, PERIOD_S)
    assert rows_with(prior.jump_variance).size == 0
    assert np.std(prior.course_N_m - load) < 0.4 * NOISE


def test_the_unit_of_the_load_makes_no_difference() -> None:
    load = np.interp(np.arange(3000), [0, 1000, 1400, 3000], [0.0, 0.0, 1e-3, 1e-3])
    one = load_prior(measured(load), NOISE**2, PERIOD_S)
    other = load_prior(1000.0 * measured(load), (1000.0 * NOISE) ** 2, PERIOD_S)
    assert other.course_N_m == pytest.approx(1000.0 * one.course_N_m, rel=1e-3, abs=1e-3 * NOISE * 1000.0)
