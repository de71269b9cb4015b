"""The load cell's noise taken out of the load, its jumps and bends left in.

The measured load drives the simulation. Its noise would too: an effect that merely averages the load, or that hangs on
a direction which the noise turns, would then seem to explain something. So the load is smoothed between its jumps, by a
penalty on the third difference. Its strength is chosen instant by instant: the strongest that doesn't bend the load by
more than its noise (Lepski, Theory Probab. Appl. 35, 1990; Eilers, Anal. Chem. 75, 2003).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.ndimage import maximum_filter1d, uniform_filter1d

Vector = NDArray[np.float64]

CUTOFFS = (0.002, 0.004, 0.008, 0.016, 0.032, 0.064, 0.125, 0.25)  # of the sampling frequency
MOST_BENT = 3.5  # standard deviations of a local mean
FEWEST_ROWS = 8  # of a stretch between jumps that is smoothed at all


def smooth_load(tau_w: Vector, edge_rows: NDArray[np.intp]) -> Vector:
    """Return the load without its noise; the rows after which it jumps are kept apart."""
    pieces = np.split(tau_w, edge_rows + 1)
    noise = _noise(pieces)
    if noise <= 0.0:
        return tau_w
    return np.concatenate([_adaptive(piece, noise) if piece.size >= FEWEST_ROWS else piece for piece in pieces])


def _noise(pieces: list[Vector]) -> float:
    """Return the standard deviation of what changes from row to row without any course."""
    third = np.concatenate([np.diff(piece, n=3) for piece in pieces if piece.size >= FEWEST_ROWS] or [np.zeros(1)])
    return float(np.median(np.abs(third)) / 0.6745 / np.sqrt(20.0))


def _adaptive(values: Vector, noise: float) -> Vector:
    """Smooth as strongly as each instant allows."""
    result = values
    for cutoff in reversed(CUTOFFS):  # the weakest first; a stronger one takes over where it does no harm
        smooth = _smoothed(values, cutoff)
        width = max(3, round(0.5 / cutoff) | 1)
        bent = np.abs(uniform_filter1d(values - smooth, width)) * np.sqrt(width) / noise
        harmless = maximum_filter1d(bent, 2 * width) < MOST_BENT
        weight = uniform_filter1d(harmless.astype(np.float64), width)
        result = result + weight * (smooth - result)
    return result


def _strength(cutoff: float) -> float:
    return float((2.0 * np.sin(np.pi * cutoff)) ** -6)


def _smoothed(values: Vector, cutoff: float) -> Vector:
    """Minimise Σ (y − z)² + λ Σ (Δ³ z)²."""
    n = values.size
    strength = _strength(cutoff)
    taps = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((4, n))
    for offset in range(4):
        products = taps[offset:] * taps[: 4 - offset]
        for k, product in enumerate(products):
            # Row i of the differences touches columns i … i + 3.
            bands[3 - offset, k + offset : n - 3 + k + offset] += strength * product
    bands[3] += 1.0
    return np.asarray(solveh_banded(bands, values, check_finite=False))
