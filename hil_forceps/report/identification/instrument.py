"""Figures of measured instrument runs: measured at the jaw, and estimated from the motor side."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil_forceps.identification.instrument.report import (
    WHOLE,
    InstrumentReport,
    RunInfo,
    SAME_FREQUENCY_Hz,
    Score,
    Trace,
)
from hil_forceps.report.bench.simulation import MILLI
from hil_forceps.report.save import save_figure
from hil_forceps.report.style import (
    DOUBLE_COLUMN,
    INK,
    TRUTH,
    Look,
    house_style,
    look,
    new_figure,
    panel_letter,
    thinned,
)
from hil_forceps.report.traces import Array

METHODS = ("rigid", "improved", "kalman")
DEGREES = 180 / np.pi

_RIGID = Look("rigid wire, no friction", INK, (0, (1.2, 1.2)), "x")
_DRIVEN_BY = {"tau_m_N_m": "spindle torque", "current_A": "motor current"}


class _Map(NamedTuple):
    """RMSE by load rank (rows, lowest first) and frequency (columns); NaN without a finite value."""

    frequencies_Hz: list[float]
    loads_N_m: list[float]
    cells: Array


def write_instrument_figures(report: InstrumentReport, out: Path) -> list[Path]:
    """Draw all figures of a replay into `out` as PDF and PNG; return the files. OSError if writing fails."""
    source = report.traces[0].source
    figures = {
        "instrument_traces": traces_figure(report.traces),
        "instrument_loops": loops_figure(report.traces),
        "instrument_map_torque": map_figure(report, source, "torque"),
        "instrument_map_angle": map_figure(report, source, "angle"),
    }
    return [path for name, figure in figures.items() for path in save_figure(figure, out, name)]


def traces_figure(traces: Sequence[Trace], methods: Sequence[str] = METHODS) -> Figure:
    """Jaw torque above and jaw angle below over time, measured and estimated; one column per run."""
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 96)
        grid = figure.subplots(2, len(traces), sharex=True, sharey="row", squeeze=False)
        for trace, torque, angle, letter in zip(traces, grid[0], grid[1], "abcdefgh", strict=False):
            time_s = trace.time_s
            torque.plot(*thinned(time_s, trace.tau_w_measured_N_m * MILLI), color=TRUTH, lw=2.4, label="measured")
            angle.plot(*thinned(time_s, trace.theta_j_measured_rad * DEGREES), color=TRUTH, lw=2.4)
            for method in methods:
                _line(torque, time_s, trace.tau_w_estimated_N_m[method] * MILLI, method)
                _line(angle, time_s, trace.theta_j_estimated_rad[method] * DEGREES, method)
            torque.set_title(_caption(trace.run))
            panel_letter(torque, letter)
            angle.set_xlabel("time (s)")
            angle.set_xlim(float(time_s[0]), float(time_s[-1]))
        grid[0, 0].set_ylabel(r"jaw torque $\tau_w$ (mN m)")
        grid[1, 0].set_ylabel(r"jaw angle $\theta_j$ (deg)")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        title = f"estimates driven by {_DRIVEN_BY.get(traces[0].source, traces[0].source)}"
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), title=title, title_fontsize=7)
    return figure


def loops_figure(traces: Sequence[Trace], method: str = "kalman") -> Figure:
    """Torque over jaw angle, at the spindle and at the jaw; the width of the spindle's loop shows friction."""
    style = _look(method)
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 68)
        panels = figure.subplots(1, len(traces), sharex=True, sharey=True, squeeze=False)[0]
        for trace, axes, letter in zip(traces, panels, "abcdefgh", strict=False):
            angle = trace.theta_j_measured_rad * DEGREES
            axes.plot(angle, trace.tau_m_N_m * MILLI, color=TRUTH, lw=0.6, label="into the spindle")
            estimate = trace.tau_w_estimated_N_m[method] * MILLI
            if np.all(np.isfinite(estimate)):
                estimated_angle = trace.theta_j_estimated_rad[method] * DEGREES
                label = f"at the jaw, estimated ({style.label})"
                axes.plot(estimated_angle, estimate, color=style.color, lw=0.5, label=label)
            axes.plot(angle, trace.tau_w_measured_N_m * MILLI, color=INK, lw=0.9, label="at the jaw, measured")
            axes.set_title(_caption(trace.run))
            axes.set_xlabel("jaw angle (deg)")
            panel_letter(axes, letter)
        panels[0].set_ylabel("torque (mN m)")
        handles, labels = panels[0].get_legend_handles_labels()
        for line in figure.legend(handles, labels, loc="outside upper center", ncols=len(labels)).get_lines():
            line.set_linewidth(1.6)
    return figure


def map_figure(report: InstrumentReport, source: str, quantity: str, methods: Sequence[str] = METHODS) -> Figure:
    """RMSE of "torque" or "angle" of every run over frequency and load, whole motion; one panel per method."""
    scale, label = (
        (MILLI, r"RMSE of $\tau_w$ (mN m)") if quantity == "torque" else (DEGREES, r"RMSE of $\theta_j$ (deg)")
    )
    maps = [_map(report, [s for s in report.per_run if s[1:4] == (source, m, WHOLE)], quantity, scale) for m in methods]
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 30 + 4.5 * len(maps[0].loads_N_m))
        panels = figure.subplots(1, len(methods), sharex=True, sharey=True, squeeze=False)[0]
        finite = np.concatenate([content.cells[np.isfinite(content.cells)] for content in maps])
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
        for axes, method, content, letter in zip(panels, methods, maps, "abcdefgh", strict=False):
            mesh = axes.imshow(content.cells, cmap="cividis", vmin=low, vmax=high, origin="lower", aspect="auto")
            _numbers(axes, content.cells, (low + high) / 2)
            axes.set_title(_look(method).label)
            axes.grid(visible=False)
            axes.set_xticks(range(len(content.frequencies_Hz)), [f"{f:.1f}" for f in content.frequencies_Hz])
            axes.set_yticks(range(len(content.loads_N_m)), [f"{load * MILLI:.0f}" for load in content.loads_N_m])
            axes.set_xlabel("frequency (Hz)")
            panel_letter(axes, letter)
        panels[0].set_ylabel("mean jaw torque (mN m)")
        figure.colorbar(mesh, ax=list(panels), label=label, pad=0.01)
    return figure


def _map(report: InstrumentReport, scores: Sequence[Score], quantity: str, scale: float) -> _Map:
    columns: list[list[RunInfo]] = []
    for run in sorted(report.runs, key=lambda run: run.frequency_Hz):
        if columns and run.frequency_Hz - columns[-1][0].frequency_Hz < SAME_FREQUENCY_Hz:
            columns[-1].append(run)
        else:
            columns.append([run])
    ranked = [sorted(column, key=lambda run: run.load_N_m) for column in columns]
    ranks = range(max(len(column) for column in ranked))
    rmse = {s.run: s.tau_w_rmse_N_m if quantity == "torque" else s.theta_j_rmse_rad for s in scores}
    cells = np.full((len(ranks), len(ranked)), np.nan)
    for column_index, column in enumerate(ranked):
        for rank, run in enumerate(column):
            value = rmse.get(run.name)
            cells[rank, column_index] = np.nan if value is None else value * scale
    loads = [float(np.mean([column[rank].load_N_m for column in ranked if rank < len(column)])) for rank in ranks]
    return _Map([float(np.mean([run.frequency_Hz for run in column])) for column in ranked], loads, cells)


def _numbers(axes: Axes, cells: Array, middle: float) -> None:
    for (row, column), value in np.ndenumerate(cells):
        text = f"{value:.3g}" if np.isfinite(value) else "n. f."
        color = "white" if value < middle else INK
        axes.text(column, row, text, ha="center", va="center", fontsize=5.5, color=color)


def _line(axes: Axes, time_s: Array, values: Array, method: str) -> None:
    style = _look(method)
    if np.all(np.isfinite(values)):
        axes.plot(*thinned(time_s, values), color=style.color, ls=style.dash, lw=0.7, label=style.label)
    else:
        axes.plot([], [], color=style.color, ls=style.dash, label=f"{style.label} (not finite)")


def _look(method: str) -> Look:
    return _RIGID if method == "rigid" else look(method)


def _caption(run: RunInfo) -> str:
    return f"run {run.name}: {run.frequency_Hz:.1f} Hz, load {run.load_N_m * MILLI:.0f} mN m"
