"""Residuals in the frequency domain, where noise of any colour is whitened by a division (Whittle's likelihood).

A channel of a run becomes the real and imaginary parts of its discrete Fourier transform, scaled so that white noise of
variance s² gives entries of variance s². All channels of all runs lie one behind the other in one flat vector.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from hil_forceps.diagnosis.low_rank import LoadErrors, LowRank, decompose, scale
from hil_forceps.diagnosis.mapper import Mapper

Vector = NDArray[np.float64]
Flat = NDArray[np.float32]
Matrix = NDArray[np.float32]
Bands = NDArray[np.intp]

BANDS = 28
LOWEST_HZ = 0.4
LEAST_ENTRIES = 60  # of a band: fewer, and it joins its neighbour
OWN_ENTRIES = 120  # of a band in every run: from here on each run has its own, since runs differ in noise
LEAST_FREEDOM = 10.0  # entries for which what was taken to be their noise stands
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
    load: tuple[LoadErrors, ...] = ()  # of each run; empty: the load has none that are known
    dwells: tuple[Matrix, ...] = ()  # of each run: other errors in the entries of the load's, one a column


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


def transform_one(layout: Layout, run: int, outputs: Mapping[str, Vector]) -> Flat:
    """Return the flat vector of one run's channels, 0 in all other runs."""
    flat = np.zeros(layout.size, dtype=np.float32)
    fill_run(flat, layout, run, outputs)
    return flat


def fill_run(flat: Flat, layout: Layout, run: int, outputs: Mapping[str, Vector]) -> None:
    """Put the channels of a run into their places."""
    for part in layout.parts:
        if part.run == run:
            fill(flat, part, outputs[part.channel])


def fill(flat: Flat, part: Part, values: Vector) -> None:
    """Put a channel of a run into its place, or each row of a matrix."""
    flat[..., part.start : part.stop] = spectrum_of(part, values).astype(np.complex64).view(np.float32)


def spectrum_of(part: Part, values: NDArray[np.floating]) -> NDArray[np.complexfloating]:
    """Return the scaled spectrum of a channel of a run, or of each row of a matrix; as precise as `values` are."""
    spectrum = fft.rfft(values * part.weights.astype(values.dtype, copy=False)) * part.scale
    spectrum[..., 0] *= np.sqrt(0.5)  # real: all its variance is in one entry
    return np.asarray(spectrum)


class Noise(NamedTuple):
    """Noise of every band but what errors of the load make, where those are known.

    Else much of the jaw's is the motor's: an error of the load cell moves both alike.
    """

    power: Vector  # of each band; of theta_j_rad what is left once the motor's share is taken out
    mix: NDArray[np.complex128]  # of each band of theta_j_rad: its part that follows theta_m_rad


class Whitener(NamedTuple):
    """Makes noise white, of variance 1."""

    factor: Flat
    pairs: tuple[tuple[int, int, int], ...]  # of each run: start of theta_j_rad, its stop, start of theta_m_rad
    mix: NDArray[np.complex64]  # of each bin of the theta_j_rad parts, one behind the other
    load: tuple[LowRank, ...] = ()  # of each run
    mapper: Mapper = map

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
        return self._without_load(mixed)

    def undo(self, white: Flat) -> Flat:
        """Return the flat vector that `apply` made white."""
        entries = white.copy()
        scale(entries, self.load, [np.sqrt(1.0 + errors.power) for errors in self.load], self.mapper)
        return self._unmixed(entries)

    def sensors(self, white: Flat) -> Flat:
        """Return what most likely is not the load's errors of a whitened vector; not whitened."""
        return self._unmixed(self._without_load(white.copy()))

    def freedom(self, fitted: Matrix) -> Vector:
        """Return how much of each entry is free to show the sensors' noise; `fitted`: orthonormal, whitened."""
        left = self._without_load(fitted.copy()) if self.load else fitted
        used = np.einsum("ij,ij->i", left, left).astype(np.float64)
        for errors in self.load:
            used[errors.entries] += errors.basis**2 @ (errors.power / (1.0 + errors.power))
        return np.asarray(np.maximum(1.0 - used, 0.0))

    def _without_load(self, entries: Flat) -> Flat:
        scale(entries, self.load, [1.0 / np.sqrt(1.0 + errors.power) for errors in self.load], self.mapper)
        return entries

    def _unmixed(self, white: Flat) -> Flat:
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


def white_noise(layout: Layout, power: Vector) -> Noise:
    """Return noise of that power whose channels have nothing to do with each other."""
    return Noise(power, np.zeros(len(layout.band_channel), dtype=np.complex128))


def measure_noise(layout: Layout, whitener: Whitener, white: Flat, fitted: Matrix) -> Noise:
    """Return the noise that a whitened residual shows; `fitted`: orthonormal columns that a fit has used up.

    Where errors of the load hide what the sensors do, it stays what the whitener takes it to be.
    """
    bands = len(layout.band_channel)
    left = whitener.sensors(white).astype(np.float64)
    free = np.bincount(layout.band_of, weights=whitener.freedom(fitted), minlength=bands)
    count = np.bincount(layout.band_of, minlength=bands)
    if layout.load:
        total = np.bincount(layout.band_of, weights=left**2, minlength=bands)
        before = np.bincount(layout.band_of, weights=whitener.factor.astype(np.float64) ** -2, minlength=bands)
        power = (total + LEAST_FREEDOM * before / np.maximum(count, 1)) / (free + LEAST_FREEDOM)
        return white_noise(layout, power)
    mix = _mix(layout, left)
    for motor, jaw in pairs(layout):
        bins = left[motor.start : motor.stop].view(np.complex128)
        left[jaw.start : jaw.stop].view(np.complex128)[:] -= mix[layout.band_of[jaw.start : jaw.stop : 2]] * bins
    total = np.bincount(layout.band_of, weights=left**2, minlength=bands)
    return Noise(np.asarray(total / np.maximum(free, 0.25 * count)), mix)


def _mix(layout: Layout, left: Vector) -> NDArray[np.complex128]:
    """Return for each band how much of the motor's noise the jaw's holds."""
    bands = len(layout.band_channel)
    mix, cross = np.zeros(bands, dtype=np.complex128), np.zeros(bands, dtype=np.complex128)
    power = np.zeros(bands)
    for motor, jaw in pairs(layout):
        here = layout.band_of[jaw.start : jaw.stop : 2]
        turning = left[motor.start : motor.stop].view(np.complex128)
        product = left[jaw.start : jaw.stop].view(np.complex128) * turning.conj()
        cross += np.bincount(here, product.real, bands) + 1j * np.bincount(here, product.imag, bands)
        power += np.bincount(here, np.abs(turning) ** 2, bands)
    known = power > 0.0
    mix[known] = cross[known] / power[known]
    return mix


def whitening(layout: Layout, noise: Noise, mapper: Mapper = map) -> Whitener:
    """Return what makes this noise white, and the load's errors beside it."""
    both = pairs(layout) if noise.mix.any() else []
    mixes = [noise.mix[layout.band_of[jaw.start : jaw.stop : 2]] for _, jaw in both]
    mix = np.concatenate(mixes) if mixes else np.empty(0)
    factor = np.asarray((1.0 / np.sqrt(noise.power))[layout.band_of], dtype=np.float32)
    load = tuple(decompose(_together(layout.load, layout.dwells), factor, mapper))
    places = tuple((jaw.start, jaw.stop, motor.start) for motor, jaw in both)
    return Whitener(factor, places, mix.astype(np.complex64), load, mapper)


def _together(load: Sequence[LoadErrors], dwells: Sequence[Matrix]) -> Sequence[LoadErrors]:
    """Return errors of the load with those of dwells."""
    if not any(columns.shape[1] for columns in dwells):
        return load
    pairs = zip(load, dwells, strict=True)
    return [LoadErrors(e.entries, np.concatenate((e.columns, columns), axis=1)) for e, columns in pairs]


def power_of_load(layout: Layout) -> Vector:
    """Return the mean power that errors of the load have in each band."""
    bands = len(layout.band_channel)
    total = np.zeros(bands)
    for errors in layout.load:
        rows = np.einsum("ij,ij->i", errors.columns, errors.columns, dtype=np.float64)
        total += np.bincount(layout.band_of[errors.entries], rows, bands)
    return np.asarray(total / np.maximum(np.bincount(layout.band_of, minlength=bands), 1))
