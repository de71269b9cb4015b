"""Figure of the last second of a run: angles, current, verdict on each reference, lateness of the loop."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil_forceps.report.style import DOUBLE_COLUMN, LOOKS, REFERENCE, TRUTH, house_style, new_figure, panel_letter
from hil_forceps.report.traces import Array

MEASURED, CURRENT, LATE = LOOKS["improved"].color, LOOKS["previous"].color, LOOKS["kalman"].color
LABELS = (r"$\theta_m$ (rad)", "current (mA)", "reference", "tick late (µs)")
MOMENT_S = 0.05


class FaultTraces(NamedTuple):
    """Series over times in s before the end, which is 0."""

    sample_s: Array
    theta_m_rad: Array
    current_A: Array
    tick_s: Array
    requested_rad: Array
    passed_rad: Array  # NaN where nothing passed
    verdict: Array  # row of `verdict_names`
    verdict_names: tuple[str, ...]
    late_s: Array  # times of ticks
    lateness_us: Array


def fault_figure(traces: FaultTraces, title: str) -> Figure:
    """Draw the series over one time axis, with a detail of the last samples."""
    has_lateness = traces.late_s.size > 0
    ratios = [3.0, 2.0, 0.6 + 0.35 * max(len(traces.verdict_names), 1), *([1.2] if has_lateness else [])]
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 95 + (22 if has_lateness else 0))
        grid = figure.subplots(
            len(ratios), 2, sharex="col", sharey="row", height_ratios=ratios, width_ratios=(5, 3), squeeze=False
        )
        figure.suptitle(title, fontsize=8.0)
        for column, window_s in enumerate((_span(traces), _last_moment(traces))):
            for axes, draw in zip(grid[:, column], (_angles, _current, _verdicts, _lateness), strict=False):
                draw(axes, traces)
                axes.axvline(0.0, color=REFERENCE, lw=0.7, ls=(0, (4, 2)))
                axes.set_xlim(*window_s)
            grid[-1, column].set_xlabel("time from the end (s)")
            grid[-1, column].locator_params(axis="x", nbins=6 if column == 0 else 4)
        for axes, letter, label in zip(grid[:, 0], "abcd", LABELS, strict=False):
            panel_letter(axes, letter)
            axes.set_ylabel(label)
        grid[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
        figure.align_ylabels(grid[:, 0])
    return figure


def _angles(axes: Axes, traces: FaultTraces) -> None:
    axes.plot(traces.sample_s, traces.theta_m_rad, color=TRUTH, lw=2.4, label="measured")
    axes.plot(traces.tick_s, traces.requested_rad, color=CURRENT, ls=(0, (1.2, 1.2)), label="asked of the gate")
    axes.plot(traces.tick_s, traces.passed_rad, color=MEASURED, label="passed")


def _current(axes: Axes, traces: FaultTraces) -> None:
    axes.plot(traces.sample_s, traces.current_A * 1e3, color=CURRENT)


def _lateness(axes: Axes, traces: FaultTraces) -> None:
    axes.plot(traces.late_s, traces.lateness_us, color=LATE, drawstyle="steps-post")
    axes.set_ylim(bottom=0.0, top=max(1.0, 1.1 * float(traces.lateness_us.max())))


def _verdicts(axes: Axes, traces: FaultTraces) -> None:
    axes.scatter(traces.tick_s, traces.verdict, s=3.0, marker="|", linewidths=0.6, color=MEASURED)
    axes.set_yticks(range(len(traces.verdict_names)), [name.lower().replace("_", " ") for name in traces.verdict_names])
    axes.set_ylim(max(len(traces.verdict_names), 1) - 0.4, -0.6)


def _span(traces: FaultTraces) -> tuple[float, float]:
    times = np.concatenate([traces.sample_s, traces.tick_s, traces.late_s, np.zeros(1)])
    first, last = float(times.min()), float(times.max())
    return first, last + 0.02 * (last - first) if last > first else first + 1.0


def _last_moment(traces: FaultTraces) -> tuple[float, float]:
    before = traces.sample_s[traces.sample_s <= 0.0]
    centre_s = float(before[-1]) if before.size else 0.0
    return centre_s - MOMENT_S, centre_s + 0.4 * MOMENT_S
