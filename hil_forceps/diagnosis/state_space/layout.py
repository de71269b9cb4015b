"""Places of states and measurements, and what the filter takes of one run."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Mask = NDArray[np.bool_]

# States.
THETA_M, OMEGA_M, THETA_J, OMEGA_J = 0, 1, 2, 3
LOAD, LOAD_SLOPE = 4, 5  # τ_w [N m], and its slope [N m/s]
FRICTION_M, FRICTION_J = 6, 7  # of dry friction from its mean [N m], where a mass may stick; 0 where it slides
COMMAND_ERROR = 8  # of the current that the drive commands [A], from what is computed of recorded counts
COUPLED = COMMAND_ERROR + 1  # states that plant and load a row on depend on come first
JAW_ZERO = 9  # of the jaw sensor [rad]
LOAD_NOISE, JAW_NOISE, CURRENT_NOISE = 10, 11, 12  # coloured noise of the sensors
RECORDED_STATES = 13  # where rows show all that the drive counted: `COMMAND_ERROR` is its integral's, for all of a run
# What makes `COMMAND_ERROR` of a drive that counts where no row shows it: errors of its integral and of its derivative
# [A], and of its last count [rad].
INTEGRAL_ERROR, DERIVATIVE_ERROR, COUNT_ERROR = 13, 14, 15
LAW_STATES = 16  # where rows are lost
# What counts that no row shows make until the next row: of up to four commands [A], and of the three errors behind
# them.
BETWEEN = 16
COMMANDS_BETWEEN = 4
MADE_BETWEEN = COMMANDS_BETWEEN + 3
NOT_CONDITIONED = -1.0  # in place of a variance: the next row's current hasn't been used to tell the counts before it
STATES = BETWEEN + MADE_BETWEEN
PLANT_STATES = 4
# Measurements.
ENCODER, JAW, LOAD_CELL, CURRENT = 0, 1, 2, 3
CHANNELS = 4
# Columns of a course beside the state behind the measurements of a row: what was predicted of the row before them.
PREDICTED_THETA_M, PREDICTED_OMEGA_M, PREDICTED_THETA_J, PREDICTED_OMEGA_J = 23, 24, 25, 26
PREDICTED_LOAD_SLOPE, PREDICTED_CURRENT, CURRENT_BEFORE = 27, 28, 29
ELASTIC_SLOPE = 30  # of the load from this row to the next [N m/s], by what the jaw touches
ELONGATION_DEVIATION = 31  # of the wire [m], behind the measurements: how uncertain it is
COURSE = 32


class Noise(NamedTuple):
    """Noise of the sensors: jaw, load cell, current."""

    deviation: Vector  # 3
    correlation: Vector  # 3, from row to row; 0: white
    resolution: Vector  # 3: steps that values come in, where these are coarser than the noise; else 0


class Switching(NamedTuple):
    """What a pass decided row by row; taken from one, the next decides nothing and is smooth in the parameters."""

    given: bool  # else the pass decides
    doubtful: NDArray[np.int64]  # n: a speed comes near zero though its mass was taken to slide; 1 motor, 2 jaw, 3 both
    surprised: Mask  # n: an innovation that chance doesn't give opens the load's slope


class Series(NamedTuple):
    """What the filter takes of one run; n rows, equally spaced."""

    period_s: float  # of the rows
    begin_s: float  # of the first row: what drifts does so since the start of a run
    count_rad: float  # of the encoder, 0 for an ideal one
    encoder_variance: Vector  # n [rad²]: of the edges of counts, or of an ideal encoder
    encoder_rad: Vector  # n, NaN where lost
    shifted_s: Vector  # CHANNELS: how much later than each row the channel was recorded: some rows
    counted_rad: Vector  # n: what the drive counted at each row; NaN where none shows it
    jaw_rad: Vector  # n, NaN where not measured
    load_N_m: Vector  # n, NaN where not measured
    current_A: Vector  # n, NaN where lost
    states: int  # RECORDED_STATES, LAW_STATES or STATES: how many the filter follows
    samples: int  # of the drive in a row
    law: Vector  # of the drive (`model.drive_law.law_vector`)
    first_integral_rad_s: float  # of the drive's law, at the first row
    first_current_A: float
    reference_rad: Vector  # n · samples: the mean of `references_rad` by `timing`
    reference_variance: Vector  # n [rad²]: of the one at a row; 0 but where rows are lost
    references_rad: Matrix  # n · samples × 3: what the drive may have followed
    timing: Matrix  # n × 3: how likely it followed each, from each row to the next
    command_variance: Vector  # n [A²]: of the mean of the commands over a row
    integral_variance: Vector  # n [A²]: of what a row adds to the error of the integral
    friction_free_m: Mask  # n: from row k to k + 1 the motor may stick
    friction_free_j: Mask  # n
    fading_rows: int  # over which the wire's slowest mode dies away
    friction_level_N_m: Matrix  # n × 2, motor and jaw: of what wanders there; 0: less than the load leaves open
    contact_stiffness: Vector  # n [N m/rad]: how the load answers to the jaw's angle from row k to k + 1
    load_slope_variance: Vector  # n [(N m/s)²]: of the change of slope at row k
    load_jump_variance: Vector  # n [(N m)²]: of a jump between row k and k + 1
    load_surprise_variance: float  # [(N m/s)²]: of the slope behind an innovation that chance doesn't give
    switching: Switching
    noise_variance: Vector  # 3: jaw, load cell, current, all of it
    noise_correlation: Vector  # 3, from row to row; 0: white
    resolution: Vector  # 3: steps of values that are coarser than the noise; a value is an interval then
    speed_variance: Vector  # 2 [(rad/s)²]: what the integration of a row leaves, motor and jaw
    first_state: Vector  # states
    first_variance: Vector  # states


class Between(NamedTuple):
    """What a pass found of the drive's samples between rows; n is 0 where there are none."""

    directions: NDArray[np.float32]  # n × 2 × COUPLED: of the state; along each, the counts hang on a unit normal value
    pull: NDArray[np.float32]  # n × 2 × LAW_STATES: how the state is moved against a change along each
    made: NDArray[np.float32]  # n × 2 × MADE_BETWEEN: what the counts make of a change along each
    by_current: NDArray[np.float32]  # n × STATES: how the state is moved if the next row's current is more, per ampere
    timing: Matrix  # n × 3: how likely each reference was, given the next row's current
    prior_variance: Vector  # n [A²]: of the last command, before the next row's current told of it; or NOT_CONDITIONED
    current_variance: Vector  # n [A²]: of the next row's current where all counts are known


class Filtered(NamedTuple):
    """One pass over a run: (n × CHANNELS) unless said otherwise."""

    weight: Matrix  # root of the information of a measurement about its prediction
    residual: Matrix  # score of a measurement over `weight`: a whitened innovation
    log_likelihood: Matrix
    gain: NDArray[np.float32]  # n × CHANNELS × states: how a measurement moves the state, per change of it
    course: Matrix  # n × COURSE
    variance: Matrix  # n × states: of the state behind the measurements
    command_A: Vector  # n · samples, one behind the other: the first of row k acts from row k on
    count_slope: Vector  # n: how the drive's count at a row follows the angle, on the mean; 0 where it is known
    reacts: Mask  # n · samples: the drive's command is within its limit
    current_slope: Vector  # n · samples: expected slope of the motor current over the command
    between: Between
    doubtful: NDArray[np.int64]  # n, as in `Switching`
    surprised: Mask  # n


class Work(NamedTuple):
    """Arrays that each row is worked out in; made once for a run, for most of what fills them can make none."""

    covariance: Matrix  # states²
    along: Vector  # states: the covariance of the state and what a channel shows
    shown: Vector  # states: that of the state and a current between rows
    counts_rad: Vector  # samples: of the nominal course behind the row
    angles_rad: Vector  # samples: of the encoder there
    made: Vector  # MADE_BETWEEN: what counts between this row and the next make, on the mean
    f: Matrix  # F over a row, stiffened by what the jaw touches
    f_sample: Matrix  # F over a sample of the drive, likewise


def undecided_switching(rows: int) -> Switching:
    """Return a switching that leaves all to the pass."""
    return Switching(False, np.zeros(rows, dtype=np.int64), np.zeros(rows, dtype=np.bool_))
