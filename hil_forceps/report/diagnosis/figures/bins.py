"""Residuals reduced for drawing: binned means with intervals, density, spectra."""

from typing import NamedTuple

import numpy as np

from hil_forceps.report.traces import Array

MAX_ROWS = 200_000  # of all runs together, for scatter and bins; more look the same
MAX_SPECTRUM_ROWS = 1 << 20
BINS = 24
MIN_VISITS = 3  # fewer do not determine the variance of a bin's mean
MIN_SPECTRUM_ROWS = 64


class Binned(NamedTuple):
    """Mean of a residual over a variable, arrays [bins]; NaN where a bin has no rows, or too few visits for limits."""

    centre: Array
    mean: Array
    low: Array  # 95 % interval of the mean
    high: Array


def edges_of(variable: Array, *, bins: int = BINS) -> Array | None:
    """Return edges of equal bins over the middle 99 % of the finite values; None when they don't vary."""
    finite = variable[np.isfinite(variable)]
    if finite.size < bins:
        return None
    low, high = np.quantile(finite, [0.005, 0.995])
    if not high - low > 1e-9 * max(abs(low), abs(high)):
        return None
    return np.linspace(low, high, bins + 1)


def binned(variable: Array, values: Array, edges: Array) -> Binned:
    """Average `values` in the bins of `variable`, rows in the order of time.

    Neighbouring rows of a residual are correlated, so that the interval counts visits: each pass of the variable
    through a bin is one observation, weighted by its rows.
    """
    bins = len(edges) - 1
    place = np.searchsorted(edges, variable, side="right") - 1
    place = np.where((place >= 0) & (place < bins) & np.isfinite(values) & np.isfinite(variable), place, bins)
    visit = np.concatenate([[0], np.cumsum(place[1:] != place[:-1])]) if place.size else place
    inside = place < bins
    rows_in_visit = np.bincount(visit[inside], minlength=1).astype(np.float64)
    sum_of_visit = np.bincount(visit[inside], weights=values[inside], minlength=1)
    bin_of_visit = np.full(len(rows_in_visit), bins)
    bin_of_visit[visit[inside]] = place[inside]
    rows = np.bincount(bin_of_visit, weights=rows_in_visit, minlength=bins + 1)[:bins]
    total = np.bincount(bin_of_visit, weights=sum_of_visit, minlength=bins + 1)[:bins]
    visits = np.bincount(bin_of_visit[rows_in_visit > 0], minlength=bins + 1)[:bins].astype(np.float64)
    mean = np.divide(total, rows, out=np.full(bins, np.nan), where=rows > 0)
    deviation = sum_of_visit - rows_in_visit * np.append(mean, np.nan)[bin_of_visit]
    spread = np.bincount(bin_of_visit, weights=np.nan_to_num(deviation) ** 2, minlength=bins + 1)[:bins]
    enough = visits >= MIN_VISITS
    error = np.full(bins, np.nan)
    error[enough] = np.sqrt(spread[enough] * visits[enough] / (visits[enough] - 1)) / rows[enough]
    return Binned((edges[1:] + edges[:-1]) / 2, mean, mean - 1.96 * error, mean + 1.96 * error)


def spectrum(time_s: Array, values: Array) -> tuple[Array, Array] | None:
    """Return frequencies (Hz) and amplitude density (unit/√Hz) by Welch's method; None for too short a run.

    Hann windows that overlap by half, means removed; the stamps are taken as equally spaced. One-sided, so that white
    noise of standard deviation s stands at s √(2 T).
    """
    values = values[:MAX_SPECTRUM_ROWS]
    values = np.where(np.isfinite(values), values, 0.0)
    length = min(1 << int(np.log2(max(len(values) // 4, 1))), 4096)
    if length < MIN_SPECTRUM_ROWS:
        return None
    interval_s = float(np.median(np.diff(time_s[:MAX_SPECTRUM_ROWS])))
    window = np.hanning(length)
    starts = range(0, len(values) - length + 1, length // 2)
    segments = np.stack([values[start : start + length] for start in starts])
    segments = (segments - segments.mean(axis=1, keepdims=True)) * window
    power = (np.abs(np.fft.rfft(segments, axis=1)) ** 2).mean(axis=0) * 2 * interval_s / np.dot(window, window)
    frequency = np.fft.rfftfreq(length, interval_s)
    return np.asarray(frequency[2:], dtype=np.float64), np.sqrt(
        power[2:]
    )  # the first two are affected by the removed mean


def smoothed(frequency: Array, density: Array, bins: int = 150) -> tuple[Array, Array]:
    """Average power in bins of equal ratio, which reduces the density of lines on a logarithmic axis."""
    edges = np.geomspace(frequency[0], frequency[-1] * (1 + 1e-9), bins + 1)
    place = np.searchsorted(edges, frequency, side="right") - 1
    rows = np.bincount(place, minlength=bins)
    full = rows > 0
    power = np.bincount(place, weights=density**2, minlength=bins)[full] / rows[full]
    return np.bincount(place, weights=frequency, minlength=bins)[full] / rows[full], np.sqrt(power)


def strided(rows: int, most: int) -> slice:
    """Return a stride that keeps about `most` rows."""
    return slice(None, None, max(-(-rows // most), 1))
