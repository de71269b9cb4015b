"""The colour of the load cell's noise, from what it does in the simulation that the measured load drives.

Above some 100 Hz the load itself changes little, and its spectrum is that of its noise. Below, noise and load can't be
told apart in one channel. But noise moves the simulated motor and the simulated jaw and not the real ones, both at once
and each in a known way: the cross-spectrum of both residuals holds it, free of their sensors' own noise. It is the same
in all runs, what effects do isn't: of all runs the quieter ones count.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.linear import Response
from hil_forceps.diagnosis.smoothing import LoadNoise
from hil_forceps.diagnosis.spectrum import JAW, MOTOR, Flat, Layout, Part, pairs

Vector = NDArray[np.float64]
Complex = NDArray[np.complex128]

CLIPPED = 3.0  # medians: what stands out of a band is no noise
LOWEST_HZ, UPPER_HZ = 5.0, 15.0  # below the first, noise is taken to be as strong as between both
FEWEST_BINS = 12
ALONE_HZ = 100.0  # from here on the load's own spectrum is that of its noise
EDGE_ROWS = 4
QUIETER = 0.35  # quantile over the runs
LOUDER = 2.0  # times the power
MOST_TAKEN = 0.8  # of the noise, by a course
PASSED = 0.14  # of the rate of rows: below it the low pass of runs driven by their motion lets all through


def load_noise_driven(
    layout: Layout,
    left: Flat,
    responses: Sequence[Response],
    records: Sequence[Record],
    high: LoadNoise,
    period_s: float,
) -> LoadNoise:
    """Return the noise of the load cell where the measured motion drives: its torque and the jaw show it alike.

    `left`: residual of a simulation driven by the load as measured. `high`: the noise as changes from row to row show
    it. `period_s`: of the rows as measured; records have fewer. `high` alone where not both channels are there.
    """
    by_run = {(part.run, part.channel): part for part in layout.parts}
    both = [(part, by_run[part.run, JAW]) for part in layout.parts if part.channel != JAW and (part.run, JAW) in by_run]
    low = np.unique(layout.band_Hz[[name == JAW for name in layout.band_channel]])
    low = low[low < PASSED / max(record.period_s for record in records)]
    if not both or not low.size or any(record.tau_w_N_m is None for record in records):
        return high
    cuts = np.concatenate(([0.0], np.sqrt(low[1:] * low[:-1]), [low[-1] * 1.2]))
    # White noise has as much less variance in the rows that are kept as these are fewer.
    fewer = np.array([records[pair[0].run].period_s / period_s for pair in both])
    found = np.array([_low(pair, left, responses[pair[0].run], records, cuts) for pair in both]) * fewer[:, None]
    least = float(high.power.min())
    seen = np.isfinite(found).any(axis=0)
    if not seen.any():
        return high
    power = np.maximum(np.nanquantile(found[:, seen], QUIETER, axis=0), least)
    return LoadNoise(np.concatenate((low[seen], high.frequency_Hz[-1:])), np.concatenate((power, [least])))


def load_noise(layout: Layout, left: Flat, responses: Sequence[Response], records: Sequence[Record]) -> LoadNoise:
    """Return the noise of the load cell; `left`: residual of a simulation driven by the load as measured (`records`).

    Its colour below `ALONE_HZ` only where the jaw's angle is measured; else white, at frequencies where straight
    courses may show one.
    """
    both = pairs(layout)
    edges = np.unique(layout.band_Hz[[name == (JAW if both else MOTOR) for name in layout.band_channel]])
    low = edges[edges < ALONE_HZ]
    top = 0.5 / min(record.period_s for record in records)
    high = _high(records, np.geomspace(ALONE_HZ, top, 6))
    if not both:
        # Of 0 Hz alone a straight course leaves nothing, and noise of no power there had it follow every bend.
        return LoadNoise(np.concatenate((low, high[0])), np.full(low.size + high[0].size, float(np.median(high[1]))))
    cuts = np.concatenate(([0.0], np.sqrt(low[1:] * low[:-1]), [ALONE_HZ]))
    found = np.array([_low(pair, left, responses[pair[0].run], records, cuts) for pair in both])
    least = float(high[1].min())  # no sensor is quieter at low frequency
    seen = np.isfinite(found).any(axis=0)
    power = np.full(low.size, least)
    power[seen] = np.maximum(np.nanquantile(found[:, seen], QUIETER, axis=0), least)
    middle = (low >= LOWEST_HZ) & (low < UPPER_HZ)
    if middle.any():
        power[low < LOWEST_HZ] = np.median(power[middle])
    return LoadNoise(np.concatenate((low, high[0])), np.concatenate((power, high[1])))


def louder(noise: LoadNoise) -> LoadNoise:
    """Return the noise as loud as it may be: that of the quieter runs is too quiet below `ALONE_HZ`, by half or less.

    By noise that is too quiet no load is straight, and then nothing is left beside which to see how loud it is.
    """
    low = noise.frequency_Hz < ALONE_HZ
    return noise._replace(power=np.where(low, LOUDER * noise.power, noise.power))


def beside_straight(records: Sequence[Record], noise: LoadNoise) -> LoadNoise:
    """Return the noise that straight courses leave of the loads, at the same frequencies; `noise` where there are none.

    No effect is in it, as may be where it comes from both residuals: a cogging had made it 500 times too large.
    """
    found = np.array([_left_of(record, noise) for record in records if record.straight])
    if not found.size:
        return noise
    power, seen = noise.power.copy(), np.isfinite(found).any(axis=0)
    power[seen] = np.nanmedian(found[:, seen], axis=0)
    return noise._replace(power=power)


def _left_of(record: Record, noise: LoadNoise) -> Vector:
    """Return the power around each frequency of what a course leaves of a load; NaN where it has too few bins.

    What the course has taken of it is put back: as great a share as its error has of the noise that it was fitted with.
    All that is slow is taken together.
    """
    assert record.raw_load_N_m is not None
    assert record.tau_w_N_m is not None
    assert record.load_error is not None
    centres, rows = noise.frequency_Hz, record.time_s.size
    slow = int(np.searchsorted(centres, LOWEST_HZ))
    here = np.searchsorted(np.sqrt(centres[1:] * centres[:-1]), fft.rfftfreq(rows, record.period_s))
    last_slow = max(slow - 1, 0)
    here = np.maximum(here, last_slow)
    count = np.bincount(here, minlength=centres.size)

    def power(signals: NDArray[np.floating]) -> Vector:
        each = np.sum(np.abs(fft.rfft(signals, axis=0)) ** 2, axis=1) / rows
        found = np.asarray(np.bincount(here, each, centres.size) / np.maximum(count, 1))
        found[:slow] = found[last_slow]
        return found

    taken = np.minimum(power(record.load_error[:, : record.load_fitted]) / noise.power, MOST_TAKEN)
    left = power((record.raw_load_N_m - record.tau_w_N_m)[:, None]) / (1.0 - taken)
    return np.where((count >= FEWEST_BINS) | (np.arange(centres.size) < slow), left, np.nan)


def _low(pair: tuple[Part, Part], left: Flat, response: Response, records: Sequence[Record], cuts: Vector) -> Vector:
    """Return a run's noise power between the cuts; NaN where it has too few bins."""
    motor, jaw = pair
    record = records[motor.run]
    frequency = np.arange((jaw.stop - jaw.start) // 2) / (jaw.rows * record.period_s)
    here = np.searchsorted(cuts, frequency, side="right") - 1
    inside = (here >= 0) & (here < cuts.size - 1)
    both = (response.gains["jaw"][JAW] * response.gains["jaw"][motor.channel].conj())[inside]
    here = here[inside]
    r_m, r_j = (_clipped(_bins(left, part)[inside], here, cuts.size - 1) for part in (motor, jaw))
    product = np.bincount(here, (r_j * r_m.conj() * both.conj()).real, cuts.size - 1)
    weight = np.bincount(here, np.abs(both) ** 2, cuts.size - 1)
    # r is scaled so that its real part alone has the variance of white noise.
    power = np.maximum(product / np.maximum(weight, 1e-300), 0.0) / 2.0
    count = np.bincount(here, minlength=cuts.size - 1)
    return np.where(count >= FEWEST_BINS, power, np.nan)


def _high(records: Sequence[Record], cuts: Vector) -> tuple[Vector, Vector]:
    """Return frequencies and power of the load's own spectrum: of third differences, which see none of its course."""
    found = []
    for record in records:
        load = record.raw_load_N_m
        assert load is not None
        third = np.diff(load, n=3)
        for row in record.edge_rows:
            third[max(0, row - EDGE_ROWS) : row + EDGE_ROWS] = 0.0
        power = np.abs(fft.rfft(third)) ** 2 / max(np.count_nonzero(third), 1)
        frequency = fft.rfftfreq(third.size, record.period_s)
        power /= np.maximum((2.0 * np.sin(np.pi * frequency * record.period_s)) ** 6, 1e-12)
        spans = [power[(frequency >= a) & (frequency <= b)] for a, b in pairwise(cuts)]
        found.append([float(np.median(span)) / np.log(2.0) if span.size else np.nan for span in spans])
    return np.sqrt(cuts[1:] * cuts[:-1]), np.nanmedian(np.array(found), axis=0)


def _bins(flat: Flat, part: Part) -> Complex:
    return flat[part.start : part.stop].view(np.complex64).astype(np.complex128)


def _clipped(bins: Complex, here: NDArray[np.intp], bands: int) -> Complex:
    size = np.abs(bins)
    usual = np.array([np.median(size[here == b]) if np.any(here == b) else 0.0 for b in range(bands)])[here]
    return bins * np.minimum(1.0, CLIPPED * usual / np.maximum(size, 1e-300))
