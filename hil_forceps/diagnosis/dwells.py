"""What the encoder's rounding leaves open where the motor dwells: when it goes on hangs on more than is known.

Where the drive holds against a load that grows slowly, its integral may grow at the same rate by the error of one
count. The motor then stays within that count, and the jaw stands off, until they part. When that is hangs on a
thousandth of the load's slope: simulations that differ by what the load's course leaves open part at instants some
tenths of a second from each other. Their mean is one wrong answer among many: it left 79 of χ² in runs without any
effect, where chance gives 16.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

WINDOW_S = 1.0  # dwells further apart have nothing to do with each other
STANDS_OUT = 5.0  # of χ²: elsewhere simulations differ by up to 4
FASTEST_HZ = 25.0  # what is faster is rounding as it happened


def dwell_errors(spread: Vector, deviations: Sequence[float], period_s: float, integral_per_s: float) -> Vector:
    """Return what simulations that count differ by where the motor dwells: errors (2, k, rows) of θ_m and θ_j [rad].

    Each is to be taken times a standard normal number of its own.

    `spread` (n, 2, rows): how far off their mean n simulations are, over the root of n − 1. `deviations`: of both
    channels' noise, infinite where one isn't measured. `integral_per_s`: of the error's integral that is added to θ_m.
    """
    seen = spread.copy()
    seen[:, 0] += integral_per_s * period_s * np.cumsum(spread[:, 0], axis=1)
    rows = spread.shape[2]
    half = max(1, round(0.5 * WINDOW_S / period_s))
    wave = np.sin(np.pi * (np.arange(2 * half) + 0.5) / (2 * half))  # squares, one every half, are 1 together
    found = []
    for first in range(-half, rows, half):
        here = slice(max(first, 0), min(first + 2 * half, rows))
        part = seen[:, :, here] * wave[here.start - first : here.stop - first]
        white = (part / np.reshape(deviations, (2, 1))).reshape(part.shape[0], -1)
        values, vectors = np.linalg.eigh(white @ white.T)
        for vector in vectors.T[values > STANDS_OUT]:
            error = np.zeros((2, rows))
            error[:, here] = np.tensordot(vector, part, 1)
            found.append(error)
    return np.stack(found, axis=1) if found else np.empty((2, 0, rows))
