"""A run once more, as a model would have given it: same references and load, sensors' noise drawn anew.

It begins where the filter has forgotten its start, with the filter's state there. The load is the smoothed one, and
where it jumps within a row is drawn. The drive counts on its own, between rows as well.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hil_forceps.data.run import Run
from hil_forceps.diagnosis.preparation.even_rows import EvenRun
from hil_forceps.diagnosis.preparation.records import Record
from hil_forceps.diagnosis.state_space.advance import STEPS
from hil_forceps.diagnosis.state_space.layout import JAW_ZERO, LOAD, Noise
from hil_forceps.diagnosis.state_space.passes import Passed
from hil_forceps.diagnosis.validation.simulation import begun, jumps, measured
from hil_forceps.model import closed_loop
from hil_forceps.model.closed_loop import Inputs
from hil_forceps.model.drive_law import law_vector, quantise
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]


def replica(
    even: EvenRun, record: Record, passed: Passed, rig: Rig, theta: Vector, noise: Noise, rng: np.random.Generator
) -> EvenRun:
    """Return a run simulated with parameters `theta`; ValueError where the simulation isn't finite."""
    m, d, first = measured(even, record), passed.series, record.settling_rows
    start = begun(rig, m, passed)
    load = _load_N_m(record, passed)[first:]
    edges = jumps(d, load, first)
    columns = {name: even.run.columns[name][first:] for name in ("time_s", "theta_m_ref_rad")}
    inputs = Inputs(m.rows.time_s[first:], m.driven_rad[first * d.samples :], load, edges, rng.random(edges.size))
    shown = closed_loop.simulate(theta, law_vector(rig.require_drive()), d.count_rad, inputs, start, STEPS, d.samples)
    angle = shown.theta_m_rad
    columns["theta_m_rad"] = np.array([quantise(at, d.count_rad) for at in angle]) if d.count_rad > 0.0 else angle
    zero = float(passed.filtered.course[-1, JAW_ZERO])
    sensed = (("theta_j_rad", shown.theta_j_rad + zero), ("tau_w_N_m", load), ("current_A", shown.current_A))
    for channel, (name, values) in enumerate(sensed):
        if name in even.run.columns:
            columns[name] = _noisy(values, noise, channel, rng)
    if not all(np.isfinite(values).all() for values in columns.values()):
        raise ValueError(f"{even.name}: the simulation left all bounds")
    return EvenRun(Run(even.name, columns), even.lost[first:], even.begin_s, even.of)


def _load_N_m(record: Record, passed: Passed) -> Vector:
    """Return the load as smoothed; the filter's where no cell and no stretch of the wire tells it."""
    if record.load_measured or record.load_course_N_m.any():
        return record.load_course_N_m
    return passed.filtered.course[:, LOAD]


def _noisy(values: Vector, noise: Noise, channel: int, rng: np.random.Generator) -> Vector:
    """Return a channel with noise of its sensor: first-order autoregressive, and in the sensor's steps."""
    deviation, correlation = float(noise.deviation[channel]), float(noise.correlation[channel])
    drawn = rng.standard_normal(values.size)
    if correlation != 0.0:
        drawn[0] /= math.sqrt(1.0 - correlation**2)
        drawn = math.sqrt(1.0 - correlation**2) * lfilter([1.0], [1.0, -correlation], drawn)
    step = float(noise.resolution[channel])
    shown = values + deviation * drawn
    return np.round(shown / step) * step if step > 0.0 else shown
