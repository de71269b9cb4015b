"""Noise of the sensors by the likelihood of all channels, where differences of a channel alone don't tell it.

A loop that hunts over coarse counts moves the jaw as fast as coloured noise does, and differences over a few rows can't
tell one from the other (`preparation.sensor_noise`). The filter knows that motion from counts and current. Noise is
only ever lessened here: what a model doesn't explain would ask for more of it, and hide there. Of coloured noise that
is the density at low frequencies, q/(1 − ρ)² with q the variance of what is new at each row: effects are slow. No
sensor becomes better than the equations: smaller deviations are no noise (`preparation.sensor_noise.least_deviations`).
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from hil_forceps.diagnosis.evidence import Mapper
from hil_forceps.diagnosis.inference.fit import Fit
from hil_forceps.diagnosis.preparation.records import Record
from hil_forceps.diagnosis.preparation.sensor_noise import MAX_CORRELATION, MIN_CORRELATION
from hil_forceps.diagnosis.state_space.layout import Noise
from hil_forceps.diagnosis.state_space.passes import Passed

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_ROWS = 20_000  # that the filter passes over for it: they tell a deviation to 0.5 %
OVERESTIMATED_VARIANCE = 0.8  # of whitened innovations: less is no chance, which leaves 1 ± 0.02 over 5000 rows
MAX_LESSENING = 10.0  # factor by which a white deviation may fall
# By which the density at low frequencies may exceed that from differences: over a few runs these tell a correlation of
# 0.9 to ± 0.03, and the density to this factor.
DENSITY_FACTOR = 2.0
_MAX_PASSES = 40
# χ² a row that autoregressive noise of this correlation gains over white noise: −ln(1 − ρ²).
_COLOURED_CHI2_PER_ROW = -math.log(1.0 - MIN_CORRELATION**2)

Likelihood = Callable[[Noise], float]


def likeliest_noise(noise: Noise, least: Vector, records: Sequence[Record], found: Fit, mapper: Mapper) -> Noise:
    """Return the noise that is likeliest beside fitted parameters; that of white channels which it suits stays.

    `least`: the deviations below which none falls.
    """
    runs = [record.decided_by(passed.filtered) for record, passed in zip(records, found.passes.runs, strict=True)]
    passes = list(found.passes.runs)
    doubted = [channel for channel in range(3) if _is_doubtful(noise, least, channel, passes)]
    if not doubted:
        return noise
    chosen = _some(passes)
    runs, masks = [runs[i] for i in chosen], [passes[i].counts for i in chosen]

    def likelihood(tried: Noise) -> float:
        def one(pair: tuple[Record, Mask]) -> float:
            passed = pair[0].with_noise(tried).passed(found.passes.theta, found.passes.plant)
            return float(passed.log_likelihood[pair[1] & passed.counts].sum())

        return math.fsum(mapper(one, list(zip(runs, masks, strict=True))))

    for channel in doubted:
        rows = sum(int(mask[:, channel + 1].sum()) for mask in masks)
        white, at_white = _white(noise, least, channel, likelihood)
        if noise.correlation[channel] != 0.0:
            coloured, at_coloured = _coloured(noise, least, channel, likelihood)
            noise = coloured if 2.0 * (at_coloured - at_white) > _COLOURED_CHI2_PER_ROW * rows else white
        else:
            noise = white
    return noise


def _is_doubtful(noise: Noise, least: Vector, channel: int, passes: Sequence[Passed]) -> bool:
    """Tell whether a channel's noise is said to be coloured, or its innovations are smaller than chance makes them."""
    if noise.resolution[channel] > 0.0 or noise.deviation[channel] <= least[channel]:
        return False
    squares = np.concatenate([p.filtered.residual[p.counts[:, channel + 1], channel + 1] ** 2 for p in passes])
    return squares.size > 0 and bool(
        noise.correlation[channel] != 0.0 or float(np.mean(squares)) < OVERESTIMATED_VARIANCE
    )


def _some(passes: Sequence[Passed]) -> list[int]:
    """Return the places of the runs with the most evidence, `MAX_ROWS` and what the first of them has."""
    chosen: list[int] = []
    rows = 0
    for place in sorted(range(len(passes)), key=lambda i: -int(passes[i].counts[:, 1:3].sum())):
        if chosen and rows + passes[place].counts.shape[0] > MAX_ROWS:
            continue
        chosen.append(place)
        rows += passes[place].counts.shape[0]
    return chosen


def _changed(noise: Noise, channel: int, deviation: float, correlation: float) -> Noise:
    deviations, correlations = noise.deviation.copy(), noise.correlation.copy()
    deviations[channel], correlations[channel] = deviation, correlation
    return noise._replace(deviation=deviations, correlation=correlations)


def _white(noise: Noise, least: Vector, channel: int, likelihood: Likelihood) -> tuple[Noise, float]:
    """Return the likeliest white noise that is no larger than the given one, and its log likelihood."""
    most = float(noise.deviation[channel])

    def loss(log_share: float) -> float:
        return -likelihood(_changed(noise, channel, most * math.exp(log_share), 0.0))

    bounds = (math.log(max(1.0 / MAX_LESSENING, float(least[channel]) / most)), 0.0)
    found = optimize.minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 0.01})
    return _changed(noise, channel, most * math.exp(float(found.x)), 0.0), -float(found.fun)


def _coloured(noise: Noise, least: Vector, channel: int, likelihood: Likelihood) -> tuple[Noise, float]:
    """Return the likeliest autoregressive noise, and its log likelihood.

    Searched over what is new at each row and over how much is forgotten, which the data tell independently.
    """
    before = float(noise.correlation[channel])
    new = float(noise.deviation[channel]) * math.sqrt(1.0 - before**2)
    most = math.sqrt(DENSITY_FACTOR) * new / (1.0 - before)

    def of(place: Vector) -> Noise:
        deviation = math.exp(float(place[0]))
        forgotten = max(math.exp(float(place[1])), 1.0 - MAX_CORRELATION, deviation / most)
        correlation = 1.0 - min(forgotten, 1.0 - MIN_CORRELATION)
        whole = max(deviation / math.sqrt(1.0 - correlation**2), float(least[channel]))
        return _changed(noise, channel, whole, correlation)

    start = np.array([math.log(new), math.log(1.0 - before)])
    simplex = start + np.array([[0.0, 0.0], [-0.2, 0.0], [0.0, 0.7]])
    options = {"initial_simplex": simplex, "maxfev": _MAX_PASSES, "xatol": 0.02, "fatol": 2.0}
    found = optimize.minimize(lambda place: -likelihood(of(place)), start, method="Nelder-Mead", options=options)
    return of(np.asarray(found.x)), -float(found.fun)
