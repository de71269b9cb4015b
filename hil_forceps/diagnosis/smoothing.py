"""The load cell's noise taken out of the load, its jumps left in.

The measured load drives the simulation. Its noise would too: an effect that merely averages the load, or that hangs on
a direction which the noise turns, would then seem to explain something. So the load is smoothed between its jumps, by a
penalty on the third difference whose strength generalised cross-validation chooses (Craven, Wahba, Numer. Math. 31,
1979; Eilers, Anal. Chem. 75, 2003).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

Vector = NDArray[np.float64]

CUTOFFS = (0.002, 0.004, 0.008, 0.016, 0.032, 0.064, 0.125, 0.25)  # of the sampling frequency
FEWEST_ROWS = 8  # of a stretch between jumps that is smoothed at all


def smooth_load(tau_w: Vector, edge_rows: NDArray[np.intp]) -> Vector:
    """Return the load without its noise; the rows after which it jumps are kept apart."""
    pieces = np.split(tau_w, edge_rows + 1)
    cutoff = _best_cutoff([piece for piece in pieces if piece.size >= FEWEST_ROWS])
    if cutoff is None:
        return tau_w
    return np.concatenate([_smoothed(piece, cutoff) if piece.size >= FEWEST_ROWS else piece for piece in pieces])


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


def _best_cutoff(pieces: list[Vector]) -> float | None:
    """Return the cutoff of least generalised cross-validation error; None when the load is constant or has no noise."""
    if not pieces or all(float(np.ptp(piece)) == 0.0 for piece in pieces):
        return None
    count = sum(piece.size for piece in pieces)
    best, least = None, np.inf
    for cutoff in CUTOFFS:
        strength = _strength(cutoff)
        squares = sum(float(np.sum((piece - _smoothed(piece, cutoff)) ** 2)) for piece in pieces)
        freedom = sum(
            float(np.sum(1.0 / (1.0 + strength * (2.0 * np.sin(0.5 * np.pi * np.arange(p.size) / p.size)) ** 6)))
            for p in pieces
        )
        error = squares / max(count - freedom, 1.0) ** 2
        if error < least:
            best, least = cutoff, error
    return best
