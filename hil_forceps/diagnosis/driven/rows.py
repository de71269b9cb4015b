"""Runs made ready to drive a simulation: low-passed, thinned out, rows at rest masked.

Every channel goes through the same zero-phase low pass, so that balances between them hold as they did before; then
rows are taken at a rate at which little of what passed is lost. What drives is there a second time, smoothed where and
as far as its noise asks for: sensitivities must not depend on the noise, which the residual holds, too.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from hil_forceps.audit.finding import Finding
from hil_forceps.data.even_rows import MAX_STAMP_SPREAD_ROWS
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.driven.smoothing import smoothed_as_noise_asks, white_deviation
from hil_forceps.diagnosis.preparation.sensor_noise import autoregressive_noise
from hil_forceps.diagnosis.validation.rows import Rows, require_rows

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_ROWS = 30_000  # of all runs together: a simulation of them takes a tenth of a second
HIGHEST_RATE_Hz = 180.0  # of rows: what a balance of torques tells lies far below its half
PASS_SHARE = 0.3  # of the rate of rows: the corner of the low pass
SETTLING_S = 0.15  # at both ends of a run: the low pass and the state of friction
AROUND_JUMP_S = 0.04  # longer than the low pass answers
JUMP_IN_SD = 8.0  # an increment of the load this far above its usual size is a jump
STILL_SHARE = 0.03  # of the top speed: below it friction may be anything up to its level
AFTER_GAP_S = 0.05
DRIVING = ("theta_m_rad", "tau_w_N_m", "theta_j_rad")
CHANNELS = ("theta_m_rad", "current_A", "tau_m_N_m", "theta_j_rad", "tau_w_N_m")


class Smoothed(NamedTuple):
    """What drives a run, without its noise."""

    motor_rad: Vector
    tau_w_N_m: Vector | None
    theta_j_rad: Vector | None  # where it drives


class DrivenRows(NamedTuple):
    """Rows of a run, with what drives it."""

    rows: Rows
    theta_j_rad: Vector | None  # without a measured load it drives, too
    smoothed: Smoothed
    noise: dict[str, float]  # of each channel [rms]: what its sensor's is behind the low pass

    @property
    def torque_channel(self) -> str:
        """Which channel shows the motor's torque."""
        return "tau_m_N_m" if "tau_m_N_m" in self.rows.channels else "current_A"

    @property
    def jaw_rad(self) -> Vector | None:
        """The jaw's angle, whether it is compared or drives."""
        return self.rows.channels.get("theta_j_rad", self.theta_j_rad)


def angle_balance(runs: Sequence[DrivenRows]) -> tuple[NDArray[np.float64], Vector]:
    """Return θ_m, −τ_w and sgn ω (n × 3) and θ_j (n) of all rows that count of runs with a jaw's angle.

    Friction at the jaw stretches the wire one way and the other; left out, it would be taken for load.
    """
    rows, right = [np.empty((0, 3))], [np.empty(0)]
    for run in runs:
        jaw, angle, load = run.jaw_rad, run.rows.reference_rad, run.rows.tau_w_N_m
        if jaw is not None:
            here = run.rows.weights > 0.0
            loads = np.zeros(jaw.size) if load is None else load
            rows.append(np.column_stack((angle, -loads, np.sign(np.gradient(angle))))[here])
            right.append(jaw[here])
    return np.concatenate(rows), np.concatenate(right)


def driven_rows(runs: Sequence[Run]) -> tuple[list[DrivenRows], list[Finding]]:
    """Make rows of the runs, and notes on what was left out; UserError when a run can't serve at all."""
    for run in runs:
        require_rows(run.name, len(run))
    periods = [float(np.median(np.diff(run.columns["time_s"]))) for run in runs]
    count = sum(float(np.ptp(run.columns["time_s"])) / period for run, period in zip(runs, periods, strict=True))
    slow = {name: _slow_noise(runs, name) for name in DRIVING}
    notes, found = [], []
    for run, period_s in zip(runs, periods, strict=True):
        factor = max(1, round(1.0 / (HIGHEST_RATE_Hz * period_s)), int(np.ceil(count / MOST_ROWS)))
        found.append(_rows(run, period_s, factor, slow))
        corner_Hz = PASS_SHARE / (factor * period_s)
        text = f"all channels are low-passed at {corner_Hz:.3g} Hz; one row in {factor} is used"
        notes.append(Finding("preparation", "note", run.name, "", text))
    return found, notes


def _slow_noise(runs: Sequence[Run], name: str) -> float:
    """Return the deviation of white noise that is as strong as a channel's where it is slow."""
    told = [(run, run.columns[name]) for run in runs if name in run.columns]
    if not told:
        return 0.0
    deviation, correlation = autoregressive_noise(told)
    coloured = deviation * float(np.sqrt((1.0 + correlation) / (1.0 - correlation)))
    return max(coloured, white_deviation([values for _, values in told]))


def _rows(run: Run, period_s: float, factor: int, slow_noise: dict[str, float]) -> DrivenRows:
    columns = {name: run.columns[name] for name in CHANNELS if name in run.columns}
    columns, missing = _on_even_rows(run.columns["time_s"], period_s, columns)
    if "current_A" in columns:
        # A drive holds its current between samples, and a row has the one held until then: half a row ago on average.
        current = columns["current_A"]
        columns["current_A"] = 0.5 * (current + np.append(current[1:], current[-1]))
    if "tau_m_N_m" in columns:
        columns.pop("current_A", None)
    jumps = _jumps(columns["tau_w_N_m"]) if "tau_w_N_m" in columns else np.empty(0, dtype=np.intp)
    step_s = factor * period_s
    low_pass = butter(4, min(2.0 * PASS_SHARE / factor, 0.99), output="sos")

    def slow(values: Vector) -> Vector:
        return np.ascontiguousarray(sosfiltfilt(low_pass, values)[::factor])

    load_known = "tau_w_N_m" in columns
    driving = [name for name in ("theta_m_rad", "tau_w_N_m" if load_known else "theta_j_rad") if name in columns]
    smoothed = {name: slow(smoothed_as_noise_asks(columns[name], jumps, slow_noise[name])) for name in driving}
    passed = float(np.sqrt(2.0 * PASS_SHARE / factor))
    noise = {name: passed * white_deviation([values]) for name, values in columns.items()}
    columns = {name: slow(values) for name, values in columns.items()}
    angle, load = columns.pop("theta_m_rad"), columns.pop("tau_w_N_m", None)
    jaw = None if load_known else columns.pop("theta_j_rad", None)
    n = angle.size
    weights: Vector = np.where(np.maximum.reduceat(missing, np.arange(0, missing.size, factor))[:n], 0.0, 1.0)
    ends = max(1, round(SETTLING_S / step_s))
    weights[:ends] = weights[-ends:] = 0.0
    weights[np.abs(np.gradient(angle, step_s)) < still_rad_per_s(angle, step_s)] = 0.0
    reach = round(AROUND_JUMP_S / step_s)
    for row in jumps // factor:  # when it jumped between two rows nobody knows
        weights[max(row - reach, 0) : row + reach + 2] = 0.0
    time_s = step_s * np.arange(n, dtype=np.float64)
    rows = Rows(run.name, step_s, time_s, angle, columns, load, weights, driven=True)
    without_noise = Smoothed(smoothed["theta_m_rad"], smoothed.get("tau_w_N_m"), smoothed.get("theta_j_rad"))
    return DrivenRows(rows, jaw, without_noise, noise)


def _on_even_rows(time_s: Vector, period_s: float, columns: dict[str, Vector]) -> tuple[dict[str, Vector], Mask]:
    """Return columns on equally spaced rows, and which of these nothing was measured at, or shortly before."""
    intervals = np.diff(time_s)
    regular = intervals[intervals < 1.5 * period_s]
    gaps = bool(np.any(intervals >= 1.5 * period_s))
    if not gaps and (regular.size < 2 or float(np.std(regular)) < MAX_STAMP_SPREAD_ROWS * period_s):
        return dict(columns), np.zeros(time_s.size, dtype=np.bool_)
    rows = np.concatenate(([0], np.cumsum(np.maximum(np.rint(intervals / period_s).astype(np.intp), 1))))
    count = min(int(rows[-1]) + 1, 4 * time_s.size)
    grid = time_s[0] + period_s * np.arange(count)
    missing = np.ones(count, dtype=np.bool_)
    missing[rows[rows < count]] = False
    shadow = max(1, round(AFTER_GAP_S / period_s))
    spread = np.convolve(missing.astype(float), np.ones(shadow))[:count] > 0.0
    return {name: np.interp(grid, time_s, values) for name, values in columns.items()}, spread


def _jumps(tau_w: Vector) -> NDArray[np.intp]:
    """Return the rows after which the load jumps: single increments far above all others around them."""
    steps = np.abs(np.diff(tau_w))
    scale = max(float(np.median(steps)) / 0.6745, 1e-3 * float(np.ptp(tau_w)))
    if scale <= 0.0:
        return np.empty(0, dtype=np.intp)
    large = steps > JUMP_IN_SD * scale
    # A ramp fast against its noise has many large increments in a row; those are no jumps.
    beside = np.concatenate(([False], large[:-1])) | np.concatenate((large[1:], [False]))
    return np.flatnonzero(large & ~beside)


def still_rad_per_s(angle: Vector, period_s: float) -> float:
    """Return the speed below which a motor counts as at rest."""
    top = float(np.quantile(np.abs(np.gradient(angle, period_s)), 0.99))
    return STILL_SHARE * top
