"""One pass of the filter over a run.

Where a mass slides, its dry friction is what the model says. Where it may stick, friction is only known to lie within
its level: it is a state that wanders there, and those rows say nothing of the parameters (`passes.counting`).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.advance import Stepper, advance, stepper
from hil_forceps.diagnosis.state_space.covariance import disturbed, moved
from hil_forceps.diagnosis.state_space.drive.between_rows import collapse
from hil_forceps.diagnosis.state_space.drive.row import (
    command_of_unseen,
    end_of_row,
    first_sample,
    has_unseen_counts,
    next_current,
    nominal_row,
    note_current_slope,
)
from hil_forceps.diagnosis.state_space.kernel import inlined, returning_arrays, run_kernel, subroutine
from hil_forceps.diagnosis.state_space.layout import (
    CHANNELS,
    COUPLED,
    COURSE,
    CURRENT_BEFORE,
    ELASTIC_SLOPE,
    ELONGATION_DEVIATION,
    FRICTION_M,
    LAW_STATES,
    LOAD,
    LOAD_SLOPE,
    MADE_BETWEEN,
    OMEGA_J,
    OMEGA_M,
    PLANT_STATES,
    PREDICTED_CURRENT,
    PREDICTED_LOAD_SLOPE,
    PREDICTED_OMEGA_J,
    PREDICTED_OMEGA_M,
    PREDICTED_THETA_J,
    PREDICTED_THETA_M,
    THETA_J,
    THETA_M,
    Between,
    Filtered,
    Series,
    Work,
)
from hil_forceps.diagnosis.state_space.memory import (
    Memory,
    beginning,
    elongation_deviation_m,
    following,
    no_memory,
    sure_ways,
)
from hil_forceps.diagnosis.state_space.row_friction import (
    begin_friction,
    open_friction,
    sliding_deviations,
    usual_row_of,
)
from hil_forceps.diagnosis.state_space.row_measurements import sticks_at, take_measurements
from hil_forceps.diagnosis.state_space.row_plant import acting_on, first_plant, is_slack, noise_kept
from hil_forceps.diagnosis.state_space.transition import elastic_share, jump_covariance, stiffened, transition
from hil_forceps.model.composition import Physics
from hil_forceps.model.drive_law import DriveState
from hil_forceps.model.physics import State

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class Linear(NamedTuple):
    """The linear part of a plant: over a row, and over a sample of the drive."""

    taut: Matrix
    slack: Matrix
    taut_sample: Matrix
    slack_sample: Matrix
    jump: Matrix  # what a jump of the load within a row brings
    kept: Vector  # of each state beyond the plant's
    kept_sample: Vector


@returning_arrays
def _work(d: Series, f: Matrix) -> Work:
    n = d.states
    return Work(
        np.empty((n, n)),
        np.empty(n),
        np.empty(n),
        np.zeros(d.samples),
        np.zeros(d.samples),
        np.zeros(MADE_BETWEEN),
        np.empty_like(f),
        np.empty_like(f),
    )


@returning_arrays
def _linear(p: Physics, d: Series) -> Linear:
    sample_s = d.period_s / d.samples
    return Linear(
        transition(p, d.period_s, True),
        transition(p, d.period_s, False),
        transition(p, sample_s, True),
        transition(p, sample_s, False),
        jump_covariance(p, d.period_s),
        noise_kept(d, d.samples),
        noise_kept(d, 1),
    )


@returning_arrays
def _transitions(linear: Linear, slack: bool) -> tuple[Matrix, Matrix]:
    """Return F over a row, and over a sample of the drive."""
    if slack:
        return linear.slack, linear.slack_sample
    return linear.taut, linear.taut_sample


@returning_arrays
def _beside_contact(stiffness: float, work: Work, f: Matrix, f_sample: Matrix) -> tuple[Matrix, Matrix]:
    """Return the same two where the jaw touches something of this stiffness, 0 for none."""
    if stiffness > 0.0:
        return work.f, work.f_sample
    return f, f_sample


@inlined
def _carry(d: Series, plant: State, kept: Vector, elastic_slope: float, x: Vector) -> None:
    """Carry the state's mean to the next row, where the plant is as it came there."""
    for i in range(PLANT_STATES, d.states):
        x[i] *= kept[i]
    x[LOAD] += d.period_s * (x[LOAD_SLOPE] + elastic_slope)
    x[THETA_M], x[OMEGA_M] = plant.theta_m_rad, plant.omega_m_rad_per_s
    x[THETA_J], x[OMEGA_J] = plant.theta_j_rad, plant.omega_j_rad_per_s


@inlined
def _note_state(row: int, x: Vector, covariance: Matrix, out: Filtered) -> None:
    for i in range(x.size):
        out.course[row, i], out.variance[row, i] = x[i], covariance[i, i]


@run_kernel
def filter_pass(p: Physics, d: Series, usual_row: int, out: Filtered) -> None:
    """Fill `out`; `usual_row` as `usual_row_of` returns it."""
    s, linear = stepper(p, d.period_s, d.samples), _linear(p, d)
    x, covariance, work = d.first_state.copy(), np.diag(d.first_variance), _work(d, linear.taut)
    for mass in range(2):
        covariance[FRICTION_M + mass, FRICTION_M + mass] = d.friction_level_N_m[0, mass] ** 2
    plant, memory = first_plant(d), no_memory(p, d.first_state)
    drive = DriveState(d.first_integral_rad_s, math.nan, 0.0, d.first_current_A)
    edge_variance = d.encoder_variance.min()
    before_A = plant.current_A
    was = (True, True)
    considered, calm_rows = np.zeros(d.states, dtype=np.bool_), 0
    usual = sliding_deviations(p, d, usual_row, linear.taut, linear.jump, linear.kept)
    for row in range(d.encoder_rad.size):
        _note_prediction(out.course, row, x, plant.current_A, before_A)
        sticks = sticks_at(d, row, row > 0 and out.doubtful[row - 1] > 0)
        calm_rows = 0 if sticks else calm_rows + 1
        calm = calm_rows > d.fading_rows
        now_A = plant.current_A
        surprised = take_measurements(
            p, d, row, now_A, before_A, x, covariance, linear.taut, sticks, calm, considered, work, out
        )
        out.surprised[row] = d.switching.surprised[row] if d.switching.given else surprised
        if out.surprised[row]:
            covariance[LOAD_SLOPE, LOAD_SLOPE] += d.load_surprise_variance
        was = begin_friction(d, row, was, x, covariance)
        _note_state(row, x, covariance, out)
        if row == d.encoder_rad.size - 1:
            break
        before_A = now_A
        f, f_sample = _transitions(linear, is_slack(p, x))
        drive = first_sample(p, d, row, edge_variance, drive, x, covariance, work, out)
        elastic_slope, unseen = 0.0, has_unseen_counts(d, row)
        if d.contact_stiffness[row] > 0.0 or unseen:
            drive, elastic_slope = _look_ahead(
                p, d, s, row, was, f, f_sample, edge_variance, plant, memory, drive, x, covariance, work, out
            )
            f, f_sample = _beside_contact(d.contact_stiffness[row], work, f, f_sample)
        out.course[row, ELASTIC_SLOPE] = elastic_slope
        out.course[row, ELONGATION_DEVIATION] = elongation_deviation_m(p, covariance)
        sure = sure_ways(d, row, out.variance[row], out.course[row, ELONGATION_DEVIATION])
        memory = following(p, memory, x, sure)
        plant = beginning(p, memory, plant, x, sure)
        acting = acting_on(p, d, row, x, out.variance[row], elastic_slope)
        for sample in range(d.samples):
            if unseen:
                command_of_unseen(d, row, sample, work.made, x, covariance, out)
            note_current_slope(p, row * d.samples + sample, covariance, out)
            plant = advance(p, s, was[0], was[1], plant, acting, out.command_A, sample)
            moved(
                f_sample, covariance, linear.kept_sample, out.current_slope[row * d.samples + sample], work.covariance
            )
        if unseen:
            end_of_row(work.made, x, covariance)
        disturbed(covariance, d, row, f, linear.jump, p.K_t)
        now, ahead = out.variance[row], (plant.omega_m_rad_per_s, plant.omega_j_rad_per_s)
        out.doubtful[row] = open_friction(d, row, was, x, ahead, now, usual, f, linear.kept[FRICTION_M], covariance)
        _carry(d, plant, linear.kept, elastic_slope, x)


@subroutine
def _look_ahead(
    p: Physics,
    d: Series,
    s: Stepper,
    row: int,
    free: tuple[bool, bool],
    f: Matrix,
    f_sample: Matrix,
    edge_variance: float,
    plant: State,
    memory: Memory,
    drive: DriveState,
    x: Vector,
    covariance: Matrix,
    work: Work,
    out: Filtered,
) -> tuple[DriveState, float]:
    """Return what a first try of the row tells: the drive behind it, and the slope of the load that the jaw touches.

    In `work` are what unseen counts make and, where the jaw touches something, F stiffened by it. What is told of the
    counts is in state and covariance then.
    """
    stiffness, elastic_slope = d.contact_stiffness[row], 0.0
    sure = sure_ways(d, row, out.variance[row], elongation_deviation_m(p, covariance))
    begin = beginning(p, following(p, memory, x, sure), plant, x, sure)
    there, drive = nominal_row(p, d, s, row, free, begin, drive, x, work.counts_rad, work.angles_rad, out)
    if stiffness > 0.0:
        elastic_slope = elastic_share(f, stiffness, d.period_s) * (there.theta_j_rad - x[THETA_J])
        stiffened(f, stiffness, d.period_s, work.f)
        stiffened(f_sample, stiffness, d.period_s / d.samples, work.f_sample)
        f_sample = work.f_sample
    if has_unseen_counts(d, row):
        shown_A = next_current(p, d, row, x) - there.current_A
        collapse(
            p,
            d,
            row,
            f_sample,
            out.reacts[row * d.samples + d.samples - 1],
            work.counts_rad,
            work.angles_rad,
            shown_A,
            edge_variance,
            x,
            covariance,
            work.made,
            out.between,
        )
        _note_state(row, x, covariance, out)
    return drive, elastic_slope


@subroutine
def _note_prediction(course: Matrix, row: int, x: Vector, current_A: float, before_A: float) -> None:
    course[row, PREDICTED_THETA_M], course[row, PREDICTED_OMEGA_M] = x[THETA_M], x[OMEGA_M]
    course[row, PREDICTED_THETA_J], course[row, PREDICTED_OMEGA_J] = x[THETA_J], x[OMEGA_J]
    course[row, PREDICTED_LOAD_SLOPE], course[row, PREDICTED_CURRENT] = x[LOAD_SLOPE], current_A
    course[row, CURRENT_BEFORE] = before_A


def filter_run(p: Physics, d: Series) -> Filtered:
    """Return one pass over a run."""
    out = empty_filtered(d)
    filter_pass(p, d, usual_row_of(d), out)
    return out


def empty_filtered(d: Series) -> Filtered:
    """Return room for a pass over a run."""
    n = d.encoder_rad.size
    between = n if d.states > LAW_STATES else 0
    return Filtered(
        np.zeros((n, CHANNELS)),
        np.zeros((n, CHANNELS)),
        np.zeros((n, CHANNELS)),
        np.zeros((n, CHANNELS, d.states), dtype=np.float32),
        np.zeros((n, COURSE)),
        np.zeros((n, d.states)),
        np.zeros(n * d.samples),
        np.zeros(n),
        np.zeros(n * d.samples, dtype=np.bool_),
        np.ones(n * d.samples),
        Between(
            np.zeros((between, 2, COUPLED), dtype=np.float32),
            np.zeros((between, 2, LAW_STATES), dtype=np.float32),
            np.zeros((between, 2, MADE_BETWEEN), dtype=np.float32),
            np.zeros((between, d.states), dtype=np.float32),
            np.zeros((between, 3)),
            np.zeros(between),
            np.zeros(between),
        ),
        np.zeros(n, dtype=np.int64),
        np.zeros(n, dtype=np.bool_),
    )
