"""Errors of methods on runs held out: gathered run by run, over all of them, and about the zeros of their series."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hil_forceps.identification.instrument.report import Array
from hil_forceps.identification.instrument.series_zeros import NO_ZEROS, Means, SeriesZeros, series_zeros
from hil_forceps.identification.instrument.splits import Split

_Key = tuple[str, str, str]  # source, method, part


class HeldOut(NamedTuple):
    """Error of one method on the runs or samples of a split that it hasn't seen; `run` "" for all of them."""

    split: str
    run: str
    source: str
    method: str
    part: str
    tau_w_rmse_N_m: float
    theta_j_rmse_rad: float
    samples: int


class HeldOutErrors:
    """Squared errors gathered run by run, and mean errors on the training runs."""

    def __init__(self, split: Split) -> None:
        self.split = split.name
        self.series = split.series
        self.per_run: list[HeldOut] = []
        self._means: list[Means] = []  # of each of `per_run`
        self._train: dict[_Key, list[Means]] = {}

    def add(self, run: str, source: str, method: str, part: str, tau_w: Array, theta_j: Array) -> None:
        """Take in one method's errors on one run."""
        if len(tau_w):
            score = HeldOut(self.split, run, source, method, part, rms(tau_w), rms(theta_j), len(tau_w))
            self.per_run.append(score)
            self._means.append(Means(run, float(np.mean(tau_w)), float(np.mean(theta_j))))

    def add_training(self, run: str, source: str, method: str, part: str, tau_w: float, theta_j: float) -> None:
        """Take in one method's mean errors on one training run."""
        self._train.setdefault((source, method, part), []).append(Means(run, tau_w, theta_j))

    def overall(self) -> list[HeldOut]:
        """Return the errors over all samples, in the order in which methods came."""
        return self._pooled(self.per_run)

    def by_series(self) -> list[HeldOut]:
        """Return the same with the zero of each series taken from its training runs."""
        zeros = {key: series_zeros(means, self.series) for key, means in self._train.items()}
        moved = []
        for score, means in zip(self.per_run, self._means, strict=True):
            found = zeros.get((score.source, score.method, score.part), NO_ZEROS)
            tau_w, theta_j = found.of(self.series[score.run])
            moved.append(
                score._replace(
                    tau_w_rmse_N_m=_about(score.tau_w_rmse_N_m, means.tau_w_N_m, tau_w),
                    theta_j_rmse_rad=_about(score.theta_j_rmse_rad, means.theta_j_rad, theta_j),
                )
            )
        return self._pooled(moved)

    def zeros_of(self, method: str) -> dict[str, SeriesZeros]:
        """Return the zeros of each series for a method, by split, source and part."""
        return {
            f"{self.split}/{source}/{part}": series_zeros(means, self.series)
            for (source, own, part), means in self._train.items()
            if own == method
        }

    def _pooled(self, per_run: Sequence[HeldOut]) -> list[HeldOut]:
        groups: dict[_Key, list[HeldOut]] = {}
        for score in per_run:
            groups.setdefault((score.source, score.method, score.part), []).append(score)
        return [HeldOut(self.split, "", *key, *_pooled(scores)) for key, scores in groups.items()]


def rms(values: Array) -> float:
    """Return the root mean square."""
    return math.sqrt(float(np.mean(values**2)))


def _about(rmse: float, mean: float, zero: float) -> float:
    """Return the root mean square about a zero of errors with this one about 0 and this mean."""
    return math.sqrt(max(rmse**2 - 2.0 * zero * mean + zero**2, 0.0))


def _pooled(scores: Sequence[HeldOut]) -> tuple[float, float, int]:
    count = sum(score.samples for score in scores)
    tau_w = sum(score.samples * score.tau_w_rmse_N_m**2 for score in scores) / count
    theta_j = sum(score.samples * score.theta_j_rmse_rad**2 for score in scores) / count
    return math.sqrt(tau_w), math.sqrt(theta_j), count
