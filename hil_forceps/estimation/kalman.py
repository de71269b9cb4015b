"""Kalman filter on the whole two-inertia model with the load as a state: two hypotheses about the load, mixed.

A load that now and then steps isn't a random walk of one intensity: whatever follows a step fast is noisy in between.
So two filters run side by side. "Quiet": the load has only drifted. "Stepped": it has stepped within the last few
milliseconds; a step is put in where a hypothesis passes from quiet to stepped, and stays unknown in size until the
angles tell. Each sample weighs both by how well they foretold it; the estimate is the weighted mean.
(The interacting-multiple-model filter of Blom and Bar-Shalom, 1988, with the step on the transition.)

The motor torque of a sample was held over the interval that ends there, so the prediction over it is exact for any
stamps; its error (current noise, rounding) enters as noise of the input. The encoder's rounding is noise of the angle.
Coulomb friction is an input too: over each stretch of time what would bring the speeds at its end to zero, limited to
its levels. So it is the known level against the motion, and at a standstill it holds what it can.
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
    TORQUE_COLUMN,
    TORQUE_VAR,
    TURN_PER_LOAD,
    Constants,
    frictions_N_m,
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
# After so long without a sample nothing of a state is left that rest wouldn't tell as well.
_LONGEST_GAP_S = 0.25


@kernel
def mix(to_stay: float, stay: Vector, to_join: float, join: Vector) -> Vector:
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
    after = np.empty(_SIZE)
    half = np.zeros((5, 5))
    for i in range(5):
        mean = over[i, TORQUE_COLUMN] * torque_N_m
        for j in range(5):
            mean += over[i, j] * hypothesis[j]
            for m in range(5):
                half[i, m] += over[i, j] * hypothesis[5 + 5 * j + m]
        after[i] = mean
    motor, jaw = frictions_N_m(after[SPEED_M], after[SPEED_J], over, c[FRICTION_M], c[FRICTION_J])
    for i in range(LOAD):
        # At the jaw friction acts as the load does, but leaves the load itself alone.
        after[i] += over[i, LOAD] * jaw - over[i, TORQUE_COLUMN] * motor
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
    # What is left of the angle's own row cancels to nothing above when the angle is far better seen than foretold.
    left = angle_var / variance
    for j in range(5):
        after[5 + j] = left * predicted[5 + j]
        after[5 + 5 * j] = after[5 + j]
    return after, -0.5 * (innovation * innovation / variance + math.log(variance))


@kernel
def _stretches(dt_s: float, c: Constants) -> tuple[float, Matrix, Matrix]:
    """Return what part of an interval lies before the hold of its torque, that stretch, and the one after it.

    The part is 0 and the first stretch of no use where the torque was held all the time.
    """
    nominal = abs(dt_s - c[PERIOD]) < _SAME_INTERVAL_S
    lead_s = dt_s - c[HOLD]
    if lead_s <= _HOLD_TOLERANCE * c[HOLD]:
        held = held_stretch(c) if nominal and lead_s <= _SAME_INTERVAL_S else stretch(c, dt_s)
        return 0.0, held, held
    lead = lead_stretch(c) if nominal else stretch(c, lead_s)
    return lead_s / dt_s, lead, held_stretch(c)


@kernel
def _advance(
    hypothesis: Vector,
    moves_var: float,
    lead_part: float,
    lead: Matrix,
    held: Matrix,
    before_N_m: float,
    torque_N_m: float,
    c: Constants,
) -> Vector:
    """Return the hypothesis at the next sample, before its angle is seen; τ_w moves by `moves_var` until then.

    Before the hold the torque isn't known (the drive sends every n-th sample only, or samples were lost): it is taken
    halfway between the torques at both ends, with half their difference as its error.
    """
    if lead_part > 0.0:
        half_difference = 0.5 * (torque_N_m - before_N_m)
        lead_var = c[TORQUE_VAR] + half_difference * half_difference
        hypothesis = _predict(hypothesis, lead, before_N_m + half_difference, lead_var, lead_part * moves_var, c)
    return _predict(hypothesis, held, torque_N_m, c[TORQUE_VAR], (1.0 - lead_part) * moves_var, c)


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


@kernel
def step(state: State, c: Constants, time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """Return the state after a sample; the same state when its stamp isn't later than the last."""
    dt_s = (time_ns - state[TIME]) * 1e-9
    if dt_s <= 0.0:
        return state
    if dt_s > _LONGEST_GAP_S:
        return start(c, time_ns, theta_m_rad, motor_torque_N_m)
    steps = -math.expm1(-c[STEP_RATE] * dt_s)
    leaves = -math.expm1(-c[LEAVE_RATE] * dt_s)
    was_stepped = state[STEPPED_WEIGHT]
    was_quiet = 1.0 - was_stepped
    left = was_stepped * leaves
    stay = was_stepped - left
    # Whoever is quiet, or has just become so, may step.
    stepped = stay + (was_quiet + left) * steps
    quiet = (was_quiet + left) * (1.0 - steps)
    quiet_h, stepped_h = state[_QUIET:_STEPPED], state[_STEPPED:]
    joined = was_quiet * steps / stepped
    settled = mix(was_quiet / (was_quiet + left), quiet_h, left / (was_quiet + left), stepped_h)
    moving = mix(1.0 - joined, stepped_h, joined, quiet_h)
    # A step may follow another while the first is still told apart.
    fresh = (was_quiet + left) * steps / stepped
    resteps = -math.expm1(-c[RESTEP_RATE] * dt_s)
    drift_var = c[DRIFT] * dt_s
    step_var = c[STEP_VAR] * (fresh + (1.0 - fresh) * resteps)

    lead_part, lead, held = _stretches(dt_s, c)
    before = state[TORQUE]
    settled = _advance(settled, drift_var, lead_part, lead, held, before, motor_torque_N_m, c)
    moving = _advance(moving, drift_var + step_var, lead_part, lead, held, before, motor_torque_N_m, c)
    settled, settled_log = _correct(settled, theta_m_rad, c[ANGLE_VAR])
    moving, moving_log = _correct(moving, theta_m_rad, c[ANGLE_VAR])
    stepped = 1.0 / (1.0 + quiet / stepped * math.exp(settled_log - moving_log))
    return _assemble(time_ns, motor_torque_N_m, stepped, settled, moving, c)
