"""Residuals in the frequency domain, where noise of any colour is whitened by a division (Whittle's likelihood).

A channel of a run becomes the real and imaginary parts of its discrete Fourier transform, scaled so that white noise of
variance s² gives entries of variance s². All channels of all runs lie one behind the other in one flat vector.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Vector = NDArray[np.float64]
Flat = NDArray[np.float32]
Bands = NDArray[np.intp]

BANDS = 28
LOWEST_HZ = 0.4
LEAST_ENTRIES = 60  # of a band: fewer, and it joins its neighbour
OWN_ENTRIES = 120  # of a band in every run: from here on each run has its own, since runs differ in noise
TAPER_S, MOST_TAPER = 0.3, 0.1  # at each end of a run; no more than this share of it


class Part(NamedTuple):
    """Where a channel of a run lies in the flat vector."""

    run: int
    channel: str
    rows: int
    start: int
    stop: int
    weights: Vector
    scale: float


class Layout(NamedTuple):
    """The flat vector: its parts, and for each entry the noise band it belongs to."""

    parts: tuple[Part, ...]
    size: int
    band_of: Bands
    band_channel: tuple[str, ...]  # channel of each band
    band_Hz: Vector  # middle of each band
    shape: Flat | None = None  # of the noise's power within each band, entry by entry, of mean 1; None: flat
    follows: NDArray[np.complex64] | None = None  # jaw's noise over the motor's, bin by bin of `pairs`; None: 1


def make_layout(
    channels: Sequence[Sequence[str]],
    weights: Sequence[Vector],
    period_s: Sequence[float],
) -> Layout:
    """Lay out the channels of each run; narrow bands of like frequency of a channel are shared among the runs."""
    parts: list[Part] = []
    frequencies = []
    start = 0
    for run, (names, weight) in enumerate(zip(channels, weights, strict=True)):
        rows = weight.size
        bins = rows // 2 + 1
        window = tapered(weight, period_s[run])
        scale = float(np.sqrt(2.0 / max(np.sum(window**2), 1.0)))
        for name in names:
            parts.append(Part(run, name, rows, start, start + 2 * bins, window, scale))
            frequencies.append(np.repeat(np.arange(bins) / (rows * period_s[run]), 2))
            start += 2 * bins
    band_of = np.zeros(start, dtype=np.intp)
    labels: list[str] = []
    middles: list[float] = []
    for name in dict.fromkeys(part.channel for part in parts):
        here = [(part, f) for part, f in zip(parts, frequencies, strict=True) if part.channel == name]
        edges = _edges(np.concatenate([f for _, f in here]))
        middle = np.sqrt(np.maximum(edges[:-1], 0.1) * edges[1:])
        places = [np.searchsorted(edges[1:-1], f, side="right") for _, f in here]
        counts = np.min([np.bincount(place, minlength=middle.size) for place in places], axis=0)
        own = counts >= OWN_ENTRIES if len(here) > 1 else np.zeros(middle.size, dtype=np.bool_)
        for number, ((part, _), place) in enumerate(zip(here, places, strict=True)):
            # Shared bands first, then those of each run.
            rank = np.where(own, np.count_nonzero(~own) + number * np.count_nonzero(own), 0)
            rank += np.where(own, np.cumsum(own), np.cumsum(~own)) - 1
            band_of[part.start : part.stop] = len(labels) + rank[place]
        middles += [*middle[~own], *np.tile(middle[own], len(here))]
        labels += [name] * (len(middles) - len(labels))
    return Layout(tuple(parts), start, band_of, tuple(labels), np.array(middles))


def tapered(weights: Vector, period_s: float) -> Vector:
    """Return weights that rise and fall smoothly at the ends of a run.

    A Fourier transform closes the run to a ring: slow noise would make a step there, whose high frequencies are alike
    in the noise and in every sensitivity and pass for many agreeing measurements where the noise is low.
    """
    counted = np.flatnonzero(weights > 0.0)
    if counted.size == 0:
        return weights
    rows = np.arange(weights.size)
    width = min(TAPER_S / period_s, MOST_TAPER * (counted[-1] - counted[0] + 1))
    inside = np.minimum(rows - counted[0] + 1, counted[-1] - rows + 1) / max(width, 1.0)
    return np.asarray(weights * np.sin(0.5 * np.pi * np.clip(inside, 0.0, 1.0)) ** 2)


def _edges(frequencies: Vector) -> Vector:
    top = float(frequencies.max())
    wanted = np.concatenate(([0.0], np.geomspace(min(LOWEST_HZ, top / 2.0), top * (1.0 + 1e-9), BANDS)))
    sorted_f = np.sort(frequencies)
    edges = [0.0]
    for edge in wanted[1:]:
        inside = np.searchsorted(sorted_f, edge) - np.searchsorted(sorted_f, edges[-1])
        if inside >= LEAST_ENTRIES:
            edges.append(float(edge))
    edges[-1] = max(edges[-1], top * (1.0 + 1e-9)) if len(edges) > 1 else top * (1.0 + 1e-9)
    return np.array(edges if len(edges) > 1 else [0.0, top * (1.0 + 1e-9)])


def transform(layout: Layout, outputs: Sequence[Mapping[str, Vector]]) -> Flat:
    """Return the flat vector of one array per channel and run."""
    flat = np.empty(layout.size, dtype=np.float32)
    for part in layout.parts:
        fill(flat, part, outputs[part.run][part.channel])
    return flat


def fill(flat: Flat, part: Part, values: Vector) -> None:
    """Put a channel of a run into its place."""
    spectrum = fft.rfft(values * part.weights) * part.scale
    spectrum[0] *= np.sqrt(0.5)  # real: all its variance is in one entry
    flat[part.start : part.stop] = spectrum.astype(np.complex64).view(np.float32)


class Noise(NamedTuple):
    """Noise of every band, and how much of the jaw's is the motor's: an error of the load cell moves both alike."""

    power: Vector  # of each band; of theta_j_rad what is left once the motor's share is taken out
    mix: NDArray[np.complex128]  # of each band of theta_j_rad: its part that follows theta_m_rad, over `Layout.follows`


class Whitener(NamedTuple):
    """Makes noise white, of variance 1."""

    factor: Flat
    pairs: tuple[tuple[int, int, int], ...]  # of each run: start of theta_j_rad, its stop, start of theta_m_rad
    mix: NDArray[np.complex64]  # of each bin of the theta_j_rad parts, one behind the other

    def apply(self, entries: Flat) -> Flat:
        """Whiten a flat vector, or a matrix of them in columns."""
        mixed = entries.copy()
        at = 0
        for start, stop, source in self.pairs:
            bins = (stop - start) // 2
            h = self.mix[at : at + bins]
            if entries.ndim > 1:
                h = h[:, None]
            real, imag = entries[source : source + 2 * bins : 2], entries[source + 1 : source + 2 * bins : 2]
            mixed[start:stop:2] -= h.real * real - h.imag * imag
            mixed[start + 1 : stop : 2] -= h.real * imag + h.imag * real
            at += bins
        mixed *= self.factor if entries.ndim == 1 else self.factor[:, None]
        return mixed

    def undo(self, white: Flat) -> Flat:
        """Return the flat vector that `apply` made white."""
        entries = white / self.factor
        at = 0
        for start, stop, source in self.pairs:
            bins = (stop - start) // 2
            motor = entries[source : source + 2 * bins].view(np.complex64)
            entries[start:stop].view(np.complex64)[:] += self.mix[at : at + bins] * motor
            at += bins
        return entries


MOTOR, JAW = "theta_m_rad", "theta_j_rad"


def pairs(layout: Layout) -> list[tuple[Part, Part]]:
    """Return θ_m and θ_j of each run that has both."""
    motor = {part.run: part for part in layout.parts if part.channel == MOTOR}
    return [(motor[part.run], part) for part in layout.parts if part.channel == JAW and part.run in motor]


def _pairs(layout: Layout) -> tuple[tuple[int, int, int], ...]:
    return tuple((jaw.start, jaw.stop, motor.start) for motor, jaw in pairs(layout))


def white_noise(layout: Layout, power: Vector) -> Noise:
    """Return noise of that power whose channels have nothing to do with each other."""
    return Noise(power, np.zeros(len(layout.band_channel), dtype=np.complex128))


def measure_noise(layout: Layout, flat: Flat, leverage: Flat | None = None) -> Noise:
    """Return the noise that a residual shows; `leverage`: share of each entry that a fit has used up."""
    bands = len(layout.band_channel)
    mix = np.zeros(bands, dtype=np.complex128)
    left = flat.astype(np.float64)
    cross = np.zeros(bands, dtype=np.complex128)
    power_of_motor = np.zeros(bands)
    follows = follows_of(layout)
    for (start, stop, source), h in zip(_pairs(layout), follows, strict=True):
        here = layout.band_of[start:stop:2]
        jaw = left[start:stop].view(np.complex128)
        turning = h * left[source : source + stop - start].view(np.complex128)
        product = jaw * turning.conj()
        cross += np.bincount(here, product.real, bands) + 1j * np.bincount(here, product.imag, bands)
        power_of_motor += np.bincount(here, np.abs(turning) ** 2, bands)
    known = power_of_motor > 0.0
    mix[known] = cross[known] / power_of_motor[known]
    for (start, stop, source), h in zip(_pairs(layout), follows, strict=True):
        here = layout.band_of[start:stop:2]
        motor = left[source : source + stop - start].view(np.complex128)
        left[start:stop].view(np.complex128)[:] -= mix[here] * h * motor
    squares = left**2 if layout.shape is None else left**2 / layout.shape
    count = np.bincount(layout.band_of, minlength=bands)
    total = np.bincount(layout.band_of, weights=squares, minlength=bands)
    used = np.bincount(layout.band_of, weights=leverage, minlength=bands) if leverage is not None else 0.0
    return Noise(np.asarray(total / np.maximum(count - used, 0.25 * count)), mix)


def follows_of(layout: Layout) -> list[NDArray[np.complex64]]:
    """Return for each run with both angles how the jaw's noise follows the motor's, bin by bin."""
    bins = [(stop - start) // 2 for start, stop, _ in _pairs(layout)]
    whole = layout.follows if layout.follows is not None else np.ones(sum(bins), dtype=np.complex64)
    return np.split(whole, np.cumsum(bins)[:-1]) if bins else []


def followed(layout: Layout, noise: Noise) -> NDArray[np.complex128]:
    """Return for each band how much of the motor's noise the jaw's holds, on the mean over its bins."""
    bands = len(layout.band_channel)
    total, count = np.zeros(bands, dtype=np.complex128), np.zeros(bands)
    for (start, stop, _), h in zip(_pairs(layout), follows_of(layout), strict=True):
        here = layout.band_of[start:stop:2]
        total += np.bincount(here, h.real, bands) + 1j * np.bincount(here, h.imag, bands)
        count += np.bincount(here, minlength=bands)
    return np.asarray(noise.mix * total / np.maximum(count, 1.0))


def whitening(layout: Layout, noise: Noise) -> Whitener:
    """Return what makes this noise white."""
    pairs = _pairs(layout)
    mixes = [
        noise.mix[layout.band_of[start:stop:2]] * h
        for (start, stop, _), h in zip(pairs, follows_of(layout), strict=True)
    ]
    mix = np.concatenate(mixes) if mixes else np.empty(0)
    factor = np.asarray((1.0 / np.sqrt(noise.power))[layout.band_of], dtype=np.float32)
    if layout.shape is not None:
        factor /= np.sqrt(layout.shape)
    return Whitener(factor, pairs, mix.astype(np.complex64))
