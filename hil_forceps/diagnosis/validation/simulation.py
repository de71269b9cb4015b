"""Runs simulated in closed loop beside their measurements: what figures show and what gains are reckoned with.

A run begins where the filter has forgotten its start, with the filter's state there. The drive reads the simulated
angle with the rounding that the encoder had in the run, so that both hunt alike. The load is that of its cell,
smoothed, or the filter's where there is none.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.evidence import Mapper, pass_all
from hil_forceps.diagnosis.preparation.command import on_lines
from hil_forceps.diagnosis.preparation.load_prior import posterior_draw
from hil_forceps.diagnosis.preparation.records import Record
from hil_forceps.diagnosis.state_space.advance import steps_in_row
from hil_forceps.diagnosis.state_space.layout import (
    COMMAND_ERROR,
    ENCODER,
    INTEGRAL_ERROR,
    JAW_ZERO,
    LOAD,
    RECORDED_STATES,
    THETA_J,
    THETA_M,
    Noise,
    Series,
)
from hil_forceps.diagnosis.state_space.passes import Passed
from hil_forceps.diagnosis.validation.heldout import DIVERGED_SPANS, Played
from hil_forceps.diagnosis.validation.rows import Rows
from hil_forceps.model import closed_loop
from hil_forceps.model.closed_loop import Channels, Inputs, Start
from hil_forceps.model.composition import Physics, encoder_rad
from hil_forceps.model.drive_law import KI, DriveState, drive_sample, law_vector, quantise
from hil_forceps.model.physics import State
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]

EDGE_SD = 10.0  # deviations of the load cell: what changes by more from row to row where a jump may be, jumps
EDGE_ROWS = 40  # behind a jump, by which its instant within the row is told


class Measured(NamedTuple):
    """A run in the three forms that validation needs."""

    run: Run
    record: Record
    rows: Rows  # what gains, figures and estimates take of it

    @property
    def driven_rad(self) -> Vector:
        """References, one for each sample of the drive."""
        return on_lines(self.rows.reference_rad, self.record.series.samples)


def measured(even: EvenRun, record: Record) -> Measured:
    """Return a run with its record; rows before the filter has forgotten the start don't count, nor do lost ones."""
    run, columns = even.run, even.run.columns
    time_s = even.begin_s + columns["time_s"] - columns["time_s"][0]
    channels: dict[str, Vector] = {
        name: columns[name] for name in ("theta_m_rad", "current_A", "theta_j_rad") if name in columns
    }
    weights = np.where(even.lost, 0.0, 1.0)
    weights[: record.settling_rows] = 0.0
    load = record.load_course_N_m if "tau_w_N_m" in columns else None
    reference = columns["theta_m_ref_rad"]
    rows = Rows(run.name, record.series.period_s, time_s, reference, channels, load, weights)
    return Measured(run, record, rows)


def play(runs: Sequence[Measured], rig: Rig, theta: Vector, mapper: Mapper) -> Played:
    """Simulate runs with a vector of parameters."""
    passes = pass_all([m.record for m in runs], theta, mapper)
    pairs = list(zip(runs, passes.runs, strict=True))
    channels = list(mapper(lambda pair: simulated(pair[0], pair[1], rig, theta, load_of(*pair)), pairs))
    return Played(channels, [run.course(passes.plant, before=False) for run in passes.runs])


def unknown_load_rms(runs: Sequence[Measured], rig: Rig, theta: Vector, noise: Noise, seed: int) -> dict[str, float]:
    """Return how far each channel is off where the load is as far off as its cell's noise leaves it; root mean square.

    The load is drawn once a run from what is left open of it.
    """
    squares: dict[str, float] = {}
    count = 0.0
    for place, (m, passed) in enumerate(zip(runs, pass_all([m.record for m in runs], theta, map).runs, strict=True)):
        if m.rows.tau_w_N_m is None:
            continue
        error = posterior_draw(np.random.default_rng([seed, place]), m.record.series, float(noise.deviation[1]) ** 2)
        load = load_of(m, passed)
        one, other = (simulated(m, passed, rig, theta, tried) for tried in (load, load + error))
        for name in one:
            off = float(m.rows.weights @ (one[name] - other[name]) ** 2)
            squares[name] = squares.get(name, 0.0) + off
        count += float(m.rows.weights.sum())
    return {name: math.sqrt(total / count) for name, total in squares.items()}


def load_of(m: Measured, passed: Passed) -> Vector:
    """Return the load that a run is simulated with (n)."""
    return passed.filtered.course[:, LOAD] if m.rows.tau_w_N_m is None else m.rows.tau_w_N_m


def simulated(m: Measured, passed: Passed, rig: Rig, theta: Vector, load_N_m: Vector) -> dict[str, Vector]:
    """Return the channels of a run as simulated; before the rows that count as measured."""
    simulation = simulation_of(m, passed, rig, theta, load_N_m)
    edges, fractions = simulation.inputs.edge_rows, simulation.inputs.edge_fractions.copy()
    shown = simulation.channels()
    if edges.size and "theta_m_rad" in m.rows.channels:
        # Where in its row a load jumps isn't recorded: what follows tells it, jump by jump.
        slope = 4.0 * (simulation.with_jumps_at(fractions + 0.25).channels().theta_m_rad - shown.theta_m_rad)
        misfit = m.rows.channels["theta_m_rad"][m.record.settling_rows :] - shown.theta_m_rad
        for place, row in enumerate(edges):
            behind = slice(row + 1, row + 1 + EDGE_ROWS)
            power = float(slope[behind] @ slope[behind])
            moved = float(slope[behind] @ misfit[behind]) / power if power > 0.0 else 0.0
            fractions[place] = min(max(0.5 + moved, 0.0), 1.0) if math.isfinite(moved) else 0.5
        shown = simulation.with_jumps_at(fractions).channels()
    found = {}
    first, zero = m.record.settling_rows, jaw_zero_rad(passed)
    for name, values in m.rows.channels.items():
        course = values.copy()
        course[first:] = getattr(shown, name) + (zero if name == "theta_j_rad" else 0.0)
        middle, span = float(values.mean()), DIVERGED_SPANS * max(float(np.ptp(values)), 1e-12)
        found[name] = np.nan_to_num(np.clip(course, middle - span, middle + span), nan=middle + span)
    return found


def jaw_zero_rad(passed: Passed) -> float:
    """Return the zero of the jaw's sensor in a run."""
    return float(passed.filtered.course[-1, JAW_ZERO])


class Simulation(NamedTuple):
    """What a run is simulated with, from the row on at which the filter has forgotten its start."""

    theta: Vector
    law: Vector
    inputs: Inputs
    start: Start
    substeps: int  # of a row
    samples: int  # of the drive in a row

    def with_jumps_at(self, fractions: Vector) -> "Simulation":
        """Return it with the load's jumps at these fractions of their rows."""
        return self._replace(inputs=self.inputs._replace(edge_fractions=fractions))

    def channels(self, count_rad: float = 0.0) -> Channels:
        """Return what its sensors show; `count_rad`: of the encoder, beside what the inputs say of its rounding."""
        return closed_loop.simulate(
            self.theta, self.law, count_rad, self.inputs, self.start, self.substeps, self.samples
        )


def simulation_of(m: Measured, passed: Passed, rig: Rig, theta: Vector, load_N_m: Vector) -> Simulation:
    """Return what simulates the rows of a run that count, with the encoder's rounding as it was there."""
    p, d, course = Physics(*theta.tolist()), passed.series, passed.filtered.course
    first, samples = m.record.settling_rows, d.samples
    angle = np.array([encoder_rad(p, at) for at in course[:, THETA_M]])
    counted = on_lines(angle, samples)
    if d.count_rad > 0.0:
        counted = np.array([quantise(at, d.count_rad) for at in counted])
    counted[::samples] = _counted_rad(m, d, counted[::samples])
    rounding = counted - on_lines(angle, samples)
    start = _start(rig, m, passed, m.driven_rad[: first * samples], counted[: first * samples])
    load = load_N_m[first:]
    edges = jumps(m.record.series, load, first)
    driven = m.driven_rad[first * samples :]
    middle = np.full(edges.size, 0.5)
    inputs = Inputs(m.rows.time_s[first:], driven, load, edges, middle, rounding[first * samples :])
    return Simulation(theta, law_vector(rig.require_drive()), inputs, start, steps_in_row(d.period_s), samples)


def _counted_rad(m: Measured, d: Series, predicted_rad: Vector) -> Vector:
    """Return what the encoder said at each row; where it is recorded late, `predicted_rad` at the end of the run."""
    if d.shifted_s[ENCODER] == 0.0:
        return m.run.columns["theta_m_rad"]
    return np.where(np.isfinite(d.encoder_rad), d.encoder_rad, predicted_rad)


def jumps(d: Series, load_N_m: Vector, first: int) -> NDArray[np.int64]:
    """Return the rows, from `first` on, in which a load that is given from there on jumps."""
    may_jump = d.load_jump_variance[first:-1] > 0.0
    return np.flatnonzero(may_jump & (np.abs(np.diff(load_N_m)) > EDGE_SD * math.sqrt(d.noise_variance[1])))


def _start(rig: Rig, m: Measured, passed: Passed, reference: Vector, counted: Vector) -> Start:
    """Return plant and drive at the first row that is simulated."""
    law, d, first = law_vector(rig.require_drive()), passed.series, m.record.settling_rows
    x = passed.filtered.course[first]
    drive = DriveState(d.first_integral_rad_s, float("nan"), 0.0, d.first_current_A)
    for aim, angle in zip(reference, counted, strict=True):
        drive = drive_sample(law, drive, float(aim), float(angle))
    if law[KI] > 0.0:
        error = COMMAND_ERROR if d.states == RECORDED_STATES else INTEGRAL_ERROR
        off = float(passed.filtered.course[-1, error]) / float(law[KI])
        drive = drive._replace(integral_rad_s=drive.integral_rad_s + off)
    current = float(passed.filtered.command_A[first * d.samples - 1])
    plant = State(x[THETA_M], x[THETA_M + 1], x[THETA_J], x[THETA_J + 1], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, current)
    return Start(plant, drive)
