"""Figures of the comparison on runs held out: estimated and measured, and errors of every method."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from hil_forceps.identification.instrument.comparison import EXTENDED, PUBLISHED_PROTOCOL, Comparison, Course
from hil_forceps.identification.instrument.held_out_errors import HeldOut
from hil_forceps.identification.instrument.report import CLOSING, WHOLE
from hil_forceps.report.bench.simulation import MILLI
from hil_forceps.report.save import save_figure
from hil_forceps.report.style import DOUBLE_COLUMN, INK, TRUTH, house_style, look, new_figure, panel_letter, thinned

DEGREES = 180 / np.pi
_OURS = "#117733"
_SOURCES = {"tau_m_N_m": "spindle torque", "current_A": "motor current"}


def write_comparison_figures(comparison: Comparison, out: Path) -> list[Path]:
    """Draw the first split's runs and every split's errors into `out` as PDF and PNG; nothing without splits."""
    if not comparison.splits:
        return []
    first = comparison.splits[0].name
    courses = [course for course in comparison.courses if course.split == first]
    figures = {"instrument_held_out": held_out_figure(courses), "instrument_methods": methods_figure(comparison)}
    return [path for name, figure in figures.items() for path in save_figure(figure, out, name)]


def held_out_figure(courses: Sequence[Course]) -> Figure:
    """Jaw torque above and error of the jaw angle below over time, one column per held-out run, a line per source."""
    names = list(dict.fromkeys(course.run.name for course in courses))
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 92)
        grid = figure.subplots(2, len(names), sharex=True, sharey="row", squeeze=False)
        for name, torque, angle, letter in zip(names, grid[0], grid[1], "abcdefgh", strict=False):
            own = [course for course in courses if course.run.name == name]
            measured = own[0]
            time_s = measured.time_s
            torque.plot(*thinned(time_s, measured.tau_w_measured_N_m * MILLI), color=TRUTH, lw=2.4, label="measured")
            for course, style in zip(own, (look("kalman"), look("previous")), strict=False):
                label = f"from {_SOURCES.get(course.source, course.source)}"
                torque.plot(
                    *thinned(time_s, course.estimated.tau_w_N_m * MILLI), color=style.color, lw=0.7, label=label
                )
                wrong = (course.estimated.theta_j_rad - course.theta_j_measured_rad) * DEGREES
                angle.plot(*thinned(time_s, wrong), color=style.color, lw=0.6)
            load, frequency = measured.run.load_N_m * MILLI, measured.run.frequency_Hz
            torque.set_title(f"run {name}: {frequency:.1f} Hz, load {load:.0f} mN m")
            panel_letter(torque, letter)
            angle.set_xlabel("time (s)")
        grid[0, 0].set_ylabel(r"jaw torque $\tau_w$ (mN m)")
        grid[1, 0].set_ylabel(r"error of $\theta_j$ (deg)")
        grid[1, 0].set_ylim(-3, 3)  # the transient of the first stroke is outside and is not scored
        handles, labels = grid[0, 0].get_legend_handles_labels()
        title = "transmission estimator on loads that it was not fitted to"
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), title=title, title_fontsize=7)
    return figure


def methods_figure(comparison: Comparison) -> Figure:
    """RMSE of torque (above) and angle (below) of every method, one column per split, part and source on one axis."""
    splits = [split.name for split in comparison.splits]
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 120)
        grid = figure.subplots(2, len(splits), sharey=True, sharex="row", squeeze=False)
        for name, torque, angle, letter in zip(splits, grid[0], grid[1], "abcdefgh", strict=False):
            scores = [score for score in comparison.overall if score.split == name]
            _points(torque, scores, "torque")
            _points(angle, scores, "angle")
            torque.set_title(f"held out: {name}")
            torque.set_xlabel(r"RMSE of $\tau_w$ (mN m)")
            angle.set_xlabel(r"RMSE of $\theta_j$ (deg)")
            panel_letter(torque, letter)
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def _points(axes: Axes, scores: Sequence[HeldOut], quantity: str) -> None:
    methods = list(dict.fromkeys(score.method for score in scores if score.split != PUBLISHED_PROTOCOL))
    for source, offset, marker in zip(_SOURCES, (-0.17, 0.17), "os", strict=True):
        for part, filled in ((WHOLE, True), (CLOSING, False)):
            own = [score for score in scores if (score.source, score.part) == (source, part)]
            places = [methods.index(score.method) + offset for score in own]
            values = [
                score.tau_w_rmse_N_m * MILLI if quantity == "torque" else score.theta_j_rmse_rad * DEGREES
                for score in own
            ]
            colors = [_OURS if score.method == EXTENDED else INK for score in own]
            faces = colors if filled else ["white"] * len(own)
            label = f"{_SOURCES[source]}, {'whole motion' if part == WHOLE else 'closing strokes'}"
            axes.scatter(values, places, s=16, marker=marker, c=faces, edgecolors=colors, linewidths=0.8, label=label)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_yticks(range(len(methods)), methods)
    axes.set_ylim(len(methods) - 0.5, -0.5)
