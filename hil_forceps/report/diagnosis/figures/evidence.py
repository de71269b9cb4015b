"""Figures of the evidence: balances, candidates, parameter shifts, gain on runs held out."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from hil_forceps.diagnosis.result import Candidate, Diagnosis, Gain
from hil_forceps.report.diagnosis.figures.layout import LETTERS, legend, letters, panels
from hil_forceps.report.diagnosis.figures.view import BASELINE, EXTENDED, FLOOR
from hil_forceps.report.diagnosis.ladder import label, noise_floor
from hil_forceps.report.diagnosis.names import parameter_words, quantity, scale_for
from hil_forceps.report.style import (
    DOUBLE_COLUMN,
    INK,
    PAPER,
    REFERENCE,
    SINGLE_COLUMN,
    house_style,
    new_figure,
    panel_letter,
)

LOCATIONS = ("motor", "wire", "jaw", "sensor", "timing")
MAX_CANDIDATES = 12
STATE_COLORS = {
    "named": "#0072b2",
    "tied": "#56b4e9",
    "weaker": "#e69f00",
    "at a bound": "#8a5a00",
    "below threshold": "#c8c8c8",
    "not excited": "#ececec",
}
ROW_MM = 4.2
RUNG_MM = 6.0
LABELS_MM = 36.0  # room for the longest id


def balances_figure(diagnosis: Diagnosis) -> Figure:
    """Lack of fit at each balance, relative to chance, before and after."""
    order = {name: place for place, name in enumerate(LOCATIONS)}
    balances = sorted(diagnosis.balances, key=lambda balance: order[balance.location])
    labels = [f"{balance.location}: {quantity(balance.channel).words}" for balance in balances]
    rows = np.arange(len(balances), dtype=np.float64)
    before = np.array([balance.before for balance in balances])
    after = np.array([balance.after for balance in balances])
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 18 + 2 * ROW_MM * len(balances))
        axes = figure.subplots()
        _bars(axes, rows - 0.2, before, BASELINE.color, "before")
        _bars(axes, rows + 0.2, after, EXTENDED.color, "after")
        axes.axvline(1, color=FLOOR.color, ls=FLOOR.dash, lw=0.9, label="threshold")
        _rows(axes, labels)
        finite = np.concatenate([before, after, [1.0]])
        finite = finite[np.isfinite(finite)]
        if finite.max() > 20:
            axes.set_xscale("log")
            axes.set_xlim(min(0.5, 0.8 * float(finite[finite > 0].min())), 2.5 * float(finite.max()))
        else:
            axes.set_xlim(0, 1.15 * float(finite.max()))
        axes.set_xlabel("root of the decrease of χ² by the best curves, relative to the threshold")
        legend(figure)
    return figure


def candidates_figure(diagnosis: Diagnosis) -> Figure:
    """Score of every entry of the catalogue and the threshold of chance, one panel for each step of the selection."""
    steps = sorted({candidate.step for candidate in diagnosis.candidates})[:4]
    groups = [_best([c for c in diagnosis.candidates if c.step == step]) for step in steps]
    with house_style():
        columns = min(len(steps), 2)
        rows = [max(len(group) for group in groups[at : at + columns]) for at in range(0, len(groups), columns)]
        heights = [ROW_MM * most for most in rows]
        grid = panels(heights, columns, left_mm=LABELS_MM, gap_x_mm=LABELS_MM, gap_y_mm=16)
        named: list[str] = []
        for place, (axes, step, group) in enumerate(zip(grid.flat(), steps, groups, strict=False)):
            _candidates(axes, group, rows[place // columns])
            added = named[0] if len(named) == 1 else f"{len(named)} effects"
            axes.set_title("beside the refitted rig" if step == 0 else f"beside the rig with {added}")
            named += [c.id.replace("_", " ") for c in group if c.state == "named"]
        for axes in grid.flat()[len(steps) :]:
            axes.set_visible(False)
        letters(grid.flat()[: len(steps)])
        _legend_of_states(grid.figure, {candidate.state for group in groups for candidate in group})
    return grid.figure


def shifts_figure(diagnosis: Diagnosis) -> Figure | None:
    """Fitted over assumed parameters with 95 % intervals; None if no assumed value is a number."""
    shown = {
        name: shift
        for name, shift in diagnosis.parameter_shifts.items()
        if shift.assumed and math.isfinite(shift.fitted.value)
    }
    if not shown:
        return None
    with house_style():
        figure = new_figure(SINGLE_COLUMN * 1.5, 16 + ROW_MM * len(shown))
        axes = figure.subplots()
        axes.axvline(0, color=REFERENCE, lw=0.6)
        for row, shift in enumerate(shown.values()):
            assumed = shift.assumed or 1.0
            percent = [
                100 * (value / assumed - 1) for value in (shift.fitted.low, shift.fitted.value, shift.fitted.high)
            ]
            beyond = percent[0] > 0 or percent[2] < 0
            color = BASELINE.color if beyond else "#888888"
            axes.plot([percent[0], percent[2]], [row, row], color=color, lw=1.4)
            axes.plot(percent[1], row, color=color, marker="o" if beyond else "s", ms=4)
        _rows(axes, [parameter_words(name) for name in shown])
        axes.set_xlabel("fitted less assumed, 95 % interval (%)")
    return figure


def gain_figure(diagnosis: Diagnosis) -> Figure:
    """Error on held-out runs before, after and at the floor, over the error before; share explained with interval."""
    names = list(diagnosis.gain)
    gains = list(diagnosis.gain.values())
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 22 + 1.6 * ROW_MM * len(names))
        error, share = figure.subplots(1, 2, sharey=True)
        for row, gain in enumerate(gains):
            _error(error, row, gain)
            _share(share, row, gain)
        _rows(error, [quantity(name).words for name in names])
        error.set_xlabel("RMSE over RMSE before")
        error.set_xlim(0, None)
        share.axvline(100, color=FLOOR.color, ls=FLOOR.dash, lw=0.9)
        share.axvline(0, color=REFERENCE, lw=0.4)
        lows = [100 * gain.low for gain in gains if math.isfinite(gain.low)]
        share.set_xlim(max(min([*lows, 0.0]) - 4, -120), 108)
        share.set_xlabel("explained share of the error above noise (%)")
        panel_letter(error, "a")
        panel_letter(share, "b")
        legend(figure, error)
    return figure


def ladder_figure(diagnosis: Diagnosis) -> Figure:
    """Error of each channel after each step, one panel for each channel; the dashed line is the noise floor."""
    rungs = diagnosis.ladder
    names = list(rungs[0].rmse)
    rows = np.arange(len(rungs), dtype=np.float64)
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 24 + RUNG_MM * len(rungs))
        grid = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
        for axes, name, letter in zip(grid, names, LETTERS, strict=False):
            errors = np.array([rung.rmse.get(name, math.nan) for rung in rungs])
            scale = scale_for(quantity(name).unit, errors)
            colors = [BASELINE.color, *[EXTENDED.color] * (len(rungs) - 1)]
            axes.barh(rows, np.nan_to_num(scale.factor * errors), height=0.6, color=colors)
            for row, error in zip(rows, errors, strict=True):
                text = f"{scale.factor * error:.3g}" if math.isfinite(error) else "none"
                axes.annotate(
                    text, (0.0, row), (3, 0), textcoords="offset points", va="center", fontsize=6.5, color="white"
                )
            if floor := noise_floor(diagnosis, name):
                axes.axvline(scale.factor * floor, color=FLOOR.color, ls=FLOOR.dash, lw=0.9, label="noise floor")
            axes.set_xlim(0, 1.08 * float(np.nanmax(scale.factor * errors)))
            axes.set_xlabel(f"RMSE of the {quantity(name).words} ({scale.unit})")
            axes.grid(visible=False, axis="y")
            panel_letter(axes, letter)
        grid[0].set_yticks(rows, [label(rung) for rung in rungs])
        grid[0].set_ylim(len(rungs) - 0.5, -0.5)
        handles, labels = grid[0].get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, loc="outside upper center")
    return figure


def _bars(axes: Axes, rows: np.ndarray, values: np.ndarray, color: str, label: str) -> None:
    axes.barh(rows, np.where(np.isfinite(values), values, 0.0), height=0.36, color=color, label=label)
    for row, value in zip(rows, values, strict=True):
        text = f"{value:.3g}" if math.isfinite(value) else "none"
        place = value if math.isfinite(value) else 0.0
        axes.annotate(text, (place, row), (3, 0), textcoords="offset points", va="center", fontsize=6.5, bbox=PAPER)


def _rows(axes: Axes, labels: Sequence[str]) -> None:
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")


def _best(group: Sequence[Candidate]) -> list[Candidate]:
    return sorted(group, key=lambda c: -(c.score if math.isfinite(c.score) else -math.inf))[:MAX_CANDIDATES]


def _candidates(axes: Axes, group: Sequence[Candidate], rows: int) -> None:
    scores = [max(c.score, 0.0) if math.isfinite(c.score) else 0.0 for c in group]
    colors = [STATE_COLORS[c.state] for c in group]
    axes.barh(range(len(group)), scores, color=colors, edgecolor=INK, lw=0.3, height=0.7)
    for row, candidate in enumerate(group):
        if math.isfinite(candidate.threshold):
            axes.plot([candidate.threshold] * 2, [row - 0.45, row + 0.45], color=INK, lw=1.2)
    axes.set_xscale("symlog", linthresh=10)
    thresholds = [c.threshold for c in group if math.isfinite(c.threshold)]
    axes.set_xlim(0, 2 * max([*scores, *thresholds, 1.0]))
    _rows(axes, [c.id.replace("_", " ") for c in group])
    axes.set_ylim(rows - 0.4, -0.6)
    axes.set_xlabel(r"decrease of the misfit, $\Delta\chi^2$")


def _legend_of_states(figure: Figure, states: set[str]) -> None:
    handles: list[Artist] = [
        Patch(facecolor=color, edgecolor=INK, lw=0.3, label=state)
        for state, color in STATE_COLORS.items()
        if state in states
    ]
    handles.append(Line2D([], [], color=INK, lw=1.2, label="threshold"))
    figure.legend(handles=handles, loc="upper center", ncols=len(handles), columnspacing=1.0)


def _error(axes: Axes, row: int, gain: Gain) -> None:
    unit = gain.baseline_rmse if gain.baseline_rmse > 0 else 1.0
    again = "_" if row else ""
    after = gain.extended_rmse / unit
    axes.plot([after, gain.baseline_rmse / unit], [row, row], color="#bbbbbb", lw=1.2, zorder=1)
    axes.plot(gain.baseline_rmse / unit, row, "s", color=BASELINE.color, ms=5, ls="", label=f"{again}before")
    axes.plot(after, row, "o", color=EXTENDED.color, ms=5, ls="", label=f"{again}after")
    if math.isfinite(gain.floor_rmse):
        axes.plot(gain.floor_rmse / unit, row, "|", color=INK, ms=9, mew=1.4, ls="", label=f"{again}noise floor")


def _share(axes: Axes, row: int, gain: Gain) -> None:
    if not math.isfinite(gain.explained_share):
        axes.text(2, row, "not determined", va="center", fontsize=7)
        return
    axes.plot([100 * gain.low, 100 * gain.high], [row, row], color=EXTENDED.color, lw=1.6)
    axes.plot(100 * gain.explained_share, row, "o", color=EXTENDED.color, ms=5)
