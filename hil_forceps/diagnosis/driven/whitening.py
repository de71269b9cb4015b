"""Autoregressive whitening of what a model leaves: its noise, and what the model lacks so far.

Coefficients are those of Yule and Walker over all runs, from pairs of rows that both count.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.signal import lfilter

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]

ORDER = 8  # of the filter
RIDGE = 1e-4  # of the variance, white: what no row repeats


class Whitening(NamedTuple):
    """A filter that makes a channel's residual white, of variance 1."""

    taps: Vector  # ORDER + 1, over the deviation behind the filter

    def of(self, values: Vector) -> Vector:
        """Return values (n, or n × m) through the filter."""
        return np.asarray(lfilter(self.taps, [1.0], values, axis=0))


def whitening(residuals: Sequence[Vector], masks: Sequence[Mask]) -> Whitening:
    """Return the filter for residuals of some runs; `masks`: rows that count."""
    covariance = np.zeros(ORDER + 1)
    pairs = np.zeros(ORDER + 1)
    for values, mask in zip(residuals, masks, strict=True):
        kept = np.where(mask, values, 0.0)
        for lag in range(ORDER + 1):
            covariance[lag] += float(kept[lag:] @ kept[: kept.size - lag])
            pairs[lag] += float(np.count_nonzero(mask[lag:] & mask[: mask.size - lag]))
    covariance /= np.maximum(pairs, 1.0)
    if covariance[0] <= 0.0:
        return Whitening(np.concatenate(([1.0], np.zeros(ORDER))))
    covariance[0] *= 1.0 + RIDGE
    # Of pairs that differ from lag to lag they need not be those of any noise: then less is said of far lags.
    window = np.ones(ORDER + 1)
    while linalg.eigvalsh(linalg.toeplitz(covariance * window))[0] < RIDGE * covariance[0]:
        window = window * 0.98 ** np.arange(ORDER + 1)
    covariance = covariance * window
    taps = linalg.solve_toeplitz(covariance[:-1], covariance[1:])
    variance = max(float(covariance[0] - taps @ covariance[1:]), RIDGE * float(covariance[0]))
    return Whitening(np.concatenate(([1.0], -taps)) / np.sqrt(variance))


def behind_rows_that_count(mask: Mask) -> Mask:
    """Return which rows the filter makes of rows that count alone."""
    found = mask.copy()
    for lag in range(1, ORDER + 1):
        found[lag:] &= mask[:-lag]
        found[:lag] = False
    return found
