"""The style of all figures: sizes for print, fonts, and one look for each algorithm."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil_forceps.report.traces import Array

MM = 1 / 25.4
SINGLE_COLUMN = 85 * MM  # inches, as matplotlib counts
DOUBLE_COLUMN = 175 * MM

INK = "#222222"
TRUTH = "#9a9a9a"  # drawn wide and in the background
REFERENCE = "#000000"
PAPER: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}  # behind text that crosses lines

# All fonts are part of matplotlib, so that a figure has the same bytes on every computer.
RC: dict[Any, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "axes.linewidth": 0.5,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.5,
    "ytick.major.width": 0.5,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.minor.size": 1.5,
    "ytick.minor.size": 1.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.4,
    "axes.axisbelow": True,
    "lines.linewidth": 0.9,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "legend.borderaxespad": 0.2,
    "legend.columnspacing": 1.2,
    "figure.dpi": 100,
    "savefig.dpi": 200,
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
    "pdf.fonttype": 42,  # editable text; journals refuse fonts of Type 3
    "axes.unicode_minus": True,
}


class Look(NamedTuple):
    """Look of an algorithm: colours that colour-blind readers can distinguish; line and marker for prints in grey."""

    label: str
    color: str
    dash: Any  # matplotlib's linestyle
    marker: str


# Colours of Okabe and Ito, in an order in which their lightness differs, too.
LOOKS = {
    "previous": Look("previous", "#d55e00", (0, (4, 1.2)), "s"),
    "improved_as_published": Look("improved, as published", "#cc79a7", (0, (1, 1)), "^"),
    "improved": Look("improved", "#0072b2", "-", "o"),
    "kalman": Look("Kalman", "#117733", (0, (6, 1.2, 1, 1.2)), "D"),
}
UNCOMPENSATED = Look("not compensated", "#222222", (0, (1.2, 1.2)), "x")
_SPARE = Look("", "#56565b", (0, (2, 1)), "v")


def look(algorithm: str) -> Look:
    """Return the look of an algorithm; an unknown algorithm gets grey dashes and its id."""
    return LOOKS.get(algorithm) or _SPARE._replace(label=algorithm.replace("_", " "))


@contextmanager
def house_style() -> Iterator[None]:
    """Apply the style within the block; matplotlib's settings are restored afterwards."""
    with mpl.rc_context():
        mpl.rcdefaults()  # a user's matplotlibrc must not change the figures
        mpl.rcParams.update(RC)
        yield


def new_figure(width_in: float, height_mm: float) -> Figure:
    """Return an empty figure with automatic layout, without pyplot."""
    return Figure(figsize=(width_in, height_mm * MM), layout="constrained")


def panel_letter(axes: Axes, letter: str) -> None:
    """Put (a), (b) ... above the left edge of a panel."""
    axes.annotate(
        f"({letter})", (0, 1), (-2, 3), xycoords="axes fraction", textcoords="offset points", ha="right", va="bottom"
    )


def legend_above(figure: Figure, axes: Axes, columns: int) -> None:
    """Put the legend of `axes` above all panels."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns)


def thinned(time: Array, values: Array, bins: int = 1500) -> tuple[Array, Array]:
    """Keep the samples with minimum and maximum in each time bin, for small files of the same look."""
    if len(time) <= 4 * bins:
        return time, values
    width = -(-len(time) // bins)
    padded = np.full(-(-len(time) // width) * width, np.nan)
    padded[: len(values)] = values
    table = padded.reshape(-1, width)
    first = np.arange(len(table)) * width
    lowest = first + np.argmin(np.where(np.isfinite(table), table, np.inf), axis=1)
    highest = first + np.argmax(np.where(np.isfinite(table), table, -np.inf), axis=1)
    gaps = np.flatnonzero(~np.isfinite(values))
    rows = np.unique(np.concatenate([lowest, highest, gaps, [0, len(time) - 1]]))
    return time[rows], values[rows]


def peak_limits(parts: list[Array], margin: float = 0.08, least: float = 0.0) -> tuple[float, float]:
    """Return limits around all finite values with a margin; at least `least` apart."""
    finite = [part[np.isfinite(part)] for part in parts]
    values = np.concatenate([*finite, np.zeros(1)])
    low, high = float(values.min()), float(values.max())
    spare = max(least - (high - low), 0.0) / 2 + margin * max(high - low, least)
    return low - spare, high + spare
