"""How the innovations of a pass answer to torques and sensor errors that are given row by row: many at once."""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.drive.row import measured_command_gain
from hil_forceps.diagnosis.state_space.kernel import vectorised_run_kernel, with_work_arrays
from hil_forceps.diagnosis.state_space.layout import (
    CHANNELS,
    COMMAND_ERROR,
    CURRENT,
    CURRENT_NOISE,
    ENCODER,
    FRICTION_J,
    FRICTION_M,
    JAW,
    JAW_NOISE,
    JAW_ZERO,
    LOAD,
    LOAD_CELL,
    LOAD_NOISE,
    LOAD_SLOPE,
    OMEGA_J,
    OMEGA_M,
    PLANT_STATES,
    RECORDED_STATES,
    THETA_J,
    THETA_M,
    Filtered,
    Series,
)
from hil_forceps.diagnosis.state_space.measurement import late_s
from hil_forceps.diagnosis.state_space.response_pass import answers_of_contact, sample_answers
from hil_forceps.diagnosis.state_space.row_plant import end_friction, is_slack, noise_kept
from hil_forceps.diagnosis.state_space.transition import transition
from hil_forceps.model.composition import Physics

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

COLUMNS_AT_ONCE = 32  # to spare memory


@vectorised_run_kernel
def forcing_pass(
    p: Physics,
    d: Series,
    filtered: Filtered,
    motor: Matrix,
    jaw: Matrix,
    shown: Matrix,
    out: Matrix,
) -> None:
    """Fill `out` (n × CHANNELS × m) with the change of the whitened innovations.

    `motor` and `jaw` (n × m): torques from row k to k + 1 in N m; `shown` (n × CHANNELS × m): errors of the sensors.
    """
    count, sample_s = motor.shape[1], d.period_s / d.samples
    taut, slack = transition(p, sample_s, True), transition(p, sample_s, False)
    kept, last = noise_kept(d, 1), d.encoder_rad.size - 1
    x, after, change = np.zeros((d.states, count)), np.zeros((d.states, count)), np.zeros(count)
    for row in range(d.encoder_rad.size):
        for place in range(CHANNELS):
            channel = (place + CURRENT) % CHANNELS
            _shown(channel, measured_command_gain(p, d, row, filtered), late_s(p, d, channel), x, change)
            for m in range(count):
                change[m] += shown[row, channel, m]
                out[row, channel, m] = -filtered.weight[row, channel] * change[m]
            for i in range(d.states):
                per = filtered.gain[row, channel, i]
                if per != 0.0:
                    for m in range(count):
                        x[i, m] -= per * change[m]
        end_friction(d, row, x)
        f = slack if is_slack(p, filtered.course[row]) else taut
        for sample in range(d.samples):
            if d.states > RECORDED_STATES:
                sample_answers(d, filtered, row, sample, shown[row, ENCODER], shown[min(row + 1, last), CURRENT], x)
            slope = filtered.current_slope[row * d.samples + sample]
            _carried(f, x, motor[row], jaw[row], sample_s, kept, slope, after)
            answers_of_contact(f, d.contact_stiffness[row], sample_s, x[THETA_J], after)
            x, after = after, x


@with_work_arrays
def _shown(channel: int, gain: float, late: float, x: Matrix, out: Vector) -> None:
    """Fill `out` with what a channel shows of changes of the state."""
    slope = OMEGA_M if channel == ENCODER else OMEGA_J if channel == JAW else LOAD_SLOPE
    for m in range(out.size):
        if channel == CURRENT:
            out[m] = gain * x[COMMAND_ERROR, m] + x[CURRENT_NOISE, m]
        elif channel == JAW:
            out[m] = x[THETA_J, m] + x[JAW_ZERO, m] + x[JAW_NOISE, m]
        elif channel == LOAD_CELL:
            out[m] = x[LOAD, m] + x[LOAD_NOISE, m]
        else:
            out[m] = x[THETA_M, m]
    if late != 0.0 and channel != CURRENT:
        for m in range(out.size):
            out[m] -= late * x[slope, m]


@with_work_arrays
def _carried(
    f: Matrix,
    x: Matrix,
    motor: Vector,
    jaw: Vector,
    period_s: float,
    kept: Vector,
    current_slope: float,
    after: Matrix,
) -> None:
    """Fill `after` with changes of the state a row on; `current_slope` as in `Filtered`."""
    count = motor.size
    for i in range(PLANT_STATES):
        by_motor, by_jaw, by_command = f[i, FRICTION_M], f[i, FRICTION_J], f[i, COMMAND_ERROR] * current_slope
        f_0, f_1, f_2, f_3, f_4, f_5, f_6, f_7 = f[i, 0], f[i, 1], f[i, 2], f[i, 3], f[i, 4], f[i, 5], f[i, 6], f[i, 7]
        for m in range(count):
            # Friction brakes, and so does a load: a torque is what takes from them. The coupled states one by one, for
            # compilers that don't unroll a loop around this one.
            total = -by_motor * motor[m] - by_jaw * jaw[m] + f_0 * x[0, m] + f_1 * x[1, m] + f_2 * x[2, m]
            total += f_3 * x[3, m] + f_4 * x[4, m] + f_5 * x[5, m] + f_6 * x[6, m] + f_7 * x[7, m]
            after[i, m] = total + by_command * x[COMMAND_ERROR, m]
    for i in range(PLANT_STATES, x.shape[0]):
        for m in range(count):
            after[i, m] = kept[i] * x[i, m]
    for m in range(count):
        after[LOAD, m] += period_s * x[LOAD_SLOPE, m]


def forced(p: Physics, d: Series, f: Filtered, motor: Matrix, jaw: Matrix, shown: Matrix) -> Matrix:
    """Return the change of a run's whitened innovations (n × CHANNELS × m)."""
    out = np.empty((motor.shape[0], CHANNELS, motor.shape[1]))
    forcing_pass(p, d, f, motor, jaw, shown, out)
    return out
