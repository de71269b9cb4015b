"""Innovations of counts are white: of a filter that knows all but what the counts leave open, on simulated tracks."""

import math
from collections.abc import Callable
from typing import cast

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.interval import interval_likelihood, share_kept

Vector = NDArray[np.float64]

ROWS, SETTLING_ROWS, SEEDS, LAGS = 24_000, 500, 6, (1, 2, 3, 5, 10)
EDGE = 0.03  # of a count: how sharp it is


def _track(counts_per_row: float, wander: float, whole: bool, changes: Vector, scores: Vector, told: Vector) -> float:
    """Fill in scores and information of a position's counts; its speed wanders. Return the filter's mean deviation."""
    at, speed = 0.0, counts_per_row
    x, v, pxx, pxv, pvv, total = 0.0, counts_per_row, 1.0, 0.0, (30.0 * wander) ** 2, 0.0
    for row in range(scores.size):
        change = wander * changes[row]
        at, speed = at + speed + 0.5 * change, speed + change
        x += v
        pxx, pxv = pxx + 2.0 * pxv + pvv + 0.25 * wander**2, pxv + pvv + 0.5 * wander**2
        pvv += wander**2
        deviation = math.sqrt(pxx + EDGE**2)
        low = math.floor(at)
        _, score, information = interval_likelihood(low, low + 1.0, x, deviation)
        scores[row], told[row] = score, information
        total += math.sqrt(pxx)
        taken = information if whole else share_kept(1.0 / deviation) * information
        x, v = x + pxx * score, v + pxv * score
        pxx, pxv, pvv = pxx - pxx * pxx * taken, pxv - pxx * pxv * taken, pvv - pxv * pxv * taken
    return total / scores.size


_compiled = cast("Callable[..., float]", numba.njit(_track))


def correlation(counts_per_row: float, wander: float, *, whole: bool) -> tuple[float, float]:
    """Return χ² of the correlations of innovations with earlier ones, and the filter's mean deviation in counts."""
    scores, told, deviates = np.empty(ROWS), np.empty(ROWS), np.zeros(len(LAGS))
    for seed in range(SEEDS):
        changes = np.random.default_rng(seed).standard_normal(ROWS)
        deviation = _compiled(counts_per_row, wander, whole, changes, scores, told)
        s, i = scores[SETTLING_ROWS:], told[SETTLING_ROWS:]
        deviates += [s[lag:] @ s[:-lag] / math.sqrt(s[:-lag] ** 2 @ i[lag:]) for lag in LAGS]
    return float(np.sum((deviates / SEEDS) ** 2)), deviation


@pytest.mark.slow
@pytest.mark.parametrize("wander", [0.003, 0.01, 0.03, 0.1])
def test_a_count_takes_what_leaves_the_next_innovations_white(wander: float) -> None:
    white, whole = [], []
    for counts_per_row in (0.1, 0.33, 1.07, 3.37):
        chi2, deviation = correlation(counts_per_row, wander, whole=False)
        assert 0.05 < deviation < 0.5
        assert math.sqrt(chi2 / ROWS) < 0.025  # of all lags together; 0.006 by chance alone, of six tracks
        white.append(chi2)
        whole.append(correlation(counts_per_row, wander, whole=True)[0])
    assert sum(white) < 0.6 * sum(whole)
