"""What drives a simulation, without its noise: smoothed as far as the noise asks for, instant by instant.

Smoothing is by a penalty on the third difference. Its strength at each row is the strongest that doesn't bend the
values by more than their noise (Lepski, Theory Probab. Appl. 35, 1990; Eilers, Anal. Chem. 75, 2003).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.ndimage import maximum_filter1d, uniform_filter1d

Vector = NDArray[np.float64]

CUTOFFS = (0.25, 0.125, 0.064, 0.032, 0.016, 0.008, 0.004, 0.002)  # of the rate of rows, the weakest first
MOST_BENT = 6.0  # deviations of a local mean: what it bends is in the offset of the simulation, what it lets through
# ties sensitivities to the residual
FEWEST_ROWS = 8  # between jumps
_FREQUENCIES = (np.arange(4096) + 0.5) / 8192.0  # of the rate of rows


def white_deviation(pieces: Sequence[Vector]) -> float:
    """Return the standard deviation of what changes from row to row without any course, counting included."""
    third = np.concatenate([np.diff(piece, n=3) for piece in pieces if piece.size >= FEWEST_ROWS] or [np.zeros(1)])
    by_differences = float(np.median(np.abs(third)) / 0.6745 / np.sqrt(20.0))
    steps = np.abs(np.concatenate([np.diff(piece) for piece in pieces]))
    quantum = float(np.min(steps[steps > 0.0], initial=np.inf))
    counts = np.concatenate(pieces) / quantum if np.isfinite(quantum) else np.array([0.5])
    counted = bool(np.max(np.abs(counts - np.rint(counts))) < 0.02)
    return max(by_differences, quantum / np.sqrt(12.0)) if counted else by_differences


def smoothed_as_noise_asks(values: Vector, jumps: NDArray[np.intp], deviation: float) -> Vector:
    """Return values without their noise; the rows after which they jump are kept apart.

    `deviation`: of white noise that is as strong as theirs where it is slow.
    """
    if deviation <= 0.0:
        return values
    pieces = np.split(values, jumps + 1)
    return np.concatenate([_through(p, deviation) if p.size >= FEWEST_ROWS else p for p in pieces])


def _through(values: Vector, deviation: float) -> Vector:
    result = values
    for cutoff in CUTOFFS:  # a stronger one takes over where it does no harm
        width = max(3, round(0.5 / cutoff) | 1)  # rows of the local mean that is looked at
        cut = _strength(cutoff) * (2.0 * np.sin(np.pi * _FREQUENCIES)) ** 6
        mean = np.sin(np.pi * width * _FREQUENCIES) / (width * np.sin(np.pi * _FREQUENCIES))
        passed = mean * cut / (1.0 + cut)
        smooth = _smoothed(values, cutoff)
        bent = np.abs(uniform_filter1d(values - smooth, width)) / (deviation * float(np.sqrt(np.mean(passed**2))))
        harmless = maximum_filter1d(bent, 2 * width) < MOST_BENT
        result = result + uniform_filter1d(harmless.astype(np.float64), width) * (smooth - result)
    return result


def _strength(cutoff: float) -> float:
    return float((2.0 * np.sin(np.pi * cutoff)) ** -6)


def _smoothed(values: Vector, cutoff: float) -> Vector:
    """Minimise Σ (y − z)² + λ Σ (Δ³ z)²; `cutoff` is of the rate of rows."""
    n, strength = values.size, _strength(cutoff)
    taps = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((4, n))
    for offset in range(4):
        products = taps[offset:] * taps[: 4 - offset]
        for k, product in enumerate(products):
            # Row i of the differences touches columns i … i + 3.
            bands[3 - offset, k + offset : n - 3 + k + offset] += strength * product
    bands[3] += 1.0
    return np.asarray(solveh_banded(bands, values, check_finite=False), dtype=np.float64)
