"""Data of the figures as plain arrays, filled by bench and replay."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class RunTraces(NamedTuple):
    """One simulated run, on one time axis, arrays [samples]; NaN where it diverged."""

    time_s: Array  # from the zero of the experiment
    tau_w_true: Array  # N m
    tau_w_est: Array  # N m
    theta_j_true: Array  # rad
    theta_j_ref: Array  # rad
    x_true: Array  # m, elongation of the wire
    x_est: Array  # m
    algorithm: str  # id of the registry
    compensated: bool
    simulation: int  # 1 or 2, as the paper numbers them
    sample_time_s: float


class SummaryPoint(NamedTuple):
    """One run's error as the summary chart shows it."""

    algorithm: str
    simulation: int
    sample_time_s: float
    tau_w_rmse_N_m: float | None  # None if the run was not finite


class TimingTraces(NamedTuple):
    """Ages and lateness of one run in real time, with the account of its frames."""

    age_s: Array  # [samples] from a drive's sample to the reference computed from it being handed to the bus
    lateness_s: Array  # [ticks] from when a tick was due to when it ran
    age_marks_s: dict[str, float]  # drawn over the histogram, e.g. {"p50": 7e-4, "p99": 9e-4, "max": 2e-3}
    lateness_marks_s: dict[str, float]
    period_s: float  # of the tick
    frames: dict[str, int]  # every frame in exactly one class, e.g. {"delivered": 59998, "lost on the bus": 2}
    label: str  # e.g. "pty, 60 s"
