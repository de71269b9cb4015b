"""The figures of a diagnosis with their captions, each drawn on demand."""

import base64
import io
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure

from hil_forceps.diagnosis.error_rates import FALSE_ALARMS
from hil_forceps.diagnosis.result import Diagnosis, RunEvidence
from hil_forceps.report.diagnosis.figures.evidence import (
    balances_figure,
    candidates_figure,
    gain_figure,
    ladder_figure,
    shifts_figure,
)
from hil_forceps.report.diagnosis.figures.residuals import loops_figure, spectra_figure, variables_figure
from hil_forceps.report.diagnosis.figures.traces import (
    estimated_in,
    estimates_figure,
    residual_time_figure,
    traces_figure,
)
from hil_forceps.report.diagnosis.figures.view import LOOKS, channels, stages, telling_run
from hil_forceps.report.diagnosis.names import quantity
from hil_forceps.report.diagnosis.words import percent
from hil_forceps.report.style import house_style


class Panel(NamedTuple):
    """One figure of the page."""

    name: str  # of its file
    caption: str
    draw: Callable[[], Figure | None]  # None: the data are not sufficient for the figure


def panels(diagnosis: Diagnosis) -> list[Panel]:
    """Return the figures of this diagnosis, in the order of the page."""
    found: list[Panel] = []
    run = telling_run(diagnosis)
    names = channels(diagnosis)
    if run is not None and names:
        found += _of_runs(diagnosis, run, names)
    if diagnosis.balances:
        caption = (
            "Lack of fit at each balance, before and after: root of the decrease of χ² by the best smooth curves, "
            f"relative to the threshold, which chance exceeds in {percent(FALSE_ALARMS)} of data sets."
        )
        found.append(Panel("balances", caption, lambda: balances_figure(diagnosis)))
    if diagnosis.candidates:
        caption = (
            "Decrease of χ² when an entry of the catalogue is added to the model, for each step of the selection. "
            f"The mark is the threshold, which chance exceeds in {percent(FALSE_ALARMS)} of data sets, the whole "
            "catalogue together."
        )
        found.append(Panel("candidates", caption, lambda: candidates_figure(diagnosis)))
    if diagnosis.ladder:
        caption = (
            "The ladder: error of each channel with the known parameters alone and after each entry that was added, "
            "refitted each time. Dashed: noise floor."
        )
        found.append(Panel("ladder", caption, lambda: ladder_figure(diagnosis)))
    if diagnosis.parameter_shifts:
        caption = "Parameters of the rig, fitted against assumed. Grey: the interval contains the assumed value."
        found.append(Panel("parameters", caption, lambda: shifts_figure(diagnosis)))
    if diagnosis.gain:
        caption = (
            "Runs held out: (a) error before, after and at the noise floor, relative to the error "
            "before; (b) share of the squared error above the floor that is explained, with its 95 % interval."
        )
        found.append(Panel("gain", caption, lambda: gain_figure(diagnosis)))
    held_out = telling_run(diagnosis, held_out=True)
    if held_out is not None and held_out is not run and names:
        caption = f"Held-out run {held_out.name}: used neither for fitting nor for selection. Lines as above."
        found.append(Panel("held_out", caption, lambda: traces_figure(diagnosis, held_out)))
    estimated = next((one for one in (held_out, run, *diagnosis.runs) if one and estimated_in(one)), None)
    if estimated is not None:
        caption = f"Estimates in {estimated.name} with the model before and after, and their errors."
        found.append(Panel("estimates", caption, lambda: estimates_figure(diagnosis, estimated)))
    return found


def svg_image(figure: Figure, caption: str) -> str:
    """Return the figure as an HTML image with its SVG; the same figure gives the same bytes."""
    stream = io.BytesIO()
    with house_style():
        mpl.rcParams["svg.hashsalt"] = "hil-forceps"
        if figure.get_layout_engine() is not None:
            # lay out once and switch the engine off, which would draw everything again
            figure.draw_without_rendering()
            figure.set_layout_engine("none")
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    data = base64.b64encode(stream.getvalue()).decode("ascii")
    return f'<img alt="{caption}" src="data:image/svg+xml;base64,{data}">'


def _of_runs(diagnosis: Diagnosis, run: RunEvidence, names: tuple[str, ...]) -> list[Panel]:
    shown = stages(diagnosis)
    words = [f"{LOOKS[stage].label} ({word})" for stage, word in zip(shown, ("before", "after"), strict=False)]
    compared = " and ".join(words) if len(shown) > 1 else LOOKS[shown[0]].label
    given = "" if "nominal" in shown else "the rig as given, "
    density = "density before" if len(shown) > 1 else "density"
    traces = (
        f"Run {run.name}, the one with the largest misfit: measured, {given}{compared}. Below each "
        "channel its residual, measured less simulated. The right column enlarges the part marked yellow on the left."
    )
    over_time = f"Residuals of all runs over time, {compared}. Dotted: range of 95 % of pure noise."
    over = (
        f"over variables that may cause it, all runs: {compared}. Grey: {density}; lines: mean with its 95 % "
        "interval. The mean of pure noise is zero everywhere."
    )
    spectra = f"Amplitude density of the residuals, {compared}; a residual that is white noise lies on the floor."
    return [
        Panel("measured_simulated", traces, lambda: traces_figure(diagnosis, run)),
        Panel("residual_time", over_time, lambda: residual_time_figure(diagnosis)),
        *(
            Panel(
                f"residual_{name}",
                f"Residual of the {quantity(name).words} {over}",
                partial(variables_figure, diagnosis, name),
            )
            for name in names
        ),
        Panel("loops", f"Loops of run {run.name}: measured, {compared}.", lambda: loops_figure(diagnosis, run)),
        Panel("spectra", spectra, lambda: spectra_figure(diagnosis)),
    ]
