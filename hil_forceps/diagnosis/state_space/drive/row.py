"""The drive from a row to the next: its first sample, its nominal course, and what unseen counts make of it."""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.advance import Stepper, advance, expected_current_slope
from hil_forceps.diagnosis.state_space.covariance import forgotten
from hil_forceps.diagnosis.state_space.drive.between_rows import added
from hil_forceps.diagnosis.state_space.drive.sample import (
    Count,
    derivative_left,
    expected_count,
    sampled,
    sampled_covariance,
)
from hil_forceps.diagnosis.state_space.kernel import inlined, subroutine
from hil_forceps.diagnosis.state_space.layout import (
    BETWEEN,
    COMMAND_ERROR,
    COMMANDS_BETWEEN,
    CURRENT_NOISE,
    DERIVATIVE_ERROR,
    INTEGRAL_ERROR,
    LAW_STATES,
    MADE_BETWEEN,
    RECORDED_STATES,
    THETA_M,
    Filtered,
    Series,
    Work,
)
from hil_forceps.diagnosis.state_space.row_plant import acting_on
from hil_forceps.model.composition import Physics, encoder_rad
from hil_forceps.model.drive_law import LIMIT, DriveState, drive_sample, quantise
from hil_forceps.model.physics import State

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Flags = NDArray[np.bool_]


@inlined
def has_unseen_counts(d: Series, row: int) -> bool:
    """Tell whether the drive counts what no row shows from a row to the next, and the filter follows it."""
    unseen: bool = d.samples > 1 or (d.states > LAW_STATES and math.isnan(d.counted_rad[row]))
    return unseen


@inlined
def first_sample(
    p: Physics,
    d: Series,
    row: int,
    edge_variance: float,
    drive: DriveState,
    x: Vector,
    covariance: Matrix,
    work: Work,
    out: Filtered,
) -> DriveState:
    """Return the drive after its sample at a row, with what its command is and how well that is known.

    If the filter follows unseen counts, one of them here is that of the mean angle, and weighed behind this.
    """
    at = row * d.samples
    for i in range(BETWEEN, d.states):  # it is in the drive's law by now
        forgotten(covariance, i)
    count = Count(d.counted_rad[row], 0.0, 0.0)
    if math.isnan(d.counted_rad[row]) and d.states > LAW_STATES:
        work.angles_rad[0] = encoder_rad(p, x[THETA_M])
        work.counts_rad[0] = quantise(work.angles_rad[0], d.count_rad)
        count = Count(work.counts_rad[0], 0.0, 0.0)
    elif math.isnan(d.counted_rad[row]):
        deviation = math.sqrt(max(covariance[THETA_M, THETA_M], 0.0) + edge_variance)
        count = expected_count(encoder_rad(p, x[THETA_M]), deviation, d.count_rad)
    drive = drive_sample(d.law, drive, d.reference_rad[at], count.mean_rad)
    out.reacts[at], out.count_slope[row] = abs(drive.current_A) < d.law[LIMIT], count.slope
    if d.states > RECORDED_STATES:
        sampled_covariance(d.law, count.slope, count.variance, d.reference_variance[row], out.reacts[at], covariance)
        sampled(d.law, 0.0, out.reacts[at], x)
    out.command_A[at] = drive.current_A + x[COMMAND_ERROR]
    return drive


@subroutine
def nominal_row(
    p: Physics,
    d: Series,
    s: Stepper,
    row: int,
    free: tuple[bool, bool],
    plant: State,
    drive: DriveState,
    x: Vector,
    counts_rad: Vector,
    angles_rad: Vector,
    out: Filtered,
) -> tuple[State, DriveState]:
    """Return plant and drive a row on, as the filter's mean goes on without what the next row tells.

    Commands go to `out`, counts and encoder's angles at each sample to `counts_rad` and `angles_rad`.
    """
    first, derivative = row * d.samples, x[DERIVATIVE_ERROR] if d.states > RECORDED_STATES else 0.0
    acting = acting_on(p, d, row, x, out.variance[row], 0.0)
    for sample in range(d.samples):
        at = first + sample
        if sample > 0:
            angles_rad[sample] = encoder_rad(p, plant.theta_m_rad)
            counts_rad[sample] = quantise(angles_rad[sample], d.count_rad)
            drive = drive_sample(d.law, drive, d.reference_rad[at], counts_rad[sample])
            out.reacts[at] = abs(drive.current_A) < d.law[LIMIT]
            error_A = x[INTEGRAL_ERROR] + derivative_left(d.law, sample) * derivative if out.reacts[at] else 0.0
            out.command_A[at] = drive.current_A + error_A
        plant = advance(p, s, free[0], free[1], plant, acting, out.command_A, sample)
    return plant, drive


@inlined
def command_of_unseen(
    d: Series, row: int, sample: int, made: Vector, x: Vector, covariance: Matrix, out: Filtered
) -> None:
    """Add to a sample's command what unseen counts make of it; behind a row, the drive's errors act at it first."""
    at = row * d.samples + sample
    if sample > 0:
        sampled_covariance(d.law, 0.0, 0.0, 0.0, out.reacts[at], covariance)
        sampled(d.law, 0.0, out.reacts[at], x)
    if out.reacts[at]:
        added(covariance, COMMAND_ERROR, BETWEEN + sample)
        out.command_A[at] += made[sample]


@inlined
def note_current_slope(p: Physics, at: int, covariance: Matrix, out: Filtered) -> None:
    """Note the expected slope of the motor current over the command: 0 in the dead zone and at a limit."""
    deviation_A = math.sqrt(max(covariance[COMMAND_ERROR, COMMAND_ERROR], 0.0))
    slope = expected_current_slope(p, out.command_A[at], deviation_A)
    out.current_slope[at] = slope if out.reacts[at] else 0.0


@inlined
def measured_command_gain(p: Physics, d: Series, row: int, filtered: Filtered) -> float:
    """Return the change of a row's measured current for an error of the command before it."""
    slope = filtered.current_slope[row * d.samples - 1] if row > 0 else 1.0
    gain: float = (1.0 + p.current_gain_relative_error) * slope
    return gain


@inlined
def end_of_row(made: Vector, x: Vector, covariance: Matrix) -> None:
    """Let what unseen counts make go on in the drive's law."""
    for i in range(MADE_BETWEEN - COMMANDS_BETWEEN):
        added(covariance, INTEGRAL_ERROR + i, BETWEEN + COMMANDS_BETWEEN + i)
        x[INTEGRAL_ERROR + i] += made[COMMANDS_BETWEEN + i]


@inlined
def next_current(p: Physics, d: Series, row: int, x: Vector) -> float:
    """Return the motor's current [A] at the next row as its sensor shows it; NaN where that row is lost."""
    noise_A = x[CURRENT_NOISE] * d.noise_correlation[2]
    shown: float = (d.current_A[row + 1] - p.current_offset_offset_A - noise_A) / (1.0 + p.current_gain_relative_error)
    return shown
