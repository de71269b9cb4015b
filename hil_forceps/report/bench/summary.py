"""RMSE of every algorithm at every sample time, on one log scale."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil_forceps.report.style import (
    DOUBLE_COLUMN,
    INK,
    PAPER,
    SINGLE_COLUMN,
    house_style,
    look,
    new_figure,
    panel_letter,
)
from hil_forceps.report.traces import SummaryPoint

_MARKERS = ("o", "D", "s", "^", "v")


def rmse_figure(points: Sequence[SummaryPoint]) -> Figure:
    """Dots of RMSE [mN m], one row per algorithm, one panel per simulation, a marker per sample time.

    A run that was not finite has no dot, but a text in its row.
    """
    simulations = sorted({point.simulation for point in points})
    algorithms = list(dict.fromkeys(point.algorithm for point in points))
    times = sorted({point.sample_time_s for point in points}, reverse=True)
    with house_style():
        width = DOUBLE_COLUMN if len(simulations) > 1 else SINGLE_COLUMN
        figure = new_figure(width, 24 + 8 * len(algorithms))
        panels = figure.subplots(1, len(simulations), sharex=True, sharey=True, squeeze=False)[0]
        for axes, simulation, letter in zip(panels, simulations, "abcdefgh", strict=False):
            here = [point for point in points if point.simulation == simulation]
            for row, algorithm in enumerate(algorithms):
                _draw_row(axes, row, [point for point in here if point.algorithm == algorithm], times)
            axes.set_title(f"simulation {simulation}")
            axes.set_xlabel(r"RMSE of $\hat\tau_w$ (mN m)")
            panel_letter(axes, letter)
        panels[0].set_xscale("log")
        panels[0].set_yticks(range(len(algorithms)), [look(algorithm).label for algorithm in algorithms])
        panels[0].set_ylim(len(algorithms) - 0.5, -0.5)
        handles = [
            panels[0].plot([], [], _MARKERS[i % len(_MARKERS)], color=INK, mfc=_fill(i, INK), ms=4)[0]
            for i in range(len(times))
        ]
        labels = [f"sample time {time * 1e3:g} ms" for time in times]
        figure.legend(handles, labels, loc="outside upper center", ncols=len(times))
    return figure


def _draw_row(axes: Axes, row: int, points: Sequence[SummaryPoint], times: Sequence[float]) -> None:
    finite = [(point.tau_w_rmse_N_m * 1e3, point.sample_time_s) for point in points if point.tau_w_rmse_N_m is not None]
    broken = [point.sample_time_s for point in points if point.tau_w_rmse_N_m is None]
    if finite:
        color = look(points[0].algorithm).color
        axes.plot([rmse for rmse, _ in finite], [row] * len(finite), color=color, lw=0.6)
        for rmse, time in finite:
            index = list(times).index(time)
            axes.plot(rmse, row, _MARKERS[index % len(_MARKERS)], color=color, mfc=_fill(index, color), ms=4.5)
    if broken:
        which = ", ".join(f"{time * 1e3:g}" for time in sorted(set(broken), reverse=True))
        axes.annotate(
            f"not finite at {which} ms",
            (0.98, row),
            xycoords=("axes fraction", "data"),
            ha="right",
            va="center",
            fontsize=7,
            bbox=PAPER,
        )


def _fill(index: int, color: str) -> str:
    return color if index % 2 == 0 else "white"
