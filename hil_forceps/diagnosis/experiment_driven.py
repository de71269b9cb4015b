"""Runs made ready where the measured motion drives the simulation: smoothed, thinned out, rows at rest masked.

Every channel goes through the same zero-phase low pass, so that balances between them hold as they did before; then
rows are taken at a rate at which nothing of what passed is lost. What drives is there a second time, smoothed where and
as far as its noise asks for: sensitivities must not depend on the noise, which the residual holds, too.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from hil_forceps.diagnosis.experiment import BURN_IN_S, JITTER_FOR_RESAMPLING, Calm, Record, grid_of, jitter_of, jumps
from hil_forceps.diagnosis.shaking import on_grid
from hil_forceps.diagnosis.smoothing import LoadNoise, smooth_load, white_deviation
from hil_forceps.rig.errors import UserError
from hil_forceps.runs.table import Run

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_ROWS = 30_000  # of all runs together
HIGHEST_RATE_Hz = 260.0  # of rows: what a balance of torques tells lies far below its half
PASS_SHARE = 0.2  # of the rate of rows: the corner of the low pass
ORDER = 4
FEWEST_ROWS = 50
AROUND_JUMP_S = 0.04  # longer than the low pass answers
STILL_SHARE = 0.03  # of the top speed: below it friction may be anything up to its level
TOP_QUANTILE = 0.99
MOST_BENT = 6.0  # as in `smoothing`: what it bends is in the offset, what it lets through ties columns to the residual
CHANNELS = ("theta_m_rad", "current_A", "tau_m_N_m", "theta_j_rad", "tau_w_N_m")


def prepare_driven(runs: Sequence[Run], load_noise: LoadNoise | None = None) -> tuple[list[Record], list[str]]:
    """Make records of the runs, and notes on what was left out; UserError when a run can't serve at all.

    `load_noise`: what is known of the load cell's noise; None: what changes from row to row.
    """
    short = [run.name for run in runs if len(run) < FEWEST_ROWS]
    if short:
        raise UserError(f"{short[0]}: too few rows to diagnose; at least {FEWEST_ROWS} are needed")
    periods = [float(np.median(np.diff(run.columns["time_s"]))) for run in runs]
    rows = sum(float(np.ptp(run.columns["time_s"])) / period for run, period in zip(runs, periods, strict=True))
    crowd = rows / MAX_ROWS
    notes, records = [], []
    for run, period in zip(runs, periods, strict=True):
        factor = max(1, round(1.0 / (HIGHEST_RATE_Hz * period)), int(np.ceil(crowd)))
        records.append(_record(run, period, factor, load_noise))
        notes.append(
            f"{run.name}: all channels low-passed at {PASS_SHARE / (factor * period):.3g} Hz, one row in {factor} used"
        )
    return records, notes


def torque_channel(record: Record) -> str:
    """Return which channel shows the motor's torque."""
    return "tau_m_N_m" if "tau_m_N_m" in record.channels else "current_A"


def _record(run: Run, period: float, factor: int, load_noise: LoadNoise | None) -> Record:
    columns = {name: run.columns[name] for name in CHANNELS if name in run.columns}
    time = run.columns["time_s"]
    rows, grid, missing = grid_of(time, period)
    uneven = bool(missing.any()) or rows.size != time.size or jitter_of(time, period) > JITTER_FOR_RESAMPLING
    if uneven:
        columns = {name: np.interp(grid, time, values) for name, values in columns.items()}
    if "current_A" in columns:
        # A drive holds its current between samples, and a row has the one held until then: half a row ago on average.
        columns["current_A"] = 0.5 * (
            columns["current_A"] + np.append(columns["current_A"][1:], columns["current_A"][-1])
        )
    edges = jumps(columns["tau_w_N_m"]) if "tau_w_N_m" in columns else np.empty(0, dtype=np.intp)
    step = float(factor * period)
    low_pass = butter(ORDER, 2.0 * PASS_SHARE / factor, output="sos")

    def slow(values: Vector) -> Vector:
        return np.ascontiguousarray(sosfiltfilt(low_pass, values)[::factor])

    driving = ("theta_m_rad", "tau_w_N_m" if "tau_w_N_m" in columns else "theta_j_rad")
    noises = {name: row_noise([columns[name]], period) for name in driving if name in columns}
    if load_noise is not None and "tau_w_N_m" in noises:
        noises["tau_w_N_m"] = load_noise
    calm = {name: slow(smooth_load(columns[name], edges, period, noise, MOST_BENT)) for name, noise in noises.items()}
    columns = {name: slow(values) for name, values in columns.items()}
    angle = columns.pop("theta_m_rad")
    count = angle.size
    weights: Vector = np.where(np.maximum.reduceat(missing, np.arange(0, missing.size, factor)), 0.0, 1.0)
    ends = max(1, round(BURN_IN_S / step))
    weights[:ends] = weights[-ends:] = 0.0
    weights[np.abs(np.gradient(angle, step)) < still_rad_per_s(angle, step)] = 0.0
    weights *= _away(edges, factor, count, round(AROUND_JUMP_S / step))
    if "tau_m_N_m" in columns:
        columns.pop("current_A", None)
    load = columns.pop("tau_w_N_m", None)
    jaw = columns.pop("theta_j_rad", None) if load is None else None
    return Record(
        run.name,
        "driven",
        step,
        step * np.arange(count, dtype=np.float64),
        angle,
        columns,
        load,
        np.empty(0, dtype=np.intp),
        weights,
        not uneven,
        jaw,
        calm=Calm(calm["theta_m_rad"], calm.get("tau_w_N_m"), calm.get("theta_j_rad")),
    )


def row_noise(columns: Sequence[Vector], period_s: float) -> LoadNoise:
    """Return the white noise of a channel: that of counting or what changes from row to row, whichever is more."""
    deviations = [white_deviation(list(columns))]
    for values in columns:
        steps = np.abs(np.diff(values))
        quantum = float(np.min(steps[steps > 0.0], initial=np.inf))
        if np.isfinite(quantum) and on_grid(values, quantum):
            deviations.append(quantum / np.sqrt(12.0))
    return LoadNoise(np.array([0.0, 0.5 / period_s]), np.full(2, max(deviations) ** 2))


def _away(edges: NDArray[np.intp], factor: int, count: int, reach: int) -> Vector:
    """Return 0 around the rows where the load jumps, 1 elsewhere: when it jumped between two rows nobody knows."""
    away = np.ones(count)
    for row in edges // factor:
        away[max(row - reach, 0) : row + reach + 2] = 0.0
    return away


def still_rad_per_s(angle: Vector, period_s: float) -> float:
    """Return the speed below which a motor counts as at rest."""
    return STILL_SHARE * float(np.quantile(np.abs(np.gradient(angle, period_s)), TOP_QUANTILE))
