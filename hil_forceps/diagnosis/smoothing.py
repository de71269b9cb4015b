"""The load cell's noise taken out of the load, its jumps and bends left in.

The measured load drives the simulation. Its noise would too: an effect that merely averages the load, or that hangs on
a direction which the noise turns, would then seem to explain something. So the load is smoothed between its jumps, by a
penalty on the third difference. Its strength is chosen instant by instant: the strongest that doesn't bend the load by
more than its noise (Lepski, Theory Probab. Appl. 35, 1990; Eilers, Anal. Chem. 75, 2003).

Fast changes are let through only where they stand far above the noise. A corner that is rounded off makes the simulated
wire ring less than the real one; that is noise to all entries. A corner put some milliseconds beside its place makes it
ring out of step, and whatever stops the ringing then explains something: a damped wire, where there is none.

Where the noise has a colour, the load is filtered first so that its noise is white, smoothed, and filtered back: slow
noise would else hide bends whose fast part stands far above the noise at its frequency.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg, sparse
from scipy.linalg import solve_toeplitz, solveh_banded
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import lfilter, lfiltic

Vector = NDArray[np.float64]

CUTOFFS = (0.002, 0.004, 0.008, 0.016, 0.032, 0.064, 0.125, 0.25)  # of the sampling frequency
USUAL_CUTOFF = 0.004  # where smoothing usually ends
MOST_BENT = 3.0  # standard deviations of a local mean
ORDER = 8  # of the filter that makes noise white
FEWEST_ROWS = 8  # of a stretch between jumps that is smoothed at all
FAST = 0.03  # cutoffs from here on let through what makes the wire ring
MOST_BENT_FAST = 10.0
_GRID = (np.arange(4096) + 0.5) / 8192.0  # frequencies, of the sampling frequency


class LoadNoise(NamedTuple):
    """What is known of the load cell's noise: at each frequency the variance that white noise of that power has."""

    frequency_Hz: Vector
    power: Vector


def smooth_load(
    tau_w: Vector,
    edge_rows: NDArray[np.intp],
    period_s: float,
    noise: LoadNoise | None = None,
    most_bent: float = MOST_BENT,
) -> Vector:
    """Return the load without its noise; the rows after which it jumps are kept apart.

    `noise`: its colour; None where that isn't known: then it is taken as white, as strong as it is from row to row.
    `most_bent`: how far smoothing may bend the load, in standard deviations of a local mean.
    """
    pieces = np.split(tau_w, edge_rows + 1)
    if noise is None:
        noise = LoadNoise(np.array([0.0, 0.5 / period_s]), np.full(2, white_deviation(pieces) ** 2))
    if float(noise.power.max()) <= 0.0:
        return tau_w
    white = noise_filter(noise, period_s)
    return np.concatenate(
        [_through(piece, white, most_bent) if piece.size >= FEWEST_ROWS else piece for piece in pieces]
    )


def drawn_noise(rng: np.random.Generator, rows: int, period_s: float, noise: LoadNoise) -> Vector:
    """Return a draw of a load cell's noise."""
    colour = np.sqrt(np.interp(fft.rfftfreq(rows, period_s), noise.frequency_Hz, noise.power))
    return np.asarray(fft.irfft(fft.rfft(rng.standard_normal(rows)) * colour, rows))


def slow_noise(rng: np.random.Generator, rows: int, noise: LoadNoise) -> Vector:
    """Return a draw of as much of a load cell's noise as smoothing leaves."""
    return smoothed(float(np.sqrt(noise.power[0])) * rng.standard_normal(rows), USUAL_CUTOFF)


class NoiseFilter(NamedTuple):
    """What makes a load cell's noise white: a filter, the deviation behind it, and the noise's covariance over lags."""

    taps: Vector
    deviation_N_m: float
    covariance: Vector


def noise_filter(noise: LoadNoise, period_s: float) -> NoiseFilter:
    """Return the filter that makes this noise white."""
    power = np.interp(_GRID / period_s, noise.frequency_Hz, noise.power)
    turns = 2.0 * np.pi * np.outer(np.arange(ORDER + 1), _GRID)
    covariance = np.cos(turns) @ power / power.size
    covariance[0] *= 1.0 + 1e-9
    taps = solve_toeplitz(covariance[:-1], covariance[1:])
    deviation = float(np.sqrt(max(covariance[0] - taps @ covariance[1:], 0.0)))
    return NoiseFilter(np.concatenate(([1.0], -taps)), deviation, covariance)


def whitening_matrix(white: NoiseFilter, rows: int) -> sparse.csr_matrix:
    """Return the matrix that makes the noise of so many rows white, of variance 1; exact from the first row on."""
    first = min(ORDER, rows)
    taps = white.taps[: first + (rows > ORDER)] / white.deviation_N_m
    lags = range(taps.size)
    whole = sparse.diags_array([np.full(rows - lag, taps[lag]) for lag in lags], offsets=[-lag for lag in lags])
    start = linalg.cholesky(linalg.toeplitz(white.covariance[:first]), lower=True)
    head = sparse.csr_matrix(linalg.solve_triangular(start, np.eye(first), lower=True))
    top = sparse.hstack((head, sparse.csr_matrix((first, rows - first))))
    return sparse.csr_matrix(sparse.vstack((top, whole.tocsr()[first:])))


def local_cutoff(piece: Vector, white: NoiseFilter) -> Vector:
    """Return the cutoff of the smoothing that each row of a load allows, of the sampling frequency.

    Fast ones as readily as slow ones: for a course whose error is told.
    """
    logarithm = np.full(piece.size, np.log(2.0 * CUTOFFS[-1]))
    for cutoff, _, weight in _levels_of(whitened(piece, white), white, MOST_BENT, MOST_BENT):
        logarithm += weight * (np.log(cutoff) - logarithm)
    return np.asarray(np.exp(logarithm))


def whitened(piece: Vector, white: NoiseFilter) -> Vector:
    """Return a piece whose noise is white; before it, its start went on for ever."""
    one = np.ones(1)
    before = lfiltic(white.taps, one, np.empty(0), np.full(ORDER, piece[0]))
    return np.asarray(lfilter(white.taps, one, piece, zi=before)[0])


def _through(values: Vector, white: NoiseFilter, most_bent: float) -> Vector:
    """Filter a piece, smooth it, filter it back."""
    one = np.ones(1)
    first = result = whitened(values, white)
    for _, smooth, weight in _levels_of(first, white, most_bent, MOST_BENT_FAST):
        result = result + weight * (smooth - result)
    back, _ = lfilter(one, white.taps, result, zi=lfiltic(one, white.taps, np.full(ORDER, values[0])))
    return np.asarray(back, dtype=np.float64)


def white_deviation(pieces: list[Vector]) -> float:
    """Return the standard deviation of what changes from row to row without any course."""
    third = np.concatenate([np.diff(piece, n=3) for piece in pieces if piece.size >= FEWEST_ROWS] or [np.zeros(1)])
    return float(np.median(np.abs(third)) / 0.6745 / np.sqrt(20.0))


def _levels_of(
    values: Vector, white: NoiseFilter, most_bent: float, most_bent_fast: float
) -> Iterator[tuple[float, Vector, Vector]]:
    """Return each cutoff, what it smooths white noise's bearer to, and where it does no harm (1) or does (0).

    The weakest first: a stronger one takes over where it does no harm.
    """
    for cutoff in reversed(CUTOFFS):
        width = max(3, round(0.5 / cutoff) | 1)  # rows of the local mean that is looked at
        cut = _strength(cutoff) * (2.0 * np.sin(np.pi * _GRID)) ** 6
        passed = np.sin(np.pi * width * _GRID) / (width * np.sin(np.pi * _GRID)) * cut / (1.0 + cut)
        deviation = white.deviation_N_m * float(np.sqrt(np.mean(passed**2)))
        smooth = smoothed(values, cutoff)
        bent = np.abs(uniform_filter1d(values - smooth, width)) / deviation
        harmless = maximum_filter1d(bent, 2 * width) < (most_bent if cutoff < FAST else most_bent_fast)
        yield cutoff, smooth, uniform_filter1d(harmless.astype(np.float64), width)


def _strength(cutoff: float) -> float:
    return float((2.0 * np.sin(np.pi * cutoff)) ** -6)


def smoothed(values: Vector, cutoff: float) -> Vector:
    """Minimise Σ (y − z)² + λ Σ (Δ³ z)²; `cutoff` is of the sampling frequency."""
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
    return np.asarray(solveh_banded(bands, values, check_finite=False), dtype=np.float64)
