"""Fit of the transmission model to training runs.

Within a structure it is linear least squares. What isn't linear (the low-pass, the presliding lengths, what friction
takes at rest) comes from a small fixed grid, the same for every data set; of its points the one is taken that predicts
a load level best that it wasn't fitted to, the levels left out one at a time. Only training runs are seen.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.run import Run
from hil_forceps.estimation import transmission
from hil_forceps.estimation.transmission import Structure
from hil_forceps.rig.errors import UserError

Vector = NDArray[np.float64]

CORNERS_Hz = (10.0, 20.0, 40.0)
# What friction at rest takes of what drives, in standard deviations of it. Between a current and the wire there is the
# gear's friction; the torque of the spindle is measured behind it.
STANDSTILL: Mapping[str, tuple[float, ...]] = {"current_A": (0.0, 1.5, 3.0)}
PRESLIDING_RAD = ((0.006, 0.03, 0.12), (0.01, 0.04, 0.15), (0.015, 0.06, 0.25))
SAMPLE_STRIDE = 10  # of the samples are fitted to: neighbours tell the same
DROPPED_S = 1.0  # at both ends
OUTLIER_SHARE = 5e-4  # of the samples lies outside the range of θ at either end: outliers don't stretch it
RIDGE_SHARE = 1e-6  # of a column's power: keeps coefficients small that the data don't tell apart


class Inputs(NamedTuple):
    """One run's motor side, arrays [samples]."""

    time_ns: NDArray[np.int64]
    theta_m_rad: Vector
    theta_drive_rad: Vector
    drive: Vector


class TransmissionFit(NamedTuple):
    """A fitted model and what it took."""

    structure: Structure
    source: str  # the column that drives it
    torque: Vector  # coefficients [TERMS]
    angle: Vector
    constants: Vector
    left_out_tau_w_rmse_N_m: float  # of training levels that were left out in turn
    left_out_theta_j_rmse_rad: float


class _Normal(NamedTuple):
    """Normal equations of one run: enough for a fit to any set of runs and for its errors."""

    matrix: Vector  # [TERMS, TERMS]
    right: Vector  # [TERMS]
    power: float  # Σ y²
    rows: int


def inputs(run: Run, source: str) -> Inputs:
    """Return the motor side of a run driven by column `source`; UserError when the run hasn't got it."""
    if source not in run.columns:
        raise UserError(
            f"run {run.name}: {source} was not measured, but it is an input of the estimator; use runs that have it"
        )
    theta = np.ascontiguousarray(run.columns["theta_m_rad"])
    drive = np.ascontiguousarray(run.columns.get("theta_drive_rad", theta))
    return Inputs(run.time_ns, theta, drive, np.ascontiguousarray(run.columns[source]))


def fit_transmission(runs: Sequence[Run], levels: Mapping[str, int], source: str) -> TransmissionFit:
    """Fit to `runs`, each with jaw torque and angle; `levels` numbers the load level of each run by name.

    UserError when there is no run or one lacks `source`.
    """
    if not runs:
        raise UserError("there is no run to which a transmission can be fitted; add one")
    groups = [levels[run.name] for run in runs]
    if len(set(groups)) < 2:
        groups = list(range(len(runs)))
    theta = np.concatenate([run.columns["theta_m_rad"] for run in runs])
    low, high = np.quantile(theta, [OUTLIER_SHARE, 1.0 - OUTLIER_SHARE])
    if not high > low:
        raise UserError(
            "θ_m does not move in the training runs, so that no transmission can be fitted; use runs with motion"
        )
    for run in runs:
        inputs(run, source)
    deviation = _spread(runs, source)
    best: TransmissionFit | None = None
    least = math.inf
    for corner_Hz, lengths, taken in product(CORNERS_Hz, PRESLIDING_RAD, STANDSTILL.get(source, (0.0,))):
        structure = Structure(2.0 * math.pi * corner_Hz, lengths, (float(low), float(high)), taken * deviation)
        fitted, cost = _fit_one(runs, groups, source, structure)
        if best is None or cost < least:
            best, least = fitted, cost
    assert best is not None
    return best


def counted(run: Run) -> NDArray[np.intp]:
    """Return the rows that a fit takes: every `SAMPLE_STRIDE`th but those of the ends."""
    time_s = run.columns["time_s"]
    inside = (time_s >= time_s[0] + DROPPED_S) & (time_s <= time_s[-1] - DROPPED_S)
    return np.flatnonzero(inside)[::SAMPLE_STRIDE]


def _fit_one(
    runs: Sequence[Run], groups: Sequence[int], source: str, structure: Structure
) -> tuple[TransmissionFit, float]:
    bare = transmission.constants(structure)
    torque, angle = [], []
    for run in runs:
        rows, free = transmission.terms(bare, *inputs(run, source))
        keep = counted(run)
        torque.append(_normal(rows[keep], run.columns["tau_w_N_m"][keep]))
        angle.append(_normal(transmission.for_angle(rows[keep], free[keep]), run.columns["theta_j_rad"][keep]))
    errors = [_left_out(torque, groups), _left_out(angle, groups)]
    spreads = [_spread(runs, "tau_w_N_m"), _spread(runs, "theta_j_rad")]
    cost = sum(error / spread for error, spread in zip(errors, spreads, strict=True))
    a, b = _solve(torque), _solve(angle)
    return TransmissionFit(structure, source, a, b, transmission.constants(structure, a, b), *errors), cost


def _spread(runs: Sequence[Run], column: str) -> float:
    return float(np.std(np.concatenate([run.columns[column] for run in runs]))) or 1.0


def _normal(rows: Vector, y: Vector) -> _Normal:
    return _Normal(rows.T @ rows, rows.T @ y, float(y @ y), len(y))


def _solve(parts: Sequence[_Normal]) -> Vector:
    matrix = np.sum([part.matrix for part in parts], axis=0)
    right = np.sum([part.right for part in parts], axis=0)
    scale = np.sqrt(np.diag(matrix))
    scale[scale == 0.0] = 1.0  # a term that is always 0 gets the coefficient 0
    scaled = matrix / scale / scale[:, None] + RIDGE_SHARE * np.eye(len(scale))
    solution: Vector = np.linalg.solve(scaled, right / scale) / scale
    return solution


def _left_out(parts: Sequence[_Normal], groups: Sequence[int]) -> float:
    """RMSE over all runs, each predicted by the fit to the runs of other groups; its own where there is one group."""
    total, count = 0.0, 0
    for group in sorted(set(groups)):
        inside = [part for part, own in zip(parts, groups, strict=True) if own == group]
        outside = [part for part, own in zip(parts, groups, strict=True) if own != group]
        solution = _solve(outside or inside)
        for part in inside:
            total += float(part.power - 2.0 * solution @ part.right + solution @ part.matrix @ solution)
            count += part.rows
    return math.sqrt(max(total, 0.0) / count)
