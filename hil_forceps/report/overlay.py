"""Figure of a simulation and a run: each channel measured and simulated, with its error."""

from collections.abc import Mapping
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil_forceps.report.style import (
    DOUBLE_COLUMN,
    REFERENCE,
    TRUTH,
    house_style,
    legend_above,
    new_figure,
    panel_letter,
    peak_limits,
    thinned,
)
from hil_forceps.report.traces import Array

SIMULATED = "#0072b2"
_PANEL_MM = 34.0


class Shown(NamedTuple):
    """Label of a column."""

    symbol: str
    unit: str
    scale: float  # from SI
    error_unit: str
    error_scale: float


SHOWN = {
    "theta_m_rad": Shown(r"\theta_m", "rad", 1.0, "mrad", 1e3),
    "current_A": Shown("i", "A", 1.0, "mA", 1e3),
    "tau_m_N_m": Shown(r"\tau_m", "mN m", 1e3, "mN m", 1e3),
    "theta_j_rad": Shown(r"\theta_j", "rad", 1.0, "mrad", 1e3),
    "tau_w_N_m": Shown(r"\tau_w", "mN m", 1e3, "mN m", 1e3),
}


def beside_figure(time_s: Array, measured: Mapping[str, Array], simulated: Mapping[str, Array]) -> Figure:
    """Draw one row for each channel: both curves on the left, simulated less measured on the right."""
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 14.0 + _PANEL_MM * len(measured))
        grid = figure.subplots(len(measured), 2, sharex=True, squeeze=False, width_ratios=(3, 2))
        for row, (name, letter) in enumerate(zip(measured, "abcdefgh", strict=False)):
            _draw(grid[row, 0], grid[row, 1], SHOWN[name], (time_s, measured[name], simulated[name]))
            panel_letter(grid[row, 0], letter)
        for axes in grid[-1]:
            axes.set_xlabel("time (s)")
            axes.set_xlim(float(time_s[0]), float(time_s[-1]))
        legend_above(figure, grid[0, 0], columns=2)
    return figure


def _draw(curves: Axes, error: Axes, shown: Shown, data: tuple[Array, Array, Array]) -> None:
    time_s, measured, simulated = data
    curves.plot(*thinned(time_s, measured * shown.scale), color=TRUTH, lw=2.0, label="measured")
    curves.plot(*thinned(time_s, simulated * shown.scale), color=SIMULATED, lw=0.8, label="simulated")
    curves.set_ylabel(f"${shown.symbol}$ ({shown.unit})")
    curves.set_ylim(*peak_limits([measured * shown.scale, simulated * shown.scale]))
    difference = (simulated - measured) * shown.error_scale
    error.axhline(0, color=REFERENCE, lw=0.4)
    error.plot(*thinned(time_s, difference), color=SIMULATED, lw=0.6)
    error.set_ylabel(f"error ({shown.error_unit})")
    error.set_ylim(*peak_limits([difference], least=1e-6))
