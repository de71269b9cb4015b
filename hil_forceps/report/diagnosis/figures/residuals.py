"""Figures of residuals: over variables, in loops, and spectra."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hil_forceps.diagnosis.result import Diagnosis, RunEvidence
from hil_forceps.report.diagnosis.figures.bins import MAX_ROWS, Binned, binned, edges_of, smoothed, spectrum, strided
from hil_forceps.report.diagnosis.figures.layout import legend, letters, panels
from hil_forceps.report.diagnosis.figures.view import (
    FLOOR,
    LOOKS,
    MEASURED,
    channels,
    floor_of,
    residual,
    simulated,
    stages,
    telling_window,
)
from hil_forceps.report.diagnosis.names import (
    axis_label,
    quantity,
    scale_for,
)
from hil_forceps.report.style import REFERENCE, Look, house_style
from hil_forceps.report.traces import Array

ORDER = ("theta", "omega", "tension", "time_since_reversal", "load", "acceleration", "elongation", "time")
MAX_PANELS = 6
LOGARITHMIC = ("time_since_reversal",)
LEVELS = 40  # of the density, up the residual's axis
MAX_LOOP_POINTS = 3000
FINE_BINS = 60  # of the density, along the variable
LOOP_ROWS = 20_000  # of longer runs only this number of rows around the largest misfit


class _Pooled(NamedTuple):
    over: Array
    values: dict[str, Array]  # residual by stage
    direction: Array  # sign of the motor's speed, 0 where it isn't known


def variables_figure(diagnosis: Diagnosis, channel: str) -> Figure | None:
    """Residual of a channel over each variable, all runs: density, and mean with its 95 % interval, before and after.

    The variables over which the residual varies most come first, if known. None without variables.
    """
    names = _variables(diagnosis, channel)[:MAX_PANELS]
    pooled = {name: _pooled(diagnosis, channel, name) for name in names}
    names = [name for name in names if edges_of(_on_axis(name, pooled[name].over)) is not None]
    if not names:
        return None
    before, after = stages(diagnosis)[0], stages(diagnosis)[-1]
    everything = np.concatenate([pooled[name].values[stage] for name in names[:1] for stage in (before, after)])
    finite = everything[np.isfinite(everything)]
    low, high = np.quantile(finite, [0.002, 0.998]) if finite.size else (-1.0, 1.0)
    scale = scale_for(quantity(channel).unit, [low, high])
    with house_style():
        columns = min(len(names), 3)
        grid = panels([38.0] * -(-len(names) // columns), columns, gap_x_mm=5, gap_y_mm=13, sharey=True)
        for axes, name in zip(grid.flat(), names, strict=False):
            variable, values, direction = pooled[name]
            _over(axes, name, variable, {stage: part * scale.factor for stage, part in values.items()}, direction)
        for axes in grid.flat()[len(names) :]:
            axes.set_visible(False)
        margin = 0.05 * (high - low) or 1.0
        grid.axes[0][0].set_ylim((low - margin) * scale.factor, (high + margin) * scale.factor)
        for axes in grid.column(0):
            axes.set_ylabel(f"{quantity(channel).words}\nresidual ({scale.unit})")
        letters(grid.flat()[: len(names)])
        legend(grid.figure)
    return grid.figure


def loops_figure(diagnosis: Diagnosis, run: RunEvidence) -> Figure | None:
    """Current or torque over the motor's angle, and angle over load, measured and simulated; None without either."""
    pairs = _loops(run)
    if not pairs:
        return None
    window = telling_window(diagnosis, run)
    middle = (window.start + window.stop) // 2
    first = max(min(middle - LOOP_ROWS // 2, len(run.time_s) - LOOP_ROWS), 0)
    part = slice(first, min(first + LOOP_ROWS, len(run.time_s)))
    with house_style():
        grid = panels([50.0], len(pairs), gap_x_mm=17)
        for axes, (over, name) in zip(grid.flat(), pairs, strict=True):
            _loop(axes, diagnosis, run, over, name, part)
        letters(grid.flat())
        legend(grid.figure)
    return grid.figure


def spectra_figure(diagnosis: Diagnosis) -> Figure | None:
    """Amplitude density of the residual of every channel, the runs' mean, against the floor of white noise."""
    names = [name for name in channels(diagnosis) if _spectra(diagnosis, name, stages(diagnosis)[0])]
    if not names:
        return None
    with house_style():
        columns = min(len(names), 3)
        grid = panels([44.0] * -(-len(names) // columns), columns, gap_x_mm=16, gap_y_mm=13)
        for axes, name in zip(grid.flat(), names, strict=False):
            _spectrum(axes, diagnosis, name)
        for axes in grid.flat()[len(names) :]:
            axes.set_visible(False)
        letters(grid.flat()[: len(names)])
        legend(grid.figure)
    return grid.figure


def _variables(diagnosis: Diagnosis, channel: str) -> list[str]:
    known = dict.fromkeys(name for run in diagnosis.runs for name in run.variables)
    known.setdefault("time", None)
    share = {trend.variable: trend.before for trend in diagnosis.trends if trend.channel == channel}
    order = {name: place for place, name in enumerate(ORDER)}
    return sorted(known, key=lambda name: (-share.get(name, -1.0), order.get(name, len(order))))


def _pooled(diagnosis: Diagnosis, channel: str, variable: str) -> _Pooled:
    """Rows of all runs that have both, thinned for a scatter plot; runs are separated by a row of NaN."""
    rows = sum(len(run.time_s) for run in diagnosis.runs)
    stride = strided(rows, MAX_ROWS)
    gap = np.array([np.nan])
    over, direction = [np.zeros(0)], [np.zeros(0)]
    values: dict[str, list[Array]] = {stage: [np.zeros(0)] for stage in stages(diagnosis)}
    for run in diagnosis.runs:
        column = run.time_s - run.time_s[0] if variable == "time" and len(run.time_s) else run.variables.get(variable)
        parts = {stage: residual(run, stage, channel) for stage in values}
        if column is None or any(part is None for part in parts.values()):
            continue
        over += [column[stride], gap]
        direction += [np.sign(run.variables.get("omega", np.zeros(len(column)))[stride]), gap]
        for stage, part in parts.items():
            if part is not None:
                values[stage] += [part[stride], gap]
    joined = {stage: np.concatenate(parts) for stage, parts in values.items()}
    return _Pooled(np.concatenate(over), joined, np.concatenate(direction))


def _over(axes: Axes, name: str, variable: Array, values: dict[str, Array], direction: Array) -> None:
    """Density before, means by direction before (friction cancels in their average), mean after."""
    scale = scale_for(quantity(name).unit, [] if name in LOGARITHMIC else variable)
    shown = _on_axis(name, variable) * scale.factor
    edges, fine = edges_of(shown), edges_of(shown, bins=FINE_BINS)
    if edges is None or fine is None:
        return
    first, last = next(iter(values)), list(values)[-1]
    _density(axes, shown, values[first], fine)
    axes.axhline(0, color=REFERENCE, lw=0.4)
    look = LOOKS[first]
    if name == "omega" or not np.any(direction > 0) or not np.any(direction < 0):
        _mean(axes, binned(shown, values[first], edges), look._replace(dash="-"))
    else:
        for sign, marker, dash, word in ((1, "^", "-", "forward"), (-1, "v", (0, (3, 1)), "backward")):
            here = np.where(direction == sign, values[first], np.nan)
            style = Look(f"{look.label}, {word}", look.color, dash, marker)
            _mean(axes, binned(shown, here, edges), style)
    if last != first:
        _mean(axes, binned(shown, values[last], edges), LOOKS[last])
    if name in LOGARITHMIC:
        axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        axes.xaxis.set_major_formatter(lambda power, _: f"$10^{{{power:.0f}}}$")
    axes.set_xlim(edges[0], edges[-1])
    axes.set_xlabel(axis_label(name, scale))


def _on_axis(name: str, variable: Array) -> Array:
    if name not in LOGARITHMIC:
        return variable
    return np.log10(variable, out=np.full(len(variable), np.nan), where=variable > 0)


def _mean(axes: Axes, mean: Binned, look: Look) -> None:
    axes.fill_between(mean.centre, mean.low, mean.high, color=look.color, alpha=0.3, lw=0)
    axes.plot(
        mean.centre, mean.mean, color=look.color, ls=look.dash, lw=1.1, marker=look.marker, ms=2.4, label=look.label
    )


def _density(axes: Axes, variable: Array, values: Array, edges: Array) -> None:
    good = np.isfinite(variable) & np.isfinite(values)
    low, high = np.quantile(values[good], [0.001, 0.999]) if good.any() else (0.0, 0.0)
    if not high > low:
        return
    counts = np.histogram2d(variable[good], values[good], (FINE_BINS, LEVELS), ((edges[0], edges[-1]), (low, high)))[0]
    shown = np.ma.masked_equal(counts.T, 0)
    axes.grid(visible=False)
    axes.imshow(
        shown,
        extent=(edges[0], edges[-1], low, high),
        origin="lower",
        aspect="auto",
        cmap="Greys",
        norm=LogNorm(0.3, 4 * max(float(counts.max()), 1.0)),
        interpolation="none",
    )


def _loops(run: RunEvidence) -> list[tuple[str, str]]:
    drive = next((name for name in ("tau_m_N_m", "current_A") if name in run.measured), None)
    pairs = []
    if drive and "theta_m_rad" in run.measured:
        pairs.append(("theta_m_rad", drive))
    if "tau_w_N_m" in run.measured:
        angle = "theta_j_rad" if "theta_j_rad" in run.measured else "theta_m_rad"
        pairs.append(("tau_w_N_m", angle))
        if drive:
            pairs.append(("tau_w_N_m", drive))
    return pairs


def _loop(axes: Axes, diagnosis: Diagnosis, run: RunEvidence, over: str, name: str, part: slice) -> None:
    thin = strided(part.stop - part.start, MAX_LOOP_POINTS)
    columns = {"measured": (MEASURED, run.measured)}
    columns |= {stage: (LOOKS[stage], {**run.measured, **simulated(run, stage)}) for stage in stages(diagnosis)}
    relative = name == "theta_j_rad" and np.ptp(run.measured["theta_m_rad"][part]) > 0
    # the jaw follows the motor; the effect of the load is visible after subtracting this motion
    line = np.polyfit(run.measured["theta_m_rad"][part], run.measured[name][part], 1) if relative else np.zeros(2)
    shown = [
        (look, here[over][part][thin], here[name][part][thin] - np.polyval(line, here["theta_m_rad"][part][thin]))
        for look, here in columns.values()
    ]
    x_scale = scale_for(quantity(over).unit, shown[0][1])
    y_scale = scale_for(quantity(name).unit, shown[0][2])
    for look, x, y in shown:
        width = 2.0 if look is MEASURED else 0.7
        axes.plot(x * x_scale.factor, y * y_scale.factor, color=look.color, ls=look.dash, lw=width, label=look.label)
    axes.set_xlabel(axis_label(over, x_scale))
    relation = f"jaw angle less its share\nof the motor's ({y_scale.unit})"
    axes.set_ylabel(relation if relative else axis_label(name, y_scale))


def _spectra(diagnosis: Diagnosis, channel: str, stage: str) -> list[tuple[Array, Array]]:
    found = []
    for run in diagnosis.runs:
        left = residual(run, stage, channel)
        here = None if left is None else spectrum(run.time_s, left)
        if here is not None:
            found.append(here)
    return found


def _spectrum(axes: Axes, diagnosis: Diagnosis, channel: str) -> None:
    means = {}
    for stage in stages(diagnosis):
        parts = _spectra(diagnosis, channel, stage)
        grid = max((part[0] for part in parts), key=len)
        power = np.mean([np.interp(grid, part[0], part[1] ** 2) for part in parts], axis=0)
        means[stage] = smoothed(grid, np.sqrt(power))
    scale = scale_for(quantity(channel).unit, np.concatenate([part[1] for part in means.values()]))
    for stage, (grid, density) in means.items():
        look = LOOKS[stage]
        shown = density * scale.factor
        axes.plot(grid, np.where(shown > 0, shown, np.nan), color=look.color, lw=0.8, label=look.label)
    floor = floor_of(diagnosis, channel)
    if floor is not None:
        interval_s = float(np.median(np.diff(max((run.time_s for run in diagnosis.runs), key=len)[:10_000])))
        level = floor * np.sqrt(2 * interval_s) * scale.factor
        axes.axhline(level, color=FLOOR.color, ls=FLOOR.dash, lw=0.9, label="white noise of the floor")
    axes.set_xlim(min(part[0][0] for part in means.values()), max(part[0][-1] for part in means.values()))
    axes.set_xscale("log")
    if any(np.any(part[1] > 0) for part in means.values()):
        axes.set_yscale("log")
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(f"{quantity(channel).words}: residual ({scale.unit}/√Hz)")
