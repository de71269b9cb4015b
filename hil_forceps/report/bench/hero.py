"""The figure of the README: load, estimates of each algorithm, effect of the compensation."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil_forceps.report.bench.simulation import BEFORE_LOAD_S, MILLI
from hil_forceps.report.style import (
    DOUBLE_COLUMN,
    TRUTH,
    UNCOMPENSATED,
    Look,
    house_style,
    look,
    new_figure,
    panel_letter,
    peak_limits,
    thinned,
)
from hil_forceps.report.traces import RunTraces


class HeroRuns(NamedTuple):
    """The runs of simulation 2 (load pulses) that the picture needs, all compensated but `uncompensated`."""

    previous: RunTraces
    improved: RunTraces
    kalman: RunTraces
    uncompensated: RunTraces


def hero_figure(runs: HeroRuns, edge_s: float = 12.5) -> Figure:
    """Draw torque over the pulses, torque at one edge, and the jaw's error without and with compensation."""
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 72)
        torque, edge, jaw = figure.subplots(1, 3, width_ratios=(5, 4, 5))
        start_s, end_s = BEFORE_LOAD_S, float(runs.previous.time_s[-1])
        _torque(torque, runs, 0.0, 1.0, (start_s, end_s))
        _torque(edge, runs, edge_s, MILLI, (edge_s - 0.012, edge_s + 0.036))
        _jaw(jaw, runs.uncompensated, UNCOMPENSATED, start_s)
        _jaw(jaw, runs.kalman, look("kalman"), start_s)
        _say_plateau(jaw, runs.uncompensated, edge_s)
        torque.set_title("torque on the jaw, added and estimated")
        edge.set_title(f"the edge at {edge_s:g} s")
        jaw.set_title("error of the jaw angle")
        torque.set_xlabel("time (s)")
        edge.set_xlabel("time from the edge (ms)")
        jaw.set_xlabel("time (s)")
        torque.set_ylabel(r"$\tau_w$ (mN m)")
        jaw.set_ylabel(r"$\theta_j-\theta_j^{\mathrm{ref}}$ (deg)")
        jaw.set_ylim(-3, 3)
        jaw.set_xlim(start_s, end_s)
        for axes, letter in zip((torque, edge, jaw), "abc", strict=True):
            panel_letter(axes, letter)
        handles, labels = torque.get_legend_handles_labels()
        extra, words = jaw.get_legend_handles_labels()
        figure.legend([*handles, *extra], [*labels, *words], loc="outside lower center", ncols=6, columnspacing=1.0)
    return figure


def _torque(axes: Axes, runs: HeroRuns, zero_s: float, scale: float, window_s: tuple[float, float]) -> None:
    shown = []
    for index, run in enumerate((runs.previous, runs.improved, runs.kalman)):
        rows = (run.time_s >= window_s[0]) & (run.time_s <= window_s[1])
        time = (run.time_s[rows] - zero_s) * scale
        if index == 0:
            axes.step(time, run.tau_w_true[rows] * MILLI, where="post", color=TRUTH, lw=2.4, label="added")
        style = look(run.algorithm)
        estimate = run.tau_w_est[rows] * MILLI
        axes.plot(*thinned(time, estimate), color=style.color, ls=style.dash, label=f"{style.label} estimate")
        shown.append(estimate)
    axes.set_xlim((window_s[0] - zero_s) * scale, (window_s[1] - zero_s) * scale)
    axes.set_ylim(*peak_limits(shown))


def _jaw(axes: Axes, run: RunTraces, style: Look, start_s: float) -> None:
    rows = run.time_s >= start_s
    error = np.degrees(run.theta_j_true[rows] - run.theta_j_ref[rows])
    label = style.label if style is UNCOMPENSATED else f"compensated ({style.label})"
    axes.plot(*thinned(run.time_s[rows], error), color=style.color, ls=style.dash, label=label)


def _say_plateau(axes: Axes, run: RunTraces, edge_s: float) -> None:
    before = int(np.searchsorted(run.time_s, edge_s)) - 2
    error = float(np.degrees(run.theta_j_true[before] - run.theta_j_ref[before]))
    axes.annotate(
        f"{error:.2f}°".replace("-", "−"),
        (edge_s - 1.0, error),
        (0, 3),
        textcoords="offset points",
        ha="center",
        va="bottom",
        color=UNCOMPENSATED.color,
        fontsize=7,
    )
