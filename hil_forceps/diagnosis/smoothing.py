"""The load cell's noise taken out of the load, its jumps and bends left in.

The measured load drives the simulation. Its noise would too: an effect that merely averages the load, or that hangs on
a direction which the noise turns, would then seem to explain something. So the load is smoothed between its jumps, by a
penalty on the third difference. Its strength is chosen instant by instant: the strongest that doesn't bend the load by
more than its noise (Lepski, Theory Probab. Appl. 35, 1990; Eilers, Anal. Chem. 75, 2003). Corners, where a ramp begins
or ends, are found first and stay free: rounded off, they would ring less than they did, as if the wire were damped.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.ndimage import maximum_filter1d, uniform_filter1d

Vector = NDArray[np.float64]

CUTOFFS = (0.002, 0.004, 0.008, 0.016, 0.032, 0.064, 0.125, 0.25)  # of the sampling frequency
MOST_BENT = 3.5  # standard deviations of a local mean
FEWEST_ROWS = 8  # of a stretch between jumps that is smoothed at all
CORNER_REACHES = (12, 40, 120)  # rows to each side that a corner is looked for in
CORNER_DEGREE = 5  # of what is smooth within them
CORNER_IN_SD = 6.0
_GRID = (np.arange(4096) + 0.5) / 8192.0  # frequencies, of the sampling frequency


class LoadNoise(NamedTuple):
    """What is known of the load cell's noise: at each frequency the variance that white noise of that power has."""

    frequency_Hz: Vector
    power: Vector


def smooth_load(tau_w: Vector, edge_rows: NDArray[np.intp], period_s: float, noise: LoadNoise | None = None) -> Vector:
    """Return the load without its noise; the rows after which it jumps are kept apart.

    `noise`: its colour; None where that isn't known: then it is taken as white, as strong as it is from row to row.
    """
    pieces = np.split(tau_w, edge_rows + 1)
    if noise is None:
        white = white_deviation(pieces)
        noise = LoadNoise(np.array([0.0, 0.5 / period_s]), np.full(2, white**2))
    if float(noise.power.max()) <= 0.0:
        return tau_w
    power = np.interp(_GRID / period_s, noise.frequency_Hz, noise.power)
    levels = [_level(cutoff, power) for cutoff in reversed(CUTOFFS)]
    return np.concatenate([_adaptive(piece, levels) if piece.size >= FEWEST_ROWS else piece for piece in pieces])


def white_deviation(pieces: list[Vector]) -> float:
    """Return the standard deviation of what changes from row to row without any course."""
    third = np.concatenate([np.diff(piece, n=3) for piece in pieces if piece.size >= FEWEST_ROWS] or [np.zeros(1)])
    return float(np.median(np.abs(third)) / 0.6745 / np.sqrt(20.0))


class _Level(NamedTuple):
    cutoff: float
    width: int  # rows of the local mean that is looked at
    deviation: float  # of that mean by noise


def _level(cutoff: float, power: Vector) -> _Level:
    width = max(3, round(0.5 / cutoff) | 1)
    cut = _strength(cutoff) * (2.0 * np.sin(np.pi * _GRID)) ** 6
    passed = np.sin(np.pi * width * _GRID) / (width * np.sin(np.pi * _GRID)) * cut / (1.0 + cut)
    return _Level(cutoff, width, float(np.sqrt(np.mean(power * passed**2))))


def _adaptive(values: Vector, levels: list[_Level]) -> Vector:
    """Smooth as strongly as each instant allows."""
    result = values
    ramps = _ramps(values.size, corners(values))
    for cutoff, width, deviation in levels:  # the weakest first; a stronger one takes over where it does no harm
        smooth = smoothed(values, cutoff, ramps)
        bent = np.abs(uniform_filter1d(values - smooth, width)) / deviation
        harmless = maximum_filter1d(bent, 2 * width) < MOST_BENT
        weight = uniform_filter1d(harmless.astype(np.float64), width)
        result = result + weight * (smooth - result)
    return result


def _strength(cutoff: float) -> float:
    return float((2.0 * np.sin(np.pi * cutoff)) ** -6)


def corners(values: Vector) -> NDArray[np.intp]:
    """Return the rows of a stretch (n) at which its slope changes at once, each one standing far above the noise."""
    taken = np.zeros(values.size, dtype=np.bool_)
    found: list[int] = []
    for reach in CORNER_REACHES:
        if values.size < 4 * reach:
            break
        bend = np.abs(np.convolve(values, _corner_kernel(reach)[::-1], mode="valid"))
        usual = float(np.median(bend)) / 0.6745
        tops = np.flatnonzero((bend >= maximum_filter1d(bend, 2 * reach + 1)) & (bend > CORNER_IN_SD * usual))
        fresh = [int(row) + reach for row in tops if not taken[row + reach]]
        found += fresh
        for row in fresh:
            taken[max(0, row - 2 * reach) : row + 2 * reach + 1] = True
    return np.array(sorted(found), dtype=np.intp)


def _corner_kernel(reach: int) -> Vector:
    """Return the weights that measure a corner in the middle of 2 reach + 1 rows, blind for anything smooth."""
    x = np.arange(-reach, reach + 1) / reach
    corner = np.maximum(x, 0.0)
    smooth = np.polynomial.chebyshev.chebvander(x, CORNER_DEGREE)
    left = corner - smooth @ np.linalg.lstsq(smooth, corner, rcond=None)[0]
    return np.asarray(left / np.linalg.norm(left))


def _ramps(n: int, at: NDArray[np.intp]) -> Vector:
    """Return ramps (n, 2 m) that begin at each corner and at the row behind it: corners lie between the rows."""
    rows = np.arange(n)[:, None]
    begins = np.concatenate((at, at + 1))[None, :]
    return np.asarray(np.maximum(rows - begins, 0.0) / n)


def smoothed(values: Vector, cutoff: float, ramps: Vector | None = None) -> Vector:
    """Minimise Σ (y − z)² + λ Σ (Δ³ (z − ramps a))² over z and a; `ramps` (rows, any number): none when not given."""
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
    both = values[:, None] if ramps is None else np.column_stack((values, ramps))
    rough = both - np.asarray(solveh_banded(bands, both, check_finite=False))  # what smoothing takes away
    if ramps is None or ramps.size == 0:
        return values - rough[:, 0]
    heights = np.linalg.lstsq(ramps.T @ rough[:, 1:], ramps.T @ rough[:, 0], rcond=1e-10)[0]
    return np.asarray(values - rough[:, 0] + rough[:, 1:] @ heights)
