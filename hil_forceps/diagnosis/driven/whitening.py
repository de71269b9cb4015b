"""Autoregressive whitening of what a model leaves: its noise, and what the model lacks so far.

Coefficients are those of Levinson and Durbin over all runs, from pairs of rows that both count. Behind a gap a row is
predicted from as many rows as there are since: the Gaussian likelihood of each stretch, exactly.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.signal import lfilter

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Mask = NDArray[np.bool_]

ORDER = 8  # of the filter
RIDGE = 1e-4  # of the variance, white: what no row repeats


class Whitening(NamedTuple):
    """Filters that make a channel's residual white, of variance 1."""

    taps: Matrix  # (ORDER + 1)²: row m predicts from m rows, over the deviation of that

    def of(self, values: Matrix, mask: Mask) -> Matrix:
        """Return values (n × m) through the filters; `mask`: rows that count. Others are 0."""
        out: Matrix = np.asarray(lfilter(self.taps[-1], [1.0], values, axis=0))
        before = rows_before(mask)
        for order in range(ORDER):
            rows = np.flatnonzero(mask & (before == order))
            out[rows] = sum(self.taps[order, lag] * values[rows - lag] for lag in range(order + 1))
        out[~mask] = 0.0
        return out


def white(deviation: float) -> Whitening:
    """Return the filters of noise that is white already."""
    taps = np.zeros((ORDER + 1, ORDER + 1))
    taps[:, 0] = 1.0 / deviation
    return Whitening(taps)


def whitening(residuals: Sequence[Vector], masks: Sequence[Mask]) -> Whitening:
    """Return the filters for residuals of some runs; `masks`: rows that count."""
    covariance = np.zeros(ORDER + 1)
    pairs = np.zeros(ORDER + 1)
    for values, mask in zip(residuals, masks, strict=True):
        kept = np.where(mask, values, 0.0)
        for lag in range(ORDER + 1):
            covariance[lag] += float(kept[lag:] @ kept[: kept.size - lag])
            pairs[lag] += float(np.count_nonzero(mask[lag:] & mask[: mask.size - lag]))
    covariance /= np.maximum(pairs, 1.0)
    if covariance[0] <= 0.0:
        return white(1.0)
    covariance[0] *= 1.0 + RIDGE
    # Of pairs that differ from lag to lag they need not be those of any noise: then less is said of far lags.
    window = np.ones(ORDER + 1)
    while linalg.eigvalsh(linalg.toeplitz(covariance * window))[0] < 0.5 * RIDGE * covariance[0]:
        window = window * 0.98 ** np.arange(ORDER + 1)
    covariance = covariance * window
    taps = np.zeros((ORDER + 1, ORDER + 1))
    for order in range(ORDER + 1):
        weights = linalg.solve_toeplitz(covariance[:order], covariance[1 : order + 1]) if order else np.zeros(0)
        variance = max(float(covariance[0] - weights @ covariance[1 : order + 1]), 0.5 * RIDGE * float(covariance[0]))
        taps[order, : order + 1] = np.concatenate(([1.0], -weights)) / np.sqrt(variance)
    return Whitening(taps)


def rows_before(mask: Mask) -> NDArray[np.intp]:
    """Return how many rows right before each count, up to `ORDER`."""
    n = mask.size
    last_gap = np.maximum.accumulate(np.where(mask, -1, np.arange(n)))
    return np.minimum(np.arange(n) - 1 - last_gap, ORDER).clip(0)
