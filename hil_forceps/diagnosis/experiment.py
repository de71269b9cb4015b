"""Runs made ready for simulation: rows on an even grid, jumps of the load found, rows that don't count masked."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hil_forceps.diagnosis.load_course import load_course
from hil_forceps.diagnosis.smoothing import USUAL_CUTOFF, LoadNoise, slow_noise, smooth_load, smoothed
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.runs.table import Run

Vector = NDArray[np.float64]
Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]
Mode = Literal["closed_loop", "driven"]

FEWEST_ROWS = 50
MAX_ROWS = 240_000  # of all runs together; longer ones are cut, and that is said
BURN_IN_S = 0.15  # the state before the first row is known roughly: it settles within this
JITTER_FOR_RESAMPLING = 0.02  # of the row period
JUMP_IN_SD = 8.0  # an increment of τ_w this far above its usual size is a step of the load
AFTER_GAP_S = 0.05
DRAWS = 6  # of what a load's course leaves open


class Calm(NamedTuple):
    """What drives a run in mode "driven", without its noise: what sensitivities come from."""

    motor_rad: Vector
    tau_w_N_m: Vector | None
    theta_j_rad: Vector | None  # where it drives


class Record(NamedTuple):
    """One run on an even grid."""

    name: str
    mode: Mode
    period_s: float
    time_s: Vector
    reference_rad: Vector  # what the motor follows; in mode "driven" its angle as measured
    channels: dict[str, Vector]  # measured: theta_m_rad, current_A or tau_m_N_m, theta_j_rad where there
    tau_w_N_m: Vector | None  # smoothed
    edge_rows: Rows
    weights: Vector  # 1 where a row counts, 0 where it doesn't (burn-in, gaps)
    evenly_logged: bool  # no gap, no resampling: the drive's law can be followed row by row
    theta_j_rad: Vector | None = None  # in mode "driven" without a measured load: it drives, too
    raw_load_N_m: Vector | None = None  # as measured; only in closed loop
    load_noise: LoadNoise | None = None  # the load cell's
    load_error: NDArray[np.float32] | None = None  # what its course leaves open, as `load_course` has it
    load_fitted: int = 0  # how many columns of that, the first, the course was fitted with
    load_draws: Vector | None = None  # of that (DRAWS, rows)
    straight: bool = False  # whether its load is known to be of straight pieces
    calm: Calm | None = None  # in mode "driven"


def prepare(runs: Sequence[Run], rig: Rig) -> tuple[list[Record], list[str]]:
    """Make records of runs in closed loop, and notes on what was left out; UserError when a run can't serve at all."""
    notes: list[str] = []
    records = []
    budget = MAX_ROWS // max(len(runs), 1)
    for run in runs:
        record, said = _record(run, rig, budget)
        records.append(record)
        notes += said
    return records, notes


def mode_of(runs: Sequence[Run], rig: Rig) -> Mode:
    """Closed loop where the drive's law, its reference and the current are known; else θ_m as measured drives."""
    known = all("theta_m_ref_rad" in run.columns and "current_A" in run.columns for run in runs)
    return "closed_loop" if known and rig.drive is not None else "driven"


def require_rows(name: str, rows: int) -> None:
    """UserError where a run has too few rows to be diagnosed."""
    if rows < FEWEST_ROWS:
        raise UserError(f"{name}: {rows} rows are too few to diagnose; at least {FEWEST_ROWS} are needed")


def _record(run: Run, rig: Rig, budget: int) -> tuple[Record, list[str]]:
    notes = []
    columns = dict(run.columns)
    if len(run) > budget:
        notes.append(f"{run.name}: only its first {budget} of {len(run)} rows are used")
        columns = {name: values[:budget] for name, values in columns.items()}
    time = columns.pop("time_s")
    period = float(np.median(np.diff(time)))
    require_rows(run.name, time.size)
    if rig.drive is not None:
        ratio = period / rig.drive.sample_time_s
        if ratio > 0.5 and abs(ratio - round(ratio)) < 0.02:
            period = round(ratio) * rig.drive.sample_time_s  # stamps are printed with few digits
    rows, grid, missing = grid_of(time, period)
    uneven = bool(missing.any()) or rows.size != time.size or jitter_of(time, period) > JITTER_FOR_RESAMPLING
    if uneven:
        columns = {name: np.interp(grid, time, values) for name, values in columns.items()}
    weights = np.where(missing, 0.0, 1.0)
    weights[: max(1, round(BURN_IN_S / period))] = 0.0
    tau_w = columns.get("tau_w_N_m")
    edges = jumps(tau_w) if tau_w is not None else np.empty(0, dtype=np.intp)
    used = ("theta_m_rad", "current_A", "theta_j_rad")
    record = Record(
        run.name,
        "closed_loop",
        period,
        grid - grid[0],
        columns.get("theta_m_ref_rad", np.zeros(grid.size)),
        {name: columns[name] for name in used if name in columns},
        smooth_load(tau_w, edges, period) if tau_w is not None else None,
        edges,
        weights,
        not uneven,
        raw_load_N_m=tau_w,
    )
    return record, notes


def with_raw_load(records: Sequence[Record]) -> list[Record]:
    """Return records with the load as it was measured."""
    return [r if r.raw_load_N_m is None else r._replace(tau_w_N_m=r.raw_load_N_m) for r in records]


def with_load_course(record: Record, noise: LoadNoise) -> Record:
    """Return a record with the course of its load, as far as its noise lets it be known."""
    if record.raw_load_N_m is None:
        return record
    course = load_course(record.raw_load_N_m, record.edge_rows, record.period_s, noise)
    return record._replace(
        tau_w_N_m=course.load,
        load_noise=noise,
        load_error=course.error,
        load_fitted=course.fitted,
        load_draws=_draws(course.load.size, course.error, noise),
        straight=course.straight,
    )


def _draws(rows: int, error: NDArray[np.float32] | None, noise: LoadNoise) -> Vector:
    """Return draws of what a load's course leaves open (DRAWS, rows), which together are 0.

    A Latin hypercube: over the draws each error is as large as it is told to be, however few they are (McKay, Beckman
    and Conover, Technometrics 21, 1979). Slow: what is quick in them would ring the simulated wire.
    """
    rng = np.random.default_rng(rows)
    if error is None:
        half = [slow_noise(rng, rows, noise) for _ in range(DRAWS // 2)]
        return np.stack([*half, *(-draw for draw in half)])
    scores = stats.norm.ppf((np.arange(DRAWS) + 0.5) / DRAWS)
    scores /= np.sqrt(np.mean(scores**2))
    numbers = rng.permuted(np.tile(scores, (error.shape[1], 1)), axis=1)
    return np.stack([smoothed(draw, USUAL_CUTOFF) for draw in (error @ numbers).T])


def grid_of(time: Vector, period: float) -> tuple[Rows, Vector, Mask]:
    """Return the row of the grid that each stamp falls on, the grid, and which of its rows nothing was measured at."""
    rows = np.rint((time - time[0]) / period).astype(np.intp)
    if np.array_equal(rows, np.arange(time.size)):
        return rows, time[0] + period * np.arange(time.size), np.zeros(time.size, dtype=np.bool_)
    intervals = np.maximum(np.rint(np.diff(time) / period).astype(np.intp), 1)
    rows = np.concatenate(([0], np.cumsum(intervals)))
    count = min(int(rows[-1]) + 1, 4 * time.size)
    present = np.zeros(count, dtype=np.bool_)
    present[rows[rows < count]] = True
    missing = ~present
    shadow = max(1, round(AFTER_GAP_S / period))
    spread = np.convolve(missing.astype(float), np.ones(shadow))[:count] > 0.0
    return rows, time[0] + period * np.arange(count), spread


def jitter_of(time: Vector, period: float) -> float:
    """Return how much the intervals of stamps (n) vary, gaps apart; in row periods."""
    intervals = np.diff(time)
    regular = intervals[intervals < 1.5 * period]
    return float(np.std(regular) / period) if regular.size > 1 else 0.0


def jumps(tau_w: Vector) -> Rows:
    """Return the rows after which the load jumps: single increments far above all others around them."""
    steps = np.abs(np.diff(tau_w))
    usual = float(np.median(steps)) / 0.6745
    scale = max(usual, 1e-3 * float(np.ptp(tau_w)))
    if scale <= 0.0:
        return np.empty(0, dtype=np.intp)
    found = np.flatnonzero(steps > JUMP_IN_SD * scale)
    # A ramp fast against its noise has many large increments in a row; those are no jumps.
    alone = [row for row in found if not ({row - 1, row + 1} & set(found.tolist()))]
    return np.array(alone, dtype=np.intp)
