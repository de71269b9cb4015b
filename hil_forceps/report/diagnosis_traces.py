"""Figures of a diagnosis over time: measured against simulated, residuals of all runs, estimates before and after."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil_forceps.diagnosis.result import Diagnosis, RunEvidence
from hil_forceps.report.diagnosis_names import (
    Scale,
    axis_label,
    quantity,
    scale_for,
)
from hil_forceps.report.diagnosis_view import (
    BASELINE,
    EXTENDED,
    LOOKS,
    MEASURED,
    channels,
    floor_of,
    residual,
    simulated,
    stages,
    telling_window,
)
from hil_forceps.report.style import (
    DOUBLE_COLUMN,
    REFERENCE,
    Look,
    house_style,
    new_figure,
    panel_letter,
    peak_limits,
    thinned,
)
from hil_forceps.report.traces import Array

LETTERS = "abcdefghijklmnopqrstuvwxyz"
HALF_WIDTH_BINS, FULL_WIDTH_BINS = 450, 900  # a bin is then about as wide as a line

ESTIMATED = {  # what is estimated: measured beside it, and what it is before and after
    "tau_w_N_m": ("tau_w_before_N_m", "tau_w_after_N_m"),
    "theta_j_rad": ("theta_j_before_rad", "theta_j_after_rad"),
}


def traces_figure(diagnosis: Diagnosis, run: RunEvidence) -> Figure:
    """Measured and simulated per channel, residual below each; the whole run left, where the misfit is largest right.

    A load that was measured but is an input of the simulation stands on top.
    """
    names = [name for name in channels(diagnosis) if name in run.measured and name in run.baseline]
    inputs = [name for name in ("tau_w_N_m",) if name in run.measured and name not in names]
    rows = len(inputs) + 2 * len(names)
    window = telling_window(diagnosis, run)
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 16 + 19 * len(inputs) + 42 * len(names))
        ratios = [2] * len(inputs) + [3, 2] * len(names)
        grid = figure.subplots(rows, 2, sharex="col", squeeze=False, height_ratios=ratios, width_ratios=(4, 3))
        for side, part in enumerate((slice(None), window)):
            column = grid[:, side]
            for position, name in enumerate(inputs):
                _input(column[position], run, name, part)
            for position, name in enumerate(names):
                upper, lower = column[len(inputs) + 2 * position : len(inputs) + 2 * position + 2]
                _signal(upper, diagnosis, run, name, part)
                _residual(lower, diagnosis, run, name, part)
            shown = run.time_s[part]
            column[-1].set_xlim(float(shown[0]), float(shown[-1]))
            column[-1].set_xlabel("time (s)")
            panel_letter(column[0], LETTERS[side])
        grid[0, 0].set_title(_title(run))
        grid[0, 1].set_title("where the misfit is largest")
        for axes in grid[:, 0]:
            axes.axvspan(*run.time_s[[window.start, window.stop - 1]], color="#f0e442", alpha=0.35, lw=0)
        for axes in grid[:, 1]:
            axes.set_ylabel("")
        figure.align_ylabels(grid[:, 0])
        legend(figure, grid[len(inputs), 0] if names else grid[0, 0])
    return figure


def residual_time_figure(diagnosis: Diagnosis) -> Figure:
    """Residual of every channel over time, runs one after the other; runs held out are shaded."""
    names, runs = channels(diagnosis), [run for run in diagnosis.runs if len(run.time_s) > 1]
    length = sum(float(run.time_s[-1] - run.time_s[0]) for run in runs)
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 18 + 27 * len(names))
        grid = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        for axes, name, letter in zip(grid, names, LETTERS, strict=False):
            _residual_of_all(axes, diagnosis, runs, name, 0.01 * length)
            panel_letter(axes, letter)
        start = 0.0
        for run in runs:
            span = float(run.time_s[-1] - run.time_s[0])
            wide = span > 0.09 * length
            label = _title(run) if wide else ""
            if label and len(label) > 120 * span / length:
                label = label[: max(int(120 * span / length) - 1, 3)] + "…"
            grid[0].text(start + span / 2, 1.03, label, transform=grid[0].get_xaxis_transform(), ha="center", size=7)
            start += span + 0.01 * length
        grid[-1].set_xlim(0, start - 0.01 * length)
        grid[-1].set_xlabel("time, runs one after the other (s)" if len(runs) > 1 else "time (s)")
        figure.align_ylabels(list(grid))
        legend(figure, grid[0])
    return figure


def estimates_figure(diagnosis: Diagnosis, run: RunEvidence) -> Figure:
    """What the estimator makes of a run before and after, and its error where the truth was measured."""
    names = estimated_in(run)
    window = telling_window(diagnosis, run)
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 16 + 42 * len(names))
        ratios = [3, 2] * len(names)
        grid = figure.subplots(2 * len(names), 2, sharex="col", squeeze=False, height_ratios=ratios)
        for side, part in enumerate((slice(None), window)):
            for position, name in enumerate(names):
                _estimate(grid[2 * position, side], grid[2 * position + 1, side], run, name, part)
            shown = run.time_s[part]
            grid[-1, side].set_xlim(float(shown[0]), float(shown[-1]))
            grid[-1, side].set_xlabel("time (s)")
            panel_letter(grid[0, side], LETTERS[side])
        for axes in grid[:, 1]:
            axes.set_ylabel("")
        grid[0, 0].set_title(_title(run))
        grid[0, 1].set_title("where the misfit of the simulation is largest")
        figure.align_ylabels(grid[:, 0])
        legend(figure, grid[0, 0])
    return figure


def estimated_in(run: RunEvidence) -> tuple[str, ...]:
    """Name what was estimated in a run."""
    return tuple(name for name, pair in ESTIMATED.items() if any(key in run.estimates for key in pair))


def line(axes: Axes, time: Array, values: Array, style: Look, *, label: str = "", bins: int = HALF_WIDTH_BINS) -> None:
    """Draw a line thinned to what the eye can see; what is not finite at either end is left out."""
    finite = np.flatnonzero(np.isfinite(values))
    if finite.size:
        part = slice(int(finite[0]), int(finite[-1]) + 1)
        width = 2.2 if style is MEASURED else 0.8
        shown = thinned(time[part], values[part], bins)
        axes.plot(*shown, color=style.color, ls=style.dash, lw=width, label=label or style.label)


def _title(run: RunEvidence) -> str:
    return f"{run.name}, held out" if run.held_out else run.name


def _input(axes: Axes, run: RunEvidence, name: str, part: slice) -> None:
    values = run.measured[name]
    scale = scale_for("N m", values)
    line(axes, run.time_s[part], values[part] * scale.factor, MEASURED)
    axes.set_ylabel(axis_label(name, scale))


def _signal(axes: Axes, diagnosis: Diagnosis, run: RunEvidence, name: str, part: slice) -> None:
    measured = run.measured[name]
    scale = _scale(name, measured)
    time_s = run.time_s[part]
    shown = [measured[part] * scale.factor]
    line(axes, time_s, shown[0], MEASURED)
    if name == "theta_m_rad" and "theta_m_ref_rad" in run.measured:
        reference = run.measured["theta_m_ref_rad"][part] * scale.factor
        line(axes, time_s, reference, Look("reference", REFERENCE, (0, (1, 1.5)), ""))
    for stage in ("nominal", *(stage for stage in stages(diagnosis) if stage != "nominal")):
        values = simulated(run, stage).get(name)
        if values is not None:
            line(axes, time_s, values[part] * scale.factor, LOOKS[stage])
            if stage != "nominal":  # a rig far off must not squeeze the rest into a line
                shown.append(values[part] * scale.factor)
    axes.set_ylim(*_limits(shown))
    axes.set_ylabel(axis_label(name, scale))


def _residual(axes: Axes, diagnosis: Diagnosis, run: RunEvidence, name: str, part: slice) -> None:
    shown = {stage: residual(run, stage, name) for stage in stages(diagnosis)}
    parts = {stage: values[part] for stage, values in shown.items() if values is not None}
    scale = _scale(name, np.concatenate([_middle(values) for values in parts.values()]))
    axes.axhline(0, color=REFERENCE, lw=0.4)
    for stage, values in parts.items():
        line(axes, run.time_s[part], values * scale.factor, LOOKS[stage])
    _noise_band(axes, diagnosis, name, scale)
    axes.set_ylabel(f"residual ({scale.unit})")


def _residual_of_all(axes: Axes, diagnosis: Diagnosis, runs: list[RunEvidence], name: str, space_s: float) -> None:
    kept = {stage: [residual(run, stage, name) for run in runs] for stage in stages(diagnosis)}
    pooled = [_middle(values) for parts in kept.values() for values in parts if values is not None]
    scale = _scale(name, np.concatenate(pooled))
    axes.axhline(0, color=REFERENCE, lw=0.4)
    start = 0.0
    bins = max(FULL_WIDTH_BINS // len(runs), 60)
    for index, run in enumerate(runs):
        span = float(run.time_s[-1] - run.time_s[0])
        if run.held_out:
            axes.axvspan(start, start + span, color="#56b4e9", alpha=0.15, lw=0)
        for stage, parts in kept.items():
            values = parts[index]
            if values is not None:
                style = LOOKS[stage]._replace(dash="-")  # dashes of a dense line only look like noise
                label = style.label if index == 0 else "_again"
                line(axes, start + run.time_s - run.time_s[0], values * scale.factor, style, label=label, bins=bins)
        if index:
            axes.axvline(start - space_s / 2, color="#888888", lw=0.5)
        start += span + space_s
    _noise_band(axes, diagnosis, name, scale)
    axes.set_ylabel(axis_label(name, scale).replace(" (", "\nresidual ("))


def _estimate(upper: Axes, lower: Axes, run: RunEvidence, name: str, part: slice) -> None:
    time_s, measured = run.time_s[part], run.measured.get(name)
    pair = {key: run.estimates[key] for key in ESTIMATED[name] if key in run.estimates}
    scale = _scale(name, np.concatenate([_middle(values) for values in pair.values()]))
    shown = []
    if measured is not None:
        line(upper, time_s, measured[part] * scale.factor, MEASURED)
        shown.append(measured[part] * scale.factor)
    lower.axhline(0, color=REFERENCE, lw=0.4)
    errors = []
    for key, values in pair.items():
        style = EXTENDED if "after" in key else BASELINE
        label = "estimated after" if "after" in key else "estimated before"
        here = values[part] * scale.factor
        line(upper, time_s, here, style, label=label)
        shown.append(_middle(here))
        if measured is not None:
            errors.append(here - measured[part] * scale.factor)
            line(lower, time_s, errors[-1], style, label=label)
    upper.set_ylim(*_limits(shown))
    upper.set_ylabel(axis_label(name, scale))
    if errors:
        lower.set_ylim(*peak_limits([_middle(values) for values in errors]))
    else:
        lower.text(0.5, 0.5, "not measured: no error to show", transform=lower.transAxes, ha="center", va="center")
    lower.set_ylabel(f"error ({scale.unit})")


def _noise_band(axes: Axes, diagnosis: Diagnosis, name: str, scale: Scale) -> None:
    floor = floor_of(diagnosis, name)
    if floor is not None:
        band = 1.96 * floor * scale.factor
        axes.axhspan(-band, band, color="#009e73", alpha=0.18, lw=0, label="95 % of the noise", zorder=0.5)


def _scale(name: str, values: Array) -> Scale:
    return scale_for(quantity(name).unit, values)


def _middle(values: Array) -> Array:
    finite = values[np.isfinite(values)]
    if finite.size < 100:
        return finite
    return np.asarray(np.quantile(finite[:: max(finite.size // 100_000, 1)], [0.001, 0.999]))


def _limits(parts: list[Array]) -> tuple[float, float]:
    finite = np.concatenate([part[np.isfinite(part)] for part in parts])
    if not finite.size:
        return (-1.0, 1.0)
    low, high = float(finite.min()), float(finite.max())
    margin = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin


def legend(figure: Figure, *sources: Axes) -> None:
    """Put one legend for all panels above them, that of `sources` first."""
    found: dict[str, Artist] = {}
    for axes in figure.axes if not sources else [*sources, *figure.axes]:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(list(found.values()), list(found), loc="outside upper center", ncols=min(len(found), 6))
