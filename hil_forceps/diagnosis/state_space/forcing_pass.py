"""How the innovations of a pass answer to torques and sensor errors that are given row by row: many at once."""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.filter_pass import is_slack, noise_kept
from hil_forceps.diagnosis.state_space.kernel import inlined, kernel
from hil_forceps.diagnosis.state_space.layout import (
    CHANNELS,
    COMMAND_BIAS,
    CURRENT,
    CURRENT_NOISE,
    FRICTION_J,
    FRICTION_M,
    JAW,
    JAW_NOISE,
    JAW_ZERO,
    LOAD,
    LOAD_CELL,
    LOAD_NOISE,
    LOAD_SLOPE,
    PLANT_STATES,
    STATES,
    THETA_J,
    THETA_M,
    Filtered,
    Series,
)
from hil_forceps.diagnosis.state_space.response_pass import answer_of_contact
from hil_forceps.diagnosis.state_space.transition import friction_kept, transition
from hil_forceps.model.composition import Physics

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

COLUMNS_AT_ONCE = 32  # to spare memory
_COUPLED = COMMAND_BIAS + 1


@kernel
def forcing_pass(
    p: Physics,
    d: Series,
    weight: Matrix,
    gain: Matrix,
    course: Matrix,
    motor: Matrix,
    jaw: Matrix,
    shown: Matrix,
    out: Matrix,
) -> None:
    """Fill `out` (n × CHANNELS × m) with the change of the whitened innovations.

    `motor` and `jaw` (n × m): torques from row k to k + 1 in N m; `shown` (n × CHANNELS × m): errors of the sensors.
    """
    count = motor.shape[1]
    taut, slack = transition(p, d.period_s, True), transition(p, d.period_s, False)
    kept = noise_kept(d, friction_kept(d.period_s))
    x, after, change = np.zeros((STATES, count)), np.zeros((STATES, count)), np.zeros(count)
    was_m, was_j = True, True
    for row in range(d.encoder_rad.size):
        for place in range(CHANNELS):
            channel = (place + CURRENT) % CHANNELS
            _shown(channel, 1.0 + p.current_gain_relative_error, x, change)
            for m in range(count):
                change[m] += shown[row, channel, m]
                out[row, channel, m] = -weight[row, channel] * change[m]
            for i in range(STATES):
                per = gain[row, channel, i]
                if per != 0.0:
                    for m in range(count):
                        x[i, m] -= per * change[m]
        if not (d.friction_free_m[row] and was_m):
            x[FRICTION_M] = 0.0
        if not (d.friction_free_j[row] and was_j):
            x[FRICTION_J] = 0.0
        was_m, was_j = d.friction_free_m[row], d.friction_free_j[row]
        f = slack if is_slack(p, course[row]) else taut
        _carried(f, x, motor[row], jaw[row], d.period_s, kept, after)
        answer_of_contact(f, d.contact_stiffness[row], d.period_s, x[THETA_J], after)
        x, after = after, x


@inlined
def _shown(channel: int, gain: float, x: Matrix, out: Vector) -> None:
    """Fill `out` with what a channel shows of changes of the state."""
    for m in range(out.size):
        if channel == CURRENT:
            out[m] = gain * x[COMMAND_BIAS, m] + x[CURRENT_NOISE, m]
        elif channel == JAW:
            out[m] = x[THETA_J, m] + x[JAW_ZERO, m] + x[JAW_NOISE, m]
        elif channel == LOAD_CELL:
            out[m] = x[LOAD, m] + x[LOAD_NOISE, m]
        else:
            out[m] = x[THETA_M, m]


@inlined
def _carried(f: Matrix, x: Matrix, motor: Vector, jaw: Vector, period_s: float, kept: Vector, after: Matrix) -> None:
    """Fill `after` with changes of the state a row on."""
    count = motor.size
    for i in range(PLANT_STATES):
        by_motor, by_jaw = f[i, FRICTION_M], f[i, FRICTION_J]
        for m in range(count):
            # Friction brakes, and so does a load: a torque is what takes from them.
            after[i, m] = -by_motor * motor[m] - by_jaw * jaw[m]
        for j in range(_COUPLED):
            per = f[i, j]
            for m in range(count):
                after[i, m] += per * x[j, m]
    for i in range(PLANT_STATES, STATES):
        for m in range(count):
            after[i, m] = kept[i] * x[i, m]
    for m in range(count):
        after[LOAD, m] += period_s * x[LOAD_SLOPE, m]


def forced(p: Physics, d: Series, f: Filtered, motor: Matrix, jaw: Matrix, shown: Matrix) -> Matrix:
    """Return the change of a run's whitened innovations (n × CHANNELS × m)."""
    out = np.empty((motor.shape[0], CHANNELS, motor.shape[1]))
    forcing_pass(p, d, f.weight, f.gain, f.course, motor, jaw, shown, out)
    return out
