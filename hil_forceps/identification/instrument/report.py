"""What came out of a replay of instrument runs: plain data, and its files."""

import csv
import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# O'Neill, Stephens, Kowalewski, IEEE RA-L 3(4), 2018: a 30-neuron network on motor-side signals, trained on neighbours
# of every test sample; closing strokes only, first and last second dropped.
PUBLISHED_THETA_J_RMSE_RAD = math.radians(0.37)
PUBLISHED_TAU_W_RMSE_N_m = 4.42e-3

WHOLE, CLOSING = "whole", "closing"
SAME_FREQUENCY_Hz = 0.03  # runs closer than this were meant to have the same frequency


class RunInfo(NamedTuple):
    """One run as the data show it."""

    name: str
    frequency_Hz: float  # of the motion, from the spectrum of θ_m
    load_N_m: float  # mean of the measured τ_w
    samples: int
    notes: tuple[str, ...]


class Score(NamedTuple):
    """Error of one method on one run (`run` "" for all runs together); None where its numbers were not finite."""

    run: str
    source: str  # the column that drove the estimator; "" for the constant
    method: str  # id of an estimator, or "constant" or "rigid"
    part: str  # WHOLE or CLOSING
    tau_w_rmse_N_m: float | None
    theta_j_rmse_rad: float | None
    samples: int


class Fitted(NamedTuple):
    """The constants fitted per data set and not per run; zeros per method, in the order of `Score`'s keys."""

    radius_ratio: float  # r_m / r_j
    radius_ratio_from: str  # "jaw and spindle angle" or "rig"
    torque_constant_N_m_per_A: float | None  # at the spindle; None where nothing needed it
    torque_constant_from: str  # "spindle torque and current", "rig" or ""
    zeros: dict[str, tuple[float | None, float | None]]  # "source/method/part" -> (τ_w zero N m, θ_j zero rad)


class Trace(NamedTuple):
    """Measured and estimated over one run, arrays [samples], zeros removed as for the whole motion."""

    run: RunInfo
    source: str
    time_s: Array
    theta_m_rad: Array
    tau_m_N_m: Array  # what drove the estimator
    tau_w_measured_N_m: Array
    theta_j_measured_rad: Array
    tau_w_estimated_N_m: dict[str, Array]  # by method
    theta_j_estimated_rad: dict[str, Array]


class Table(NamedTuple):
    """Cells to print."""

    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


class InstrumentReport(NamedTuple):
    """Everything a replay found; `traces` holds a few runs, for the figures."""

    name: str
    runs: tuple[RunInfo, ...]
    fitted: Fitted
    overall: tuple[Score, ...]
    per_run: tuple[Score, ...]
    traces: tuple[Trace, ...]
    assumed: tuple[str, ...]  # what was neither measured nor fitted

    def table(self) -> Table:
        """Overall errors, best jaw torque first, with the published figures in the last row."""
        headers = ("method", "driven by", "part", "τ_w RMSE (mN m)", "θ_j RMSE (deg)")
        worst = math.inf
        ordered = sorted(
            self.overall, key=lambda s: (s.part != WHOLE, worst if s.tau_w_rmse_N_m is None else s.tau_w_rmse_N_m)
        )
        rows = [
            (s.method, s.source or "-", s.part, _cell(s.tau_w_rmse_N_m, 1e3), _cell(s.theta_j_rmse_rad, 180 / math.pi))
            for s in ordered
        ]
        published = _cell(PUBLISHED_TAU_W_RMSE_N_m, 1e3), _cell(PUBLISHED_THETA_J_RMSE_RAD, 180 / math.pi)
        rows.append(("published network, random split", "motor side", CLOSING, *published))
        return Table(headers, tuple(rows))


def write_report(report: InstrumentReport, out: Path) -> tuple[Path, Path]:
    """Write `instrument.json` (all but the traces) and `instrument_runs.csv` (a line per run, source, method, part)."""
    out.mkdir(parents=True, exist_ok=True)
    summary, runs = out / "instrument.json", out / "instrument_runs.csv"
    content = {
        "schema": 1,
        "name": report.name,
        "assumed": report.assumed,
        "fitted": report.fitted._asdict(),
        "published": {"tau_w_rmse_N_m": PUBLISHED_TAU_W_RMSE_N_m, "theta_j_rmse_rad": PUBLISHED_THETA_J_RMSE_RAD},
        "overall": [score._asdict() for score in report.overall],
        "runs": [run._asdict() for run in report.runs],
    }
    summary.write_text(json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    known = {run.name: run for run in report.runs}
    with runs.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*Score._fields, "frequency_Hz", "load_N_m"])
        for score in report.per_run:
            run = known[score.run]
            writer.writerow([*score, run.frequency_Hz, run.load_N_m])
    return summary, runs


def _cell(value: float | None, scale: float) -> str:
    return "not finite" if value is None else f"{value * scale:.2f}"
