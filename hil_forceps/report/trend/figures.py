"""One figure for each instrument: its parameters with intervals over days; onsets of changes are marked."""

from datetime import datetime

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, DateFormatter, date2num
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hil_forceps.diagnosis.result import TWO_SIDED_95
from hil_forceps.drift.result import InstrumentTrend, ParameterTrend
from hil_forceps.drift.words import name_of
from hil_forceps.report.style import DOUBLE_COLUMN, INK, LOOKS, TRUTH, house_style, new_figure
from hil_forceps.rig.units import show_unit

COLUMNS = 2
ROW_MM = 38.0
LEVEL, ONSET = LOOKS["improved"].color, LOOKS["previous"].color
MOST_BARS = 200  # of errors; more points are drawn without


def days_of(dates: list[str]) -> NDArray[np.float64]:
    """Return dates in matplotlib's days."""
    return np.array([_day(date) for date in dates], dtype=np.float64)


def _day(date: str) -> float:
    return float(date2num(datetime.fromisoformat(date)))  # type: ignore[no-untyped-call]


def instrument_figure(instrument: InstrumentTrend) -> Figure | None:
    """Return the figure of an instrument; None if no parameter was measured."""
    shown = instrument.parameters
    if not shown:
        return None
    rows = -(-len(shown) // COLUMNS)
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, ROW_MM * rows)
        grid = figure.subplots(rows, COLUMNS, squeeze=False)
        for axes, parameter in zip(grid.flat, shown, strict=False):
            _panel(axes, parameter)
        for axes in grid.flat[len(shown) :]:
            axes.set_visible(False)
    return figure


def _panel(axes: Axes, p: ParameterTrend) -> None:
    days = days_of([each.date for each in p.sessions])
    around = p.level if np.all(np.isfinite(p.level)) else p.values
    unit = _scale(around)
    bars = TWO_SIDED_95 * p.deviations / unit if len(days) <= MOST_BARS else None
    axes.errorbar(
        days, p.values / unit, bars, fmt="o", ms=1.8, mew=0, color=INK, ecolor=TRUTH, elinewidth=0.5, zorder=2
    )
    axes.fill_between(
        days,
        (p.level - TWO_SIDED_95 * p.level_sd) / unit,
        (p.level + TWO_SIDED_95 * p.level_sd) / unit,
        color=LEVEL,
        alpha=0.2,
        linewidth=0,
    )
    axes.plot(days, p.level / unit, color=LEVEL, zorder=3)
    for change in p.changes:
        begun, low, high = days_of([change.onset.date, change.low.date, change.high.date])
        axes.axvspan(low, high, color=ONSET, alpha=0.15, linewidth=0)
        axes.axvline(begun, color=ONSET, linestyle=(0, (3, 1.5)), linewidth=0.9)
    apart = [place for place, each in enumerate(p.sessions) if each.session in p.apart]
    axes.plot(days[apart], p.values[apart] / unit, "x", color=ONSET, ms=4, zorder=4)
    exponent = round(np.log10(unit))
    factor = f"$10^{{{exponent}}}$ " if exponent else ""
    axes.set_ylabel(f"{factor}{show_unit(p.unit)}")
    axes.set_title(f"{name_of(p.name)}: {p.verdict}", loc="left")
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.xaxis.set_major_locator(AutoDateLocator(minticks=3, maxticks=5))  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_formatter(DateFormatter("%Y-%m-%d"))  # type: ignore[no-untyped-call]


def _scale(values: NDArray[np.float64]) -> float:
    """Return the power of a thousand for the axis of the values."""
    largest = float(np.max(np.abs(values)))
    return float(1000.0 ** np.floor(np.log10(largest) / 3.0)) if largest > 0.0 else 1.0
