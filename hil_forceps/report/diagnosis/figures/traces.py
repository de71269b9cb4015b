"""Figures of a diagnosis over time: measured against simulated, residuals of all runs, estimates before and after."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil_forceps.diagnosis.result import Diagnosis, RunEvidence
from hil_forceps.report.diagnosis.figures.layout import Panels, legend, letters, panels
from hil_forceps.report.diagnosis.figures.view import (
    BASELINE,
    EXTENDED,
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
    Scale,
    plain,
    quantity,
    scale_for,
)
from hil_forceps.report.style import (
    REFERENCE,
    Look,
    house_style,
    thinned,
)
from hil_forceps.report.traces import Array

HALF_WIDTH_BINS, FULL_WIDTH_BINS = 450, 900  # a bin is then about as wide as a line

ESTIMATED = {  # estimated quantity: measured, and estimated before and after
    "tau_w_N_m": ("tau_w_before_N_m", "tau_w_after_N_m"),
    "theta_j_rad": ("theta_j_before_rad", "theta_j_after_rad"),
}


def traces_figure(diagnosis: Diagnosis, run: RunEvidence) -> Figure:
    """Measured and simulated per channel with residual; left the whole run, right the part with the largest misfit.

    A measured load that is an input of the simulation is on top.
    """
    names = [name for name in channels(diagnosis) if name in run.measured and name in run.baseline]
    inputs = [name for name in ("tau_w_N_m",) if name in run.measured and name not in names]
    with house_style():
        heights = [13.0] * len(inputs) + [22.0, 15.0] * len(names)
        grid = panels(heights, 2, widths=(4, 3), sharex="col")
        for side, part in enumerate(_parts(diagnosis, run, grid, "where the misfit is largest")):
            column = grid.column(side)
            for axes, name in zip(column, inputs, strict=False):
                _input(axes, run, name, part)
            for position, name in enumerate(names):
                upper, lower = column[len(inputs) + 2 * position : len(inputs) + 2 * position + 2]
                _signal(upper, diagnosis, run, name, part)
                _residual(lower, diagnosis, run, name, part)
            for axes in column[1:] if side else ():
                axes.set_ylabel("")
            column[0].set_ylabel("" if side else column[0].get_ylabel())
        legend(grid.figure, grid.axes[len(inputs)][0])
    return grid.figure


def residual_time_figure(diagnosis: Diagnosis) -> Figure:
    """Residual of every channel over time, runs one after the other; runs held out are shaded."""
    names, runs = channels(diagnosis), [run for run in diagnosis.runs if len(run.time_s) > 1]
    spans = [float(run.time_s[-1] - run.time_s[0]) for run in runs]
    space = 0.01 * sum(spans)
    starts = np.concatenate([[0.0], np.cumsum(np.array(spans) + space)])
    with house_style():
        grid = panels([24.0] * len(names), sharex=True, gap_y_mm=6)
        rows = grid.column(0)
        for axes, name in zip(rows, names, strict=True):
            _residual_of_all(axes, diagnosis, runs, name, starts)
        for run, start, span in zip(runs, starts, spans, strict=False):
            title = _fitting(plain(run.name), 110 * span / sum(spans))
            rows[0].text(start + span / 2, 1.04, title, transform=rows[0].get_xaxis_transform(), ha="center", size=7)
        rows[-1].set_xlim(0, starts[-1] - space)
        rows[-1].set_xlabel("time, runs one after the other (s)" if len(runs) > 1 else "time (s)")
        letters(rows)
        legend(grid.figure)
    return grid.figure


def estimates_figure(diagnosis: Diagnosis, run: RunEvidence) -> Figure:
    """Estimates of a run before and after, and their error if the quantity was measured."""
    names = estimated_in(run)
    with house_style():
        heights = [height for name in names for height in ((22.0, 15.0) if name in run.measured else (22.0,))]
        grid = panels(heights, 2, widths=(4, 3), sharex="col")
        for side, part in enumerate(_parts(diagnosis, run, grid, "where the simulation's misfit is largest")):
            rows = iter(grid.column(side))
            for name in names:
                _estimate(next(rows), next(rows) if name in run.measured else None, run, name, part)
            for axes in grid.column(side) if side else ():
                axes.set_ylabel("")
        legend(grid.figure, grid.axes[0][0])
    return grid.figure


def _parts(diagnosis: Diagnosis, run: RunEvidence, grid: Panels, magnified: str) -> tuple[slice, slice]:
    """Set the columns to the whole run and its worst part, which is marked in the first; return the rows of both."""
    window = telling_window(diagnosis, run)
    ends = run.time_s[[window.start, window.stop - 1]]
    grid.axes[0][0].set_title(_title(run))
    grid.axes[0][1].set_title(magnified)
    letters(grid.axes[0])
    grid.axes[-1][0].set_xlim(float(run.time_s[0]), float(run.time_s[-1]))
    grid.axes[-1][1].set_xlim(float(ends[0]), float(ends[1]))
    for axes in grid.axes[-1]:
        axes.set_xlabel("time (s)")
    for axes in grid.column(0):
        axes.axvspan(float(ends[0]), float(ends[1]), color="#f0e442", alpha=0.35, lw=0)
    return slice(None), window


def _fitting(text: str, characters: float) -> str:
    return text if len(text) <= characters else text[: max(int(characters) - 1, 1)] + "…"


def estimated_in(run: RunEvidence) -> tuple[str, ...]:
    """Name what was estimated in a run."""
    return tuple(name for name, pair in ESTIMATED.items() if any(key in run.estimates for key in pair))


def line(axes: Axes, time: Array, values: Array, style: Look, *, label: str = "", bins: int = HALF_WIDTH_BINS) -> None:
    """Draw a line thinned to the visible resolution; values that are not finite are left out at both ends."""
    finite = np.flatnonzero(np.isfinite(values))
    if finite.size:
        part = slice(int(finite[0]), int(finite[-1]) + 1)
        width = 2.2 if style is MEASURED else 0.8
        shown = thinned(time[part], values[part], bins)
        axes.plot(*shown, color=style.color, ls=style.dash, lw=width, label=label or style.label)


def _title(run: RunEvidence) -> str:
    return f"{plain(run.name)}, held out" if run.held_out else plain(run.name)


def _input(axes: Axes, run: RunEvidence, name: str, part: slice) -> None:
    values = run.measured[name]
    scale = scale_for(quantity(name).unit, values)
    line(axes, run.time_s[part], values[part] * scale.factor, MEASURED)
    axes.set_ylabel(_two_lines(name, scale))


def _signal(axes: Axes, diagnosis: Diagnosis, run: RunEvidence, name: str, part: slice) -> None:
    measured = run.measured[name]
    scale = scale_for(quantity(name).unit, measured)
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
            if stage != "nominal":  # a rig with a large error must not compress the other curves
                shown.append(values[part] * scale.factor)
    axes.set_ylim(*_limits(shown))
    axes.set_ylabel(_two_lines(name, scale))


def _residual(axes: Axes, diagnosis: Diagnosis, run: RunEvidence, name: str, part: slice) -> None:
    shown = {stage: residual(run, stage, name) for stage in stages(diagnosis)}
    parts = {stage: values[part] for stage, values in shown.items() if values is not None}
    scale = scale_for(quantity(name).unit, np.concatenate([_middle(values) for values in parts.values()]))
    axes.axhline(0, color=REFERENCE, lw=0.4)
    for stage, values in parts.items():
        line(axes, run.time_s[part], values * scale.factor, _solid(stage))
    _noise_band(axes, diagnosis, name, scale)
    axes.set_ylabel(f"residual\n({scale.unit})")


def _residual_of_all(axes: Axes, diagnosis: Diagnosis, runs: list[RunEvidence], name: str, starts: Array) -> None:
    kept = {stage: [residual(run, stage, name) for run in runs] for stage in stages(diagnosis)}
    pooled = [_middle(values) for parts in kept.values() for values in parts if values is not None]
    scale = scale_for(quantity(name).unit, np.concatenate(pooled))
    axes.axhline(0, color=REFERENCE, lw=0.4)
    bins = max(FULL_WIDTH_BINS // len(runs), 60)
    for stage, parts in kept.items():
        for run, values, start in zip(runs, parts, starts, strict=False):
            if values is not None:
                shifted = run.time_s - run.time_s[0] + start
                line(axes, shifted, values * scale.factor, _solid(stage), bins=bins)
    for run, start, end in zip(runs, starts, starts[1:], strict=False):
        if run.held_out:
            axes.axvspan(start, end, color="#56b4e9", alpha=0.2, lw=0, label="held out")
        axes.axvline(end, color="#888888", lw=0.5)
    axes.set_ylim(*_limits([part * scale.factor for part in pooled]))
    _noise_band(axes, diagnosis, name, scale)
    axes.set_ylabel(f"{quantity(name).words}\nresidual ({scale.unit})")


def _estimate(upper: Axes, lower: Axes | None, run: RunEvidence, name: str, part: slice) -> None:
    time_s, measured = run.time_s[part], run.measured.get(name)
    pair = {key: run.estimates[key][part] for key in ESTIMATED[name] if key in run.estimates}
    scale = scale_for(quantity(name).unit, np.concatenate([_middle(run.estimates[key]) for key in pair]))
    shown = [_middle(values) * scale.factor for values in pair.values()]
    if measured is not None:
        line(upper, time_s, measured[part] * scale.factor, MEASURED)
        shown.append(measured[part] * scale.factor)
    for key, values in pair.items():
        line(upper, time_s, values * scale.factor, _estimator(key))
    upper.set_ylim(*_limits(shown))
    upper.set_ylabel(_two_lines(name, scale))
    if lower is None or measured is None:
        return
    errors = {key: values - measured[part] for key, values in pair.items()}
    small = scale_for(quantity(name).unit, np.concatenate([_middle(values) for values in errors.values()]))
    lower.axhline(0, color=REFERENCE, lw=0.4)
    for key, values in errors.items():
        line(lower, time_s, values * small.factor, _estimator(key))
    lower.set_ylim(*_limits([_middle(values) * small.factor for values in errors.values()]))
    lower.set_ylabel(f"error\n({small.unit})")


def _estimator(key: str) -> Look:
    after = "after" in key
    style = EXTENDED if after else BASELINE
    return style._replace(label="estimated after" if after else "estimated before", dash="-")


def _solid(stage: str) -> Look:
    return LOOKS[stage]._replace(dash="-")  # dashes of a dense line look like noise


def _two_lines(name: str, scale: Scale) -> str:
    here = quantity(name)
    return f"{here.words}\n{here.symbol} ({scale.unit})"


def _noise_band(axes: Axes, diagnosis: Diagnosis, name: str, scale: Scale) -> None:
    floor = floor_of(diagnosis, name)
    if floor is not None:
        for side, label in ((1, "95 % of the noise"), (-1, "_again")):  # on top, because dense residuals hide a band
            level = side * 1.96 * floor * scale.factor
            axes.axhline(level, color=FLOOR.color, ls=FLOOR.dash, lw=0.8, label=label, zorder=3)


def _middle(values: Array) -> Array:
    """Return axis limits for all values except single outliers."""
    finite = values[np.isfinite(values)]
    if finite.size < 100:
        return finite
    low, high = np.quantile(finite[:: max(finite.size // 100_000, 1)], [0.001, 0.999])
    return np.asarray(np.clip([finite.min(), finite.max()], 2 * low - high, 2 * high - low), dtype=np.float64)


def _limits(parts: list[Array]) -> tuple[float, float]:
    finite = np.concatenate([part[np.isfinite(part)] for part in parts])
    if not finite.size:
        return (-1.0, 1.0)
    low, high = float(finite.min()), float(finite.max())
    margin = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin
