"""Figures of the comparison on an axis: force and residuals of models, evidence, open loop."""

from collections.abc import Callable
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil_forceps.identification.axis.axis import AxisRun
from hil_forceps.identification.axis.comparison import AxisComparison
from hil_forceps.identification.axis.evidence import MIN_COHERENCE, DEAD_TIMES_s
from hil_forceps.identification.axis.files import WORDS
from hil_forceps.identification.axis.force_terms import Motion, Vector, column, terms
from hil_forceps.identification.axis.inverse_model import Fit, predicted, residual
from hil_forceps.identification.axis.open_loop_runs import position_error
from hil_forceps.report.bench.simulation import MILLI
from hil_forceps.report.save import save_figure
from hil_forceps.report.style import DOUBLE_COLUMN, INK, TRUTH, house_style, look, new_figure, panel_letter

_PUBLISHED, _OURS, _OTHER = look("previous").color, look("improved").color, look("kalman").color
_BINS = 41  # of the speed
_SHOWN_N = 12.0


def write_axis_figures(found: AxisComparison, out: Path) -> list[Path]:
    """Draw all figures into `out` as PDF and PNG; return the files. OSError if writing fails."""
    figures = {
        "axis_force": force_figure(found),
        "axis_evidence": evidence_figure(found),
        "axis_open_loop": open_loop_figure(found),
    }
    if found.networks:
        figures["axis_networks"] = networks_figure(found)
    return [path for name, figure in figures.items() for path in save_figure(figure, out, name)]


def force_figure(found: AxisComparison) -> Figure:
    """Force above, residuals of the published and the selected model below; training run and first test run."""
    first, best = found.rungs[0].fit, found.chosen.fit
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 88)
        grid = figure.subplots(2, 2, sharex=True, sharey="row")
        for run, force, left, letter in zip((found.train, found.tests[0]), grid[0], grid[1], "ab", strict=True):
            time_s = run.row_time_s
            force.plot(time_s, run.rows.force_N(best.shape.dead_time_s), color=TRUTH, lw=1.8, label="measured")
            force.plot(time_s, predicted(run.rows, best), color=_OURS, lw=0.6, label="chosen model")
            for fit, color, label in ((first, _PUBLISHED, "published model"), (best, _OURS, "chosen model")):
                left.plot(time_s, residual(run.rows, fit), color=color, lw=0.5, label=f"{label} leaves")
            role = "trains" if run is found.train else "test"
            force.set_title(f"{run.name} ({role})")
            panel_letter(force, letter)
            left.set_xlabel("time (s)")
            left.set_ylim(-_SHOWN_N, _SHOWN_N)
        grid[0, 0].set_ylabel("force (N)")
        grid[1, 0].set_ylabel("measured less model (N)")
        handles = [line for axes in grid[:, 0] for line in axes.get_legend_handles_labels()[0]]
        figure.legend(handles, [str(line.get_label()) for line in handles], loc="outside upper center", ncols=4)
    return figure


def evidence_figure(found: AxisComparison) -> Figure:
    """Dead time, friction over speed, ripple over the path, and force over acceleration by frequency."""
    panels: tuple[Callable[[Axes, AxisComparison], None], ...] = (_dead_time, _friction, _ripple, _mass)
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 120)
        for axes, draw, letter in zip(figure.subplots(2, 2).flat, panels, "abcd", strict=True):
            draw(axes, found)
            axes.legend(fontsize=6, loc="lower right" if draw is _friction else "best")
            panel_letter(axes, letter)
    return figure


def _dead_time(axes: Axes, found: AxisComparison) -> None:
    for (term, profile), color in zip(found.profiles.items(), (_PUBLISHED, _OTHER, _OURS), strict=False):
        axes.plot(
            DEAD_TIMES_s * MILLI, 100.0 * profile, color=color, label=WORDS[term] if term == "" else f"… {WORDS[term]}"
        )
    late = found.intervals.get("dead_time_s")
    if late:
        axes.axvspan(late.low * MILLI, late.high * MILLI, color=_OURS, alpha=0.2, lw=0, label="95 % interval")
    axes.set_xlabel("dead time (ms)")
    axes.set_ylabel(f"force error, {found.train.name} (%)")


def _friction(axes: Axes, found: AxisComparison) -> None:
    best = found.chosen.fit
    for run, color in zip((found.train, found.tests[0]), (TRUTH, _PUBLISHED), strict=True):
        speed, force = _braking(run, best)
        edges = np.linspace(speed.min(), speed.max(), _BINS)
        where = np.digitize(speed, edges)
        bins = [number for number in range(1, _BINS) if np.sum(where == number) >= 5]
        middle = [float(speed[where == number].mean()) for number in bins]
        mean = [float(force[where == number].mean()) for number in bins]
        spread = [float(force[where == number].std()) for number in bins]
        axes.errorbar(middle, mean, spread, fmt="o", ms=2.2, lw=0.6, color=color, label=f"{run.name}, mean and SD")
    speed = np.linspace(speed.min(), speed.max(), 801)
    still = Motion(np.full_like(speed, best.shape.middle_m), speed, np.zeros_like(speed))
    axes.plot(speed, _friction_of(best, still), color=_OURS, label="chosen model, mid-path")
    axes.plot(speed, _friction_of(found.rungs[0].fit, still), color=INK, lw=0.6, ls="--", label="published model")
    axes.set_xlabel("speed (m/s)")
    axes.set_ylabel("force less mass × acceleration (N)")


def _braking(run: AxisRun, fit: Fit) -> tuple[Vector, Vector]:
    """Return speed, and force less mass times acceleration [rows]."""
    rows = run.rows
    force = rows.force_N(fit.shape.dead_time_s) - fit.coefficients["mass_kg"] * rows.column("mass_kg", fit.shape)
    lost = len(run.time_s) - len(rows.motion.speed_m_per_s)
    whole = np.concatenate((np.zeros(lost), rows.motion.speed_m_per_s))
    return run.row(whole), force


def _friction_of(fit: Fit, motion: Motion) -> Vector:
    law = fit.law._replace(ripple=False)
    parts = [fit.coefficients[name] * column(name, motion, fit.shape) for name in terms(law)]
    return np.asarray(np.sum(parts, axis=0))


def _ripple(axes: Axes, found: AxisComparison) -> None:
    for told, color, width in zip(found.evidence, (INK, _PUBLISHED), (0.9, 0.5), strict=False):
        waves = told.ripple.cycles_per_m * 1e-3
        axes.plot(waves, told.ripple.amplitude_N, color=color, lw=width, label=f"{told.run}, both directions")
    train = found.evidence[0].ripple
    axes.plot(waves, train.backward_N, color=_OTHER, lw=0.5, label=f"{found.train.name}, backward")
    axes.set_xlabel("cycles per mm of path")
    axes.set_ylabel("amplitude of what is left (N)")


def _mass(axes: Axes, found: AxisComparison) -> None:
    later = axes.twinx()
    later.grid(visible=False)
    for told, color in zip(found.evidence, (INK, _PUBLISHED), strict=False):
        used = [band for band in told.bands if band.coherence >= MIN_COHERENCE]
        middle = [float(np.sqrt(band.from_Hz * band.to_Hz)) for band in used]
        axes.errorbar(
            middle, [band.mass_kg for band in used], [2.0 * band.relative_sd * band.mass_kg for band in used],
            fmt="o-", ms=2.5, lw=0.6, color=color, label=f"{told.run}, mass",
        )  # fmt: skip
        delays = [band.delay_s * MILLI for band in used]
        later.plot(middle, delays, "x--", ms=3, lw=0.5, color=color)
        axes.plot([], [], "x--", ms=3, lw=0.5, color=color, label=f"{told.run}, delay")
    axes.set_xscale("log")
    axes.set_ylim(60.0, 110.0)
    later.set_ylim(0.0, 2.0)
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("force over acceleration (kg)")
    later.set_ylabel("delay of the force (ms)")


def open_loop_figure(found: AxisComparison) -> Figure:
    """Error of the position in open loop on the first test run, and the friction of each stroke in both runs."""
    test = found.tests[0]
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 62)
        left, right = figure.subplots(1, 2)
        shown = [(found.open_loops[0].fit, _PUBLISHED, "published model")]
        shown.append((found.chosen.fit, _OURS, "chosen inverse model"))
        shown.append((found.open_loop_chosen.fit, _OTHER, "fitted to the training run's position"))
        for fit, color, label in shown:
            error = position_error(test, fit) * MILLI
            left.plot(
                test.time_s, error, color=color, lw=0.8, label=f"{label}: {np.sqrt(np.mean(error**2)):.1f} mm RMS"
            )
        left.set_title(test.name)
        left.set_xlabel("time (s)")
        left.set_ylabel("error of the position (mm)")
        left.legend(fontsize=6)
        panel_letter(left, "a")
        strokes = next((told.strokes for told in found.evidence if told.run == test.name), ())
        for forward, marker in ((True, "^"), (False, "v")):
            own = [stroke for stroke in strokes if (stroke.speed_m_per_s > 0.0) == forward]
            more = [(abs(stroke.test_N) - abs(stroke.train_N)) for stroke in own]
            label = "forward" if forward else "backward"
            right.plot(
                [stroke.time_s for stroke in own], more, marker, color=INK, mfc="white" if forward else INK, label=label
            )
        right.axhline(0.0, color=INK, lw=0.5)
        right.set_xlabel("time of the stroke (s)")
        right.set_ylabel("friction, test more than train (N)")
        right.legend(fontsize=6)
        panel_letter(right, "b")
    return figure


def networks_figure(found: AxisComparison) -> Figure:
    """Error of the position in open loop during the fit of networks and of the law; training and first test run."""
    best = found.open_loop_chosen
    own = (best.train_rmse_m, best.test_rmse_m[0])
    with house_style():
        figure = new_figure(DOUBLE_COLUMN, 62)
        pair = figure.subplots(1, 2, sharey=True)
        for place, (axes, letter) in enumerate(zip(pair, "ab", strict=True)):
            for network, marker in zip(found.networks, cycle("os^vDx"), strict=False):
                errors = [(told.train_rmse_m, told.test_rmse_m[0])[place] * MILLI for told in network.told]
                steps = [told.steps for told in network.told]
                axes.plot(steps, errors, marker=marker, ms=2.2, lw=0.5, label=f"seed {network.seed}")
            axes.axhline(own[place] * MILLI, color=INK, lw=0.9, ls="--", label="law chosen by the training run")
            axes.set_yscale("log")
            axes.set_xlabel("steps of the network's fit")
            axes.set_title(f"{(found.train, found.tests[0])[place].name} ({('trains', 'test')[place]})")
            panel_letter(axes, letter)
        pair[0].set_ylabel("error of the position, RMS (mm)")
        handles, labels = pair[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(handles))
    return figure
