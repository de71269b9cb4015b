"""A zero for each series of runs (those of one frequency, recorded one after the other) by its training runs.

A bench's sensors are set to zero now and then, and a robot is homed before it is used. How far the means of a method's
errors differ between series, beyond how they differ within, says whether that matters; zeros are shrunk by that share
(best linear unbiased prediction; Robinson, Statistical Science 6(1), 1991), so that none comes from chance alone.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Vector = NDArray[np.float64]


class Means(NamedTuple):
    """Mean errors of one method over a run."""

    run: str
    tau_w_N_m: float
    theta_j_rad: float


class SeriesZeros(NamedTuple):
    """What each series' errors have in common, shrunk, and how probable it would be by chance (F test)."""

    tau_w_N_m: dict[int, float]
    theta_j_rad: dict[int, float]
    tau_w_chance: float  # NaN where too few runs tell
    theta_j_chance: float

    def of(self, series: int) -> tuple[float, float]:
        """Return the zeros of a series; none of one that no training run belongs to."""
        return self.tau_w_N_m.get(series, 0.0), self.theta_j_rad.get(series, 0.0)


NO_ZEROS = SeriesZeros({}, {}, float("nan"), float("nan"))


def series_zeros(train: Sequence[Means], series: Mapping[str, int]) -> SeriesZeros:
    """Return the zeros of each series by the mean errors on its training runs."""
    groups = np.array([series[means.run] for means in train], dtype=np.intp)
    tau_w, tau_w_chance = _shrunk(np.array([means.tau_w_N_m for means in train]), groups)
    theta_j, theta_j_chance = _shrunk(np.array([means.theta_j_rad for means in train]), groups)
    return SeriesZeros(tau_w, theta_j, tau_w_chance, theta_j_chance)


def _shrunk(values: Vector, groups: NDArray[np.intp]) -> tuple[dict[int, float], float]:
    """Return the group means about 0, shrunk by the share of their variance that isn't chance, and its probability."""
    names, counts = np.unique(groups, return_counts=True)
    degrees = values.size - names.size
    if names.size < 2 or degrees < 1:
        return {}, float("nan")
    means = np.array([values[groups == name].mean() for name in names])
    inside = float(sum(np.sum((values[groups == name] - mean) ** 2) for name, mean in zip(names, means, strict=True)))
    within = inside / degrees
    between = float(np.sum(counts * (means - values.mean()) ** 2)) / (names.size - 1)
    if within <= 0.0:
        return dict(zip(names.tolist(), means.tolist(), strict=True)), 0.0 if between > 0.0 else float("nan")
    usual = (counts.sum() - np.sum(counts**2) / counts.sum()) / (names.size - 1)
    spread = max(between - within, 0.0) / usual
    shares = spread / (spread + within / counts)
    chance = float(stats.f.sf(between / within, names.size - 1, degrees))
    return dict(zip(names.tolist(), (shares * means).tolist(), strict=True)), chance
