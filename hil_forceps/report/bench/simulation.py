"""Figures of one simulation in the manner of the paper's Figs. 4-7: torque, jaw angle, elongation, one pulse edge."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil_forceps.report.style import (
    DOUBLE_COLUMN,
    PAPER,
    REFERENCE,
    SINGLE_COLUMN,
    TRUTH,
    UNCOMPENSATED,
    house_style,
    legend_above,
    look,
    new_figure,
    panel_letter,
    peak_limits,
    thinned,
)
from hil_forceps.report.traces import Array, RunTraces

BEFORE_LOAD_S = 9.0  # the paper's figures and the bench's RMSE begin shortly before the load
MILLI, MICRO = 1e3, 1e6


class _Quantity(NamedTuple):
    """One estimated quantity: its place in the traces and its label."""

    true: Callable[[RunTraces], Array]
    estimated: Callable[[RunTraces], Array]
    scale: float
    symbol: str
    unit: str
    truth_label: str


_TORQUE = _Quantity(lambda r: r.tau_w_true, lambda r: r.tau_w_est, MILLI, r"\tau_w", "mN m", "added")
_ELONGATION = _Quantity(lambda r: r.x_true, lambda r: r.x_est, MICRO, "x", "µm", "true")


def torque_figure(runs: Sequence[RunTraces], start_s: float = BEFORE_LOAD_S) -> Figure:
    """Reaction torque added and estimated above, the error below; one column per run (one per algorithm)."""
    return _estimate_figure(runs, _TORQUE, start_s)


def elongation_figure(runs: Sequence[RunTraces], start_s: float = BEFORE_LOAD_S) -> Figure:
    """Elongation of the wire, true and estimated above, the error below; one column per run."""
    return _estimate_figure(runs, _ELONGATION, start_s)


def jaw_figure(
    uncompensated: RunTraces,
    compensated: Sequence[RunTraces],
    start_s: float = BEFORE_LOAD_S,
    error_limit_deg: float = 3.0,
) -> Figure:
    """Jaw angle against its reference, without and with compensation, and the error below; angles in degrees.

    The error axis ends at `error_limit_deg`, so that the peak at each load step does not hide the steady part.
    """
    with house_style():
        figure = new_figure(SINGLE_COLUMN, 90)
        angle, error = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        cut = uncompensated.time_s >= start_s
        reference = np.degrees(uncompensated.theta_j_ref[cut])
        angle.plot(uncompensated.time_s[cut], reference, color=TRUTH, lw=2.4, label="reference")
        for run, style in [(uncompensated, UNCOMPENSATED), *((run, look(run.algorithm)) for run in compensated)]:
            label = style.label if run is uncompensated else f"compensated, {style.label}"
            rows = run.time_s >= start_s
            degrees = np.degrees(run.theta_j_true[rows])
            deviation = degrees - np.degrees(run.theta_j_ref[rows])
            angle.plot(*thinned(run.time_s[rows], degrees), color=style.color, ls=style.dash, label=label)
            error.plot(*thinned(run.time_s[rows], deviation), color=style.color, ls=style.dash)
        angle.set_ylabel(r"jaw angle $\theta_j$ (deg)")
        error.set_ylabel("error (deg)")
        error.set_ylim(-error_limit_deg, error_limit_deg)
        error.set_xlabel("time (s)")
        error.set_xlim(start_s, float(uncompensated.time_s[-1]))
        legend_above(figure, angle, columns=2)
    return figure


def edge_figure(runs: Sequence[RunTraces], edge_s: float, before_s: float = 0.02, after_s: float = 0.06) -> Figure:
    """The estimates around one edge of the load pulse, where the previous algorithm spikes."""
    with house_style():
        figure = new_figure(SINGLE_COLUMN, 68)
        axes = figure.subplots()
        shown = []
        for position, run in enumerate(runs):
            rows = (run.time_s >= edge_s - before_s) & (run.time_s <= edge_s + after_s)
            time_ms = (run.time_s[rows] - edge_s) * MILLI
            if position == 0:
                axes.step(time_ms, run.tau_w_true[rows] * MILLI, where="post", color=TRUTH, lw=2.4, label="added")
            estimate = run.tau_w_est[rows] * MILLI
            style = look(run.algorithm)
            if not np.all(np.isfinite(estimate)):
                axes.plot([], [], color=style.color, ls=style.dash, label=f"{style.label} (not finite)")
                continue
            shown.append(estimate)
            axes.plot(time_ms, estimate, color=style.color, ls=style.dash, label=style.label)
        axes.set_xlim(-before_s * MILLI, after_s * MILLI)
        axes.set_ylim(*peak_limits([*shown, runs[0].tau_w_true * MILLI]))
        axes.set_xlabel(f"time from the edge at {edge_s:g} s (ms)")
        axes.set_ylabel(r"reaction torque $\tau_w$ (mN m)")
        legend_above(figure, axes, columns=2)
    return figure


def _estimate_figure(runs: Sequence[RunTraces], quantity: _Quantity, start_s: float) -> Figure:
    with house_style():
        width = DOUBLE_COLUMN if len(runs) > 1 else SINGLE_COLUMN
        figure = new_figure(width, 78)
        grid = figure.subplots(2, len(runs), sharex=True, sharey="row", squeeze=False, height_ratios=(3, 2))
        errors: list[Array] = []
        shown: list[Array] = []
        for run, upper, lower, letter in zip(runs, grid[0], grid[1], "abcdefgh", strict=False):
            rows = run.time_s >= start_s
            time_s = run.time_s[rows]
            true = quantity.true(run)[rows] * quantity.scale
            estimated = quantity.estimated(run)[rows] * quantity.scale
            _draw_pair(upper, lower, run, quantity, time_s, true, estimated)
            upper.set_title(look(run.algorithm).label)
            panel_letter(upper, letter)
            shown += [true, estimated]
            errors.append(estimated - true)
            lower.set_xlabel("time (s)")
            lower.set_xlim(start_s, float(time_s[-1]))
        grid[0, 0].set_ylabel(f"${quantity.symbol}$ ({quantity.unit})")
        grid[1, 0].set_ylabel(f"error ({quantity.unit})")
        grid[0, 0].set_ylim(*peak_limits(shown))
        grid[1, 0].set_ylim(*peak_limits(errors, least=1e-3))
    return figure


def _draw_pair(
    upper: Axes, lower: Axes, run: RunTraces, quantity: _Quantity, time_s: Array, true: Array, estimated: Array
) -> None:
    style = look(run.algorithm)
    lower.axhline(0, color=REFERENCE, lw=0.4)
    upper.plot(*thinned(time_s, true), color=TRUTH, lw=2.4, label=quantity.truth_label)
    if np.all(np.isfinite(estimated)):
        error = estimated - true
        upper.plot(*thinned(time_s, estimated), color=style.color, lw=0.8, label="estimated")
        lower.plot(*thinned(time_s, error), color=style.color, lw=0.8)
        lower.set_title(f"peak {np.max(np.abs(error)):.3g} {quantity.unit}", loc="right", fontsize=7, pad=2)
    else:
        text = f"not finite from {_first_bad_s(run, quantity):.3g} s on"
        lower.text(0.5, 0.5, text, transform=lower.transAxes, ha="center", va="center", bbox=PAPER)


def _first_bad_s(run: RunTraces, quantity: _Quantity) -> float:
    return float(run.time_s[np.flatnonzero(~np.isfinite(quantity.estimated(run)))[0]])
