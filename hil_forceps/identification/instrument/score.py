"""Errors of estimates against what was measured, with zeros shared by all runs of a data set."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from hil_forceps.data.run import Run
from hil_forceps.identification.instrument.report import CLOSING, WHOLE, Array, Score

DROPPED_S = 1.0  # at both ends, as the publication does; the estimators have settled by then
CLOSING_SPEED_RAD_PER_S = 0.25  # the publication's threshold for a closing stroke
SPEED_WINDOW_S = 0.05
MAX_ESTIMATE = 1e6  # N m or rad: an estimate this large has diverged, whether it got to infinity or not

Parts = dict[str, NDArray[np.bool_]]
Key = tuple[str, str, str]  # source, method, part
Zeros = tuple[float | None, float | None]  # of τ_w in N m and of θ_j in rad: measured ≈ estimated + zero


class Estimated(NamedTuple):
    """One method's output over a run, zeros not yet added."""

    tau_w_N_m: Array
    theta_j_rad: Array


class _Moments(NamedTuple):
    """Of measured minus estimated, enough for the RMSE about any zero; `mean` None where it was not finite."""

    samples: int
    mean: float | None
    mean_square: float


def parts_of(run: Run) -> Parts:
    """Return which samples count: all but the ends, and of these the closing strokes (θ_m rising fast enough)."""
    time_s = run.columns["time_s"]
    whole = (time_s >= time_s[0] + DROPPED_S) & (time_s <= time_s[-1] - DROPPED_S)
    window = 2 * round(SPEED_WINDOW_S / run.sample_time_s / 2) + 3  # odd, and above the polynomial's degree
    speed = savgol_filter(run.columns["theta_m_rad"], window, polyorder=2, deriv=1, delta=run.sample_time_s)
    return {WHOLE: whole, CLOSING: whole & (speed > CLOSING_SPEED_RAD_PER_S)}


class Tally:
    """Gathers the errors run by run; the zeros, which all runs share, are known only at the end."""

    def __init__(self) -> None:
        self._entries: dict[tuple[str, Key], tuple[_Moments, _Moments]] = {}

    def add(self, run: Run, parts: Parts, source: str, method: str, estimated: Estimated) -> None:
        """Take in one method's output on one run."""
        tau_w = run.columns["tau_w_N_m"] - estimated.tau_w_N_m
        theta_j = run.columns["theta_j_rad"] - estimated.theta_j_rad
        for part, rows in parts.items():
            if np.any(rows):
                self._entries[run.name, (source, method, part)] = _moments(tau_w[rows]), _moments(theta_j[rows])

    def zeros(self) -> dict[Key, Zeros]:
        """Return, per method, what must be added to its estimates; None where no run was finite."""
        return {
            key: (_pooled_mean([a for a, _ in runs]), _pooled_mean([b for _, b in runs]))
            for key, runs in self._by_key()
        }

    def per_run(self) -> tuple[Score, ...]:
        """Return the errors of every run."""
        zeros = self.zeros()
        return tuple(
            Score(run, *key, _rmse([tau_w], zeros[key][0]), _rmse([theta_j], zeros[key][1]), tau_w.samples)
            for (run, key), (tau_w, theta_j) in self._entries.items()
        )

    def overall(self) -> tuple[Score, ...]:
        """Return the errors over all samples of all runs; None where any run was not finite."""
        zeros = self.zeros()
        return tuple(
            Score(
                "",
                *key,
                _rmse([tau_w for tau_w, _ in runs], zeros[key][0]),
                _rmse([theta_j for _, theta_j in runs], zeros[key][1]),
                sum(tau_w.samples for tau_w, _ in runs),
            )
            for key, runs in self._by_key()
        )

    def _by_key(self) -> list[tuple[Key, list[tuple[_Moments, _Moments]]]]:
        keys: dict[Key, list[tuple[_Moments, _Moments]]] = {}
        for (_, key), moments in self._entries.items():
            keys.setdefault(key, []).append(moments)
        return list(keys.items())


def _moments(errors: Array) -> _Moments:
    if not np.all(np.abs(errors) < MAX_ESTIMATE):  # false for NaN as well
        return _Moments(len(errors), None, 0.0)
    return _Moments(len(errors), float(np.mean(errors)), float(np.mean(errors**2)))


def _pooled_mean(runs: list[_Moments]) -> float | None:
    finite = [(run.samples, run.mean) for run in runs if run.mean is not None]
    count = sum(n for n, _ in finite)
    return sum(n * mean for n, mean in finite) / count if count else None


def _rmse(runs: list[_Moments], zero: float | None) -> float | None:
    total = 0.0
    for run in runs:
        if run.mean is None or zero is None:
            return None
        total += run.samples * (run.mean_square - 2 * zero * run.mean + zero**2)
    return float(np.sqrt(max(total, 0.0) / sum(run.samples for run in runs)))
