"""Replicates of runs, simulated with a fitted model: the same references and loads, fresh noise of all sensors."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.preparation.records import Record
from hil_forceps.diagnosis.state_space.layout import CURRENT, JAW, LOAD_CELL, Noise
from hil_forceps.diagnosis.state_space.passes import Passed
from hil_forceps.diagnosis.validation.simulation import Measured, jaw_zero_rad, load_of, measured, simulation_of
from hil_forceps.model.closed_loop import Channels
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]

CONTACT_ROUNDS = 3  # of a fixed point, which converges if what the jaw touches is softer than the wire


def replicate(
    even: EvenRun, record: Record, passed: Passed, rig: Rig, theta: Vector, noise: Noise, rng: np.random.Generator
) -> EvenRun:
    """Return a run as simulated with a model, from the row on at which the filter has forgotten its start.

    `passed`: the measured run, filtered with the model. The simulated drive has its own counts of the encoder, so the
    motion is another one within a count.
    """
    m = measured(even, record)
    first, columns = record.settling_rows, even.run.columns
    shown = _channels(m, passed, rig, theta, rng)
    told = {
        "time_s": columns["time_s"][first:] - columns["time_s"][first],
        "theta_m_ref_rad": columns["theta_m_ref_rad"][first:],
        "theta_m_rad": shown.theta_m_rad,
        "current_A": _sensed(shown.current_A, noise, CURRENT, rng),
    }
    for channel, name, zero in ((JAW, "theta_j_rad", jaw_zero_rad(passed)), (LOAD_CELL, "tau_w_N_m", 0.0)):
        if name in columns:
            told[name] = _sensed(getattr(shown, name) + zero, noise, channel, rng)
    begin_s = even.begin_s + first * record.series.period_s
    return EvenRun(Run(even.name, told), even.lost[first:], begin_s, even.of)


def _channels(m: Measured, passed: Passed, rig: Rig, theta: Vector, rng: np.random.Generator) -> Channels:
    """Return a run as simulated; the load of what the jaw touches follows the jaw."""
    first, d = m.record.settling_rows, passed.series
    simulation = simulation_of(m, passed, rig, theta, load_of(m, passed))
    inputs = simulation.inputs._replace(encoder_error_rad=np.empty(0))
    if d.samples > 1:
        inputs = inputs._replace(reference_rad=_followed_rad(m.record, passed, rng)[first * d.samples :])
    stiffness, told = m.record.series.contact_stiffness[first:], inputs.tau_w_N_m
    shown = simulation._replace(inputs=inputs).channels(d.count_rad)
    for _ in range(CONTACT_ROUNDS if stiffness.any() else 0):
        further = shown.theta_j_rad + jaw_zero_rad(passed) - m.record.jaw_course_rad[first:]
        shown = simulation._replace(inputs=inputs._replace(tau_w_N_m=told + stiffness * further)).channels(d.count_rad)
    return shown


def _followed_rad(record: Record, passed: Passed, rng: np.random.Generator) -> Vector:
    """Return a reference for each sample of the drive, drawn by how likely the run's currents make each."""
    likely = passed.filtered.between.timing.cumsum(axis=1)
    chosen = np.sum(rng.random((likely.shape[0], 1)) * likely[:, -1:] > likely[:, :-1], axis=1)
    references = record.series.references_rad
    return np.asarray(references[np.arange(references.shape[0]), np.repeat(chosen, record.series.samples)])


def _sensed(values: Vector, noise: Noise, channel: int, rng: np.random.Generator) -> Vector:
    """Return what the sensor of a channel shows of values (n): with its noise, and in its steps."""
    white, kept = rng.standard_normal(values.size), float(noise.correlation[channel - 1])
    white[1:] *= np.sqrt(1.0 - kept * kept)
    shown = values + float(noise.deviation[channel - 1]) * lfilter([1.0], [1.0, -kept], white)
    step = float(noise.resolution[channel - 1])
    return np.asarray(np.rint(shown / step) * step if step > 0.0 else shown)
