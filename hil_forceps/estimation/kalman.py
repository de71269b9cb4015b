"""Kalman filter on the whole two-inertia model with the load as a state: two hypotheses about the load, mixed.

A load that now and then steps isn't a random walk of one intensity: whatever follows a step fast is noisy in between.
So two filters run side by side. "Quiet": the load has only drifted. "Stepped": it has stepped within the last few
milliseconds; a step is put in where a hypothesis passes from quiet to stepped, and stays unknown in size until the
angles tell. Each sample weighs both by how well they foretold it; the estimate is the weighted mean.
(The interacting-multiple-model filter of Blom and Bar-Shalom, 1988, with the step on the transition.)

The motor torque of a sample was held over the interval that ends there, so the prediction over it is exact for any
stamps; its error (current noise, rounding) enters as noise of the input. The encoder's rounding is noise of the angle.
Coulomb friction is a known input times the expected sign of the speed.
"""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.estimation.interface import ELONGATION, TAU_W, State
from hil_forceps.estimation.kalman_model import (
    ANGLE_J,
    ANGLE_M,
    ANGLE_VAR,
    DRIFT,
    FRICTION_J,
    FRICTION_M,
    HOLD,
    LEAVE_RATE,
    LOAD,
    PERIOD,
    RADIUS_J,
    RADIUS_M,
    RESTEP_RATE,
    SPEED_J,
    SPEED_M,
    STEP_COLUMNS,
    STEP_RATE,
    STEP_VAR,
    STOP_J,
    STOP_M,
    TORQUE_COLUMN,
    TORQUE_VAR,
    TURN_PER_LOAD,
    Constants,
    expected_sign,
    held_stretch,
    lead_stretch,
    stretch,
)
from hil_forceps.model.kernel import kernel
from hil_forceps.model.two_inertia import Matrix

Vector = NDArray[np.float64]

TIME, TORQUE, STEPPED_WEIGHT = range(3)  # then TAU_W and ELONGATION of `interface`
_QUIET = 5
# A hypothesis: mean (5) and covariance (25).
_SIZE = 30
_STEPPED = _QUIET + _SIZE
STATE_SIZE = _STEPPED + _SIZE

# Speeds at the first sample: "at rest" as far as a person can tell.
_START_SPEED_VAR = 1.0
# A sample whose interval is longer than the hold by more than this part of it has a stretch of unknown torque before.
_HOLD_TOLERANCE = 0.5
_SAME_INTERVAL_S = 1e-10


@kernel
def _mix(to_stay: float, stay: Vector, to_join: float, join: Vector) -> Vector:
    """Return one normal distribution with mean and covariance of the weighted two (weights sum to 1)."""
    mixed = np.empty(_SIZE)
    for i in range(5):
        mixed[i] = to_stay * stay[i] + to_join * join[i]
    both = to_stay * to_join
    for i in range(5):
        for j in range(5):
            at = 5 + 5 * i + j
            spread = both * (stay[i] - join[i]) * (stay[j] - join[j])
            mixed[at] = to_stay * stay[at] + to_join * join[at] + spread
    return mixed


@kernel
def _predict(
    hypothesis: Vector, over: Matrix, torque_N_m: float, torque_var: float, step_var: float, c: Constants
) -> Vector:
    """Return the hypothesis a stretch of time on; `step_var` is the variance of what τ_w moves by within."""
    sign_m = expected_sign(hypothesis[SPEED_M], hypothesis[5 + 6 * SPEED_M] + c[STOP_M])
    sign_j = expected_sign(hypothesis[SPEED_J], hypothesis[5 + 6 * SPEED_J] + c[STOP_J])
    net = torque_N_m - c[FRICTION_M] * sign_m
    jaw = c[FRICTION_J] * sign_j
    after = np.empty(_SIZE)
    half = np.zeros((5, 5))
    for i in range(5):
        # Friction at the jaw acts as the load does, but leaves the load itself alone.
        mean = over[i, TORQUE_COLUMN] * net
        if i != LOAD:
            mean += over[i, LOAD] * jaw
        for j in range(5):
            mean += over[i, j] * hypothesis[j]
            for m in range(5):
                half[i, m] += over[i, j] * hypothesis[5 + 5 * j + m]
        after[i] = mean
    for i in range(5):
        for j in range(i, 5):
            variance = step_var * over[i, STEP_COLUMNS + j]
            variance += torque_var * over[i, TORQUE_COLUMN] * over[j, TORQUE_COLUMN]
            for m in range(5):
                variance += half[i, m] * over[j, m]
            after[5 + 5 * i + j] = variance
            after[5 + 5 * j + i] = variance
    return after


@kernel
def _correct(predicted: Vector, theta_m_rad: float, angle_var: float) -> tuple[Vector, float]:
    """Return the hypothesis after the angle was seen, and the logarithm of how well it was foretold."""
    innovation = theta_m_rad - predicted[ANGLE_M]
    variance = predicted[5] + angle_var
    after = np.empty(_SIZE)
    for i in range(5):
        gain = predicted[5 + i] / variance
        after[i] = predicted[i] + gain * innovation
        for j in range(5):
            after[5 + 5 * i + j] = predicted[5 + 5 * i + j] - gain * predicted[5 + j]
    return after, -0.5 * (innovation * innovation / variance + math.log(variance))


@kernel
def _advance(
    hypothesis: Vector, step_var: float, dt_s: float, before_N_m: float, torque_N_m: float, c: Constants
) -> Vector:
    """Return the hypothesis at the next sample, before its angle is seen.

    Over a gap the torque of the lost samples isn't known: it is taken halfway between the torques at both ends, with
    half their difference as its error.
    """
    nominal = abs(dt_s - c[PERIOD]) < _SAME_INTERVAL_S
    hold_s = c[HOLD]
    lead_s = dt_s - hold_s
    drift_var = c[DRIFT] * dt_s
    if lead_s <= _HOLD_TOLERANCE * hold_s:
        over = held_stretch(c) if nominal and lead_s <= _SAME_INTERVAL_S else stretch(c, dt_s)
        return _predict(hypothesis, over, torque_N_m, c[TORQUE_VAR], drift_var + step_var, c)
    share = lead_s / dt_s
    half_difference = 0.5 * (torque_N_m - before_N_m)
    lead_var = c[TORQUE_VAR] + half_difference * half_difference
    over = lead_stretch(c) if nominal else stretch(c, lead_s)
    middle = _predict(hypothesis, over, before_N_m + half_difference, lead_var, share * (drift_var + step_var), c)
    return _predict(middle, held_stretch(c), torque_N_m, c[TORQUE_VAR], (1.0 - share) * (drift_var + step_var), c)


@kernel
def _assemble(
    time_ns: int, torque_N_m: float, stepped: float, quiet_h: Vector, stepped_h: Vector, c: Constants
) -> State:
    state = np.empty(STATE_SIZE)
    state[TIME] = time_ns
    state[TORQUE] = torque_N_m
    state[STEPPED_WEIGHT] = stepped
    state[_QUIET:_STEPPED] = quiet_h
    state[_STEPPED:] = stepped_h
    quiet = 1.0 - stepped
    state[TAU_W] = quiet * quiet_h[LOAD] + stepped * stepped_h[LOAD]
    theta_m = quiet * quiet_h[ANGLE_M] + stepped * stepped_h[ANGLE_M]
    theta_j = quiet * quiet_h[ANGLE_J] + stepped * stepped_h[ANGLE_J]
    state[ELONGATION] = c[RADIUS_M] * theta_m - c[RADIUS_J] * theta_j
    return state


@kernel
def step(state: State, c: Constants, time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """Return the state after a sample; the same state when its stamp isn't later than the last."""
    dt_s = (time_ns - state[TIME]) * 1e-9
    if dt_s <= 0.0:
        return state
    steps = -math.expm1(-c[STEP_RATE] * dt_s)
    leaves = -math.expm1(-c[LEAVE_RATE] * dt_s)
    was_stepped = state[STEPPED_WEIGHT]
    stepped = steps * (1.0 - was_stepped) + (1.0 - leaves) * was_stepped
    quiet = 1.0 - stepped
    quiet_h, stepped_h = state[_QUIET:_STEPPED], state[_STEPPED:]
    settled = _mix((1.0 - steps) * (1.0 - was_stepped) / quiet, quiet_h, leaves * was_stepped / quiet, stepped_h)
    fresh = steps * (1.0 - was_stepped) / stepped
    moving = _mix(1.0 - fresh, stepped_h, fresh, quiet_h)
    # A step may follow another while the first is still told apart.
    resteps = -math.expm1(-c[RESTEP_RATE] * dt_s)
    step_var = c[STEP_VAR] * (fresh + (1.0 - fresh) * resteps)

    settled = _advance(settled, 0.0, dt_s, state[TORQUE], motor_torque_N_m, c)
    moving = _advance(moving, step_var, dt_s, state[TORQUE], motor_torque_N_m, c)
    settled, settled_log = _correct(settled, theta_m_rad, c[ANGLE_VAR])
    moving, moving_log = _correct(moving, theta_m_rad, c[ANGLE_VAR])
    stepped = 1.0 / (1.0 + quiet / stepped * math.exp(settled_log - moving_log))
    return _assemble(time_ns, motor_torque_N_m, stepped, settled, moving, c)


@kernel
def start(c: Constants, time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """Return the state of a forceps at rest: the motor's torque is what the wire carries, give or take a step."""
    ratio = c[RADIUS_M] / c[RADIUS_J]
    load = motor_torque_N_m / ratio
    hypothesis = np.zeros(_SIZE)
    hypothesis[ANGLE_M] = theta_m_rad
    hypothesis[ANGLE_J] = ratio * theta_m_rad - c[TURN_PER_LOAD] * load
    hypothesis[LOAD] = load
    # At rest the jaw goes with the motor, and a load stretches the wire: two independent errors, one column each.
    for column, variance in (
        (np.array([1.0, 0.0, ratio, 0.0, 0.0]), c[ANGLE_VAR]),
        (np.array([0.0, 0.0, -c[TURN_PER_LOAD], 0.0, 1.0]), c[STEP_VAR]),
    ):
        for i in range(5):
            for j in range(5):
                hypothesis[5 + 5 * i + j] += variance * column[i] * column[j]
    hypothesis[5 + 6 * SPEED_M] = _START_SPEED_VAR
    hypothesis[5 + 6 * SPEED_J] = _START_SPEED_VAR
    return _assemble(time_ns, motor_torque_N_m, 0.5, hypothesis, hypothesis, c)
