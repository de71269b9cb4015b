"""Figure of timing: age of the sample when its reference is sent, lateness of ticks, account of all frames."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from hil_forceps.report.style import DOUBLE_COLUMN, INK, PAPER, house_style, new_figure, panel_letter
from hil_forceps.report.traces import Array, TimingTraces

_BINS = 90
_MAX_LABELLED_RATIO = 300.0  # ratio of largest to smallest up to which 1, 2 and 5 of a decade are labelled
_MIN_TAIL_RATIO = (
    8.0  # ratio of largest to median above which bins are logarithmic; else most values would be in one bin
)
_MIN_TIME_S = 1e-7  # s; early and punctual ticks are counted here on a log axis


def timing_figure(traces: TimingTraces) -> Figure:
    """Histograms (log counts) of sample-to-reference age and of lateness, with their marks; frames in the caption."""
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 66)
        age, late = figure.subplots(1, 2, sharey=True)
        highest = max(
            _histogram(age, traces.age_s * 1e3, {k: v * 1e3 for k, v in traces.age_marks_s.items()}, "ms"),
            _histogram(late, traces.lateness_s * 1e6, {k: v * 1e6 for k, v in traces.lateness_marks_s.items()}, "µs"),
        )
        age.set_ylim(0.7, 2.0 * max(highest, 1.0))
        age.set_xlabel("age of the sample when its reference is sent (ms)")
        late.set_xlabel("lateness of the tick (µs)")
        age.set_ylabel("count")
        panel_letter(age, "a")
        panel_letter(late, "b")
        total = sum(traces.frames.values())
        account = " + ".join(f"{count:,} {name}" for name, count in traces.frames.items())
        figure.supxlabel(
            f"{traces.label}, tick {traces.period_s * 1e3:g} ms. Frames: {total:,} = {account}.", fontsize=7.5, x=0.5
        )
    return figure


def _histogram(axes: Axes, values: Array, marks: dict[str, float], unit: str) -> float:
    """Draw one histogram and return its highest count."""
    if not values.size:
        axes.text(0.5, 0.5, "none measured", transform=axes.transAxes, ha="center", va="center", bbox=PAPER)
        return 0.0
    low, high = float(values.min()), float(values.max())
    tailed = high > _MIN_TAIL_RATIO * float(np.median(values)) or low <= 0
    if tailed:
        floor = max(low, _MIN_TIME_S * (1e3 if unit == "ms" else 1e6))
        edges = np.geomspace(floor, max(high, 2 * floor) * 1.001, _BINS)
        axes.set_xscale("log")
        few = edges[-1] < _MAX_LABELLED_RATIO * edges[0]
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    else:
        edges = np.linspace(low - 0.02 * (high - low) - 1e-9, high + 0.02 * (high - low) + 1e-9, _BINS)
    shown = np.clip(values, edges[0], edges[-1])
    counts, _, _ = axes.hist(shown, bins=edges.tolist(), color="#56b4e9", edgecolor="#0072b2", lw=0.3)
    axes.set_yscale("log")
    dashes = ("-", (0, (4, 1.2)), (0, (1.2, 1.2)), (0, (6, 1.2, 1, 1.2)))
    for index, (name, value) in enumerate(marks.items()):
        label = f"{name} {_short(value)} {unit}"
        axes.axvline(value, color=INK, lw=0.8, ls=dashes[index % len(dashes)], label=label)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.14), ncols=len(marks), handlelength=1.8)
    return float(np.max(counts))


def _short(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"
