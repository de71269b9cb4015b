"""What a fall of χ² is worth where residuals are white, where they hang together, and where few blocks tell."""

import numpy as np
import pytest
from scipy.signal import lfilter

from hil_forceps.diagnosis.inference.dispersion import Scatter, by_student_t, over_dispersion, scatter, total_scatter

ROWS, BLOCK_ROWS, RUNS = 20_000, 250, 6


def scattered(correlation: float, effect: float = 0.0) -> Scatter:
    """Return the scatter of a slow change beside residuals of unit variance; `effect`: of it that is really there."""
    parts = []
    for run in range(RUNS):
        rng = np.random.default_rng([7, run])
        noise = np.sqrt(1.0 - correlation**2) * lfilter([1.0], [1.0, -correlation], rng.standard_normal((ROWS, 1)), 0)
        change = np.sin(np.arange(ROWS) / 300.0)[:, np.newaxis]
        shown = noise + effect * change
        size = float(np.sum(change * shown) / np.sum(change**2))
        parts.append(scatter(size * change, shown - size * change, BLOCK_ROWS))
    return total_scatter(parts)


def test_white_residuals_scatter_as_their_information_says() -> None:
    assert scattered(0.0).score / scattered(0.0).information == pytest.approx(1.0, abs=0.25)


def test_residuals_that_hang_together_scatter_more() -> None:
    # Of slow changes first-order noise has the variance (1 + ρ)/(1 − ρ); some of it lies beyond the blocks' ends.
    assert scattered(0.9).dispersion == pytest.approx(19.0, rel=0.25)


def test_a_real_effect_does_not_scatter_itself() -> None:
    assert scattered(0.0, effect=1.0).dispersion == pytest.approx(scattered(0.0).dispersion, abs=0.25)


def test_a_change_in_every_block_counts_every_block() -> None:
    everywhere, residual = np.ones((ROWS, 1)), np.zeros((ROWS, 1))
    runs = total_scatter([scatter(everywhere, residual, BLOCK_ROWS)] * RUNS)
    assert runs.blocks == pytest.approx(RUNS * ROWS / BLOCK_ROWS)
    one_block = np.zeros((ROWS, 1))
    one_block[:BLOCK_ROWS] = 1.0
    assert scatter(one_block, residual, BLOCK_ROWS).blocks == pytest.approx(1.0)


def test_the_dispersion_lessens_a_gain_and_never_raises_it() -> None:
    assert over_dispersion(60.0, Scatter(400.0, 100.0, 100.0)) == pytest.approx(15.0)
    assert over_dispersion(60.0, Scatter(20.0, 100.0, 100.0)) == pytest.approx(60.0)


def test_what_only_variances_make_of_a_gain_is_no_evidence() -> None:
    assert over_dispersion(60.0, Scatter(10.0, 10.0, 1.0)) == pytest.approx(10.0)
    assert over_dispersion(-5.0, Scatter(10.0, 10.0, 1.0)) == 0.0


def test_few_blocks_are_worth_what_students_distribution_says() -> None:
    # t = 5 with 4 degrees of freedom is exceeded in 0.00374 of cases, as 2.675 of a normal distribution.
    four_blocks = Scatter(25.0, 25.0, 25.0**2 / 4.0)
    assert by_student_t(25.0, four_blocks) == pytest.approx(2.675**2, rel=1e-3)
    assert by_student_t(25.0, Scatter(25.0, 25.0, 1e-3)) == pytest.approx(25.0, rel=1e-2)
    assert by_student_t(0.0, four_blocks) == 0.0
    assert np.isfinite(by_student_t(1e9, Scatter(1e9, 1e9, 1e14)))
