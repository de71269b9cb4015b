"""Common parts of the figures of a diagnosis: styles, compared simulations, run and part to show."""

import math
from collections.abc import Mapping

import numpy as np

from hil_forceps.diagnosis.result import Diagnosis, RunEvidence
from hil_forceps.report.style import Look
from hil_forceps.report.traces import Array

MEASURED = Look("measured", "#9a9a9a", "-", "o")
NOMINAL = Look("rig as given", "#aa4499", (0, (1, 1)), "^")
BASELINE = Look("parameters refitted", "#d55e00", (0, (4, 1.2)), "s")
EXTENDED = Look("with the effects named", "#0072b2", "-", "o")
FLOOR = Look("noise floor", "#222222", (0, (1.2, 1.2)), "x")
LOOKS = {"nominal": NOMINAL, "baseline": BASELINE, "extended": EXTENDED}

MIN_WINDOW_ROWS = 200
WINDOW_SHARE = 1 / 15  # of a run: short enough to show single reversals, long enough to contain one


def stages(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return the two simulations to compare, of "nominal", "baseline" and "extended"."""
    if diagnosis.effects:
        return ("baseline", "extended")
    return ("nominal", "baseline") if diagnosis.verdict == "parameters" else ("baseline",)


def simulated(run: RunEvidence, stage: str) -> Mapping[str, Array]:
    """Return the columns of a run as simulated at a stage."""
    columns: Mapping[str, Array] = getattr(run, stage)
    return columns


def channels(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return the channels measured and simulated in any run, in order of the error of the first stage."""
    names = [name for run in diagnosis.runs for name in run.baseline if name in run.measured and name != "time_s"]
    unique = list(dict.fromkeys(names))
    return tuple(sorted(unique, key=lambda name: -_worst(diagnosis, name)))


def residual(run: RunEvidence, stage: str, channel: str) -> Array | None:
    """Return measured less simulated; None if either is missing."""
    predicted = simulated(run, stage).get(channel)
    if predicted is None or channel not in run.measured:
        return None
    return np.asarray(run.measured[channel] - predicted, dtype=np.float64)


def rms(values: Array) -> float:
    """Root mean square of the finite values, 0 without any."""
    finite = values[np.isfinite(values)]
    return math.sqrt(float(np.mean(np.square(finite)))) if finite.size else 0.0


def floor_of(diagnosis: Diagnosis, channel: str) -> float | None:
    """Return the noise of a channel if it is known and not zero."""
    sd = diagnosis.noise_sd.get(channel)
    return sd if sd is not None and math.isfinite(sd) and sd > 0 else None


def telling_run(diagnosis: Diagnosis, *, held_out: bool | None = None) -> RunEvidence | None:
    """Return the run with the largest misfit relative to noise before extension; `held_out`: only of runs held out."""
    runs = [run for run in diagnosis.runs if len(run.time_s) > 1 and held_out in (None, run.held_out)]
    if not runs:
        return None
    names = channels(diagnosis)
    return max(runs, key=lambda run: max((_misfit(diagnosis, run, name) for name in names), default=0.0))


def telling_window(diagnosis: Diagnosis, run: RunEvidence) -> slice:
    """Return the rows of a run where its misfit, all channels over their noise together, is largest."""
    rows = len(run.time_s)
    width = min(max(int(rows * WINDOW_SHARE), MIN_WINDOW_ROWS), rows)
    total = np.zeros(rows)
    for channel in channels(diagnosis):
        left = residual(run, stages(diagnosis)[0], channel)
        if left is not None:
            unit = floor_of(diagnosis, channel) or rms(left) or 1.0
            total += np.where(np.isfinite(left), left / unit, 0.0) ** 2
    running = np.concatenate([[0.0], np.cumsum(total)])
    start = int(np.argmax(running[width:] - running[: rows + 1 - width]))
    return slice(start, start + width)


def _worst(diagnosis: Diagnosis, channel: str) -> float:
    return max((_misfit(diagnosis, run, channel) for run in diagnosis.runs), default=0.0)


def _misfit(diagnosis: Diagnosis, run: RunEvidence, channel: str) -> float:
    left = residual(run, stages(diagnosis)[0], channel)
    if left is None:
        return 0.0
    measured = run.measured[channel]
    unit = floor_of(diagnosis, channel) or rms(measured - np.mean(measured)) or 1.0
    return rms(left) / unit
