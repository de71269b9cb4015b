"""Kalman filter on the whole two-inertia model with the load as a state: three hypotheses about the load, mixed.

A load that steps now and then isn't a random walk of one intensity: a filter that follows a step fast is noisy in
between. So three filters run in parallel. "Quiet": the load has only drifted. "Fresh": it has stepped just now, by an
unknown amount. "Settling": it stepped a few milliseconds ago, and the response of the wire since then tells by how
much. Each sample weights them by the likelihood of their predictions; the estimate is the weighted mean. "Fresh" soon
passes into "settling" and is entered from both others, so it is ready for the next step while the last one is still
settling. (The interacting-multiple-model filter of Blom and Bar-Shalom, 1988, with the step on the transition.)

The motor torque of a sample was held over the interval that ends there, so the prediction over it is exact for any
stamps. Its error (current noise, rounding) is noise of the input. The encoder's rounding is noise of the angle. Coulomb
friction is an input, too: over each stretch of time the torques that would bring the speeds at its end to zero, limited
to their levels. So friction has its level in motion, and at standstill holds as far as its level allows.
"""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.estimation.algorithms import kalman_model
from hil_forceps.estimation.algorithms.kalman_model import (
    ANGLE_J,
    ANGLE_M,
    ANGLE_VAR,
    DRIFT,
    FRICTION_J,
    FRICTION_M,
    HOLD,
    LOAD,
    PERIOD,
    QUIET_RATE,
    RADIUS_J,
    RADIUS_M,
    RESTEP_RATE,
    SETTLE_RATE,
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
from hil_forceps.estimation.interface import ELONGATION, TAU_W, Algorithm, Estimator, State, estimator_of_kernels
from hil_forceps.estimation.kernel import kernel, returning_arrays, subroutine, with_work_arrays
from hil_forceps.estimation.wire import WIRE_ANGLE_RAD, WIRE_CURRENT_A
from hil_forceps.model.linear.two_inertia import Matrix
from hil_forceps.rig.schema import Rig

Vector = NDArray[np.float64]

TIME, TORQUE, FRESH_WEIGHT = range(3)  # then TAU_W and ELONGATION of `interface`
SETTLING_WEIGHT = 5
# A hypothesis: mean (5) and covariance (25).
_SIZE = 30
_QUIET = 6
_FRESH = _QUIET + _SIZE
_SETTLING = _FRESH + _SIZE
STATE_SIZE = _SETTLING + _SIZE
_PREDICTED_SIZE = _SIZE + 25  # a hypothesis, and an intermediate product of its covariance, in one array

# Variance of the speeds at the first sample, taken as at rest.
_START_SPEED_VAR_rad2_per_s2 = 1.0
# Of a hold: an interval that exceeds it by more has a stretch of unknown torque before it.
_MAX_HOLD_EXCESS_SHARE = 0.5
_MAX_INTERVAL_DIFFERENCE_S = 1e-10
# After a longer gap the state holds no more than a start at rest.
_MAX_GAP_S = 0.25
# A thousand standard deviations for every hypothesis: the angle has jumped (an encoder that was reset, a wrong sample).
# The filter starts again, as it does after NaN.
_MAX_NORMALISED_INNOVATION_SQUARED = 1e6
# No hypothesis is given up: a weight of zero would stay zero.
_MIN_WEIGHT = 1e-12


@kernel
def mix(mixed: Vector, to_stay: float, stay: Vector, to_join: float, join: Vector) -> None:
    """Write to `mixed` one normal distribution with mean and covariance of the weighted two (weights sum to 1)."""
    for i in range(5):
        mixed[i] = to_stay * stay[i] + to_join * join[i]
    both = to_stay * to_join
    for i in range(5):
        for j in range(5):
            at = 5 + 5 * i + j
            spread = both * (stay[i] - join[i]) * (stay[j] - join[j])
            mixed[at] = to_stay * stay[at] + to_join * join[at] + spread


@subroutine
def _predict(
    after: Vector,
    hypothesis: Vector,
    over: Matrix,
    torque_N_m: float,
    torque_var: float,
    step_var: float,
    c: Constants,
) -> None:
    """Write to `after` the hypothesis after a stretch of time; `step_var`: variance of the change of τ_w within it."""
    half = after[_SIZE:]
    for i in range(5):
        mean = over[i, TORQUE_COLUMN] * torque_N_m
        for m in range(5):
            half[5 * i + m] = 0.0
        for j in range(5):
            mean += over[i, j] * hypothesis[j]
            for m in range(5):
                half[5 * i + m] += over[i, j] * hypothesis[5 + 5 * j + m]
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
                variance += half[5 * i + m] * over[j, m]
            after[5 + 5 * i + j] = variance
            after[5 + 5 * j + i] = variance


@subroutine
def _correct(after: Vector, predicted: Vector, theta_m_rad: float, angle_var: float) -> tuple[float, float]:
    """Write to `after` the hypothesis given the angle; return the normalised innovation squared and log likelihood."""
    innovation = theta_m_rad - predicted[ANGLE_M]
    variance = max(0.0, predicted[5]) + angle_var
    for i in range(5):
        gain = predicted[5 + i] / variance
        after[i] = predicted[i] + gain * innovation
        for j in range(5):
            after[5 + 5 * i + j] = predicted[5 + 5 * i + j] - gain * predicted[5 + j]
    # The angle's own row is computed apart: the difference above cancels if the measurement is far better than the
    # prediction.
    left = angle_var / variance
    for j in range(5):
        after[5 + j] = left * predicted[5 + j]
        after[5 + 5 * j] = after[5 + j]
    # Rounding after impossible jumps must not leave a negative variance.
    for i in range(5):
        after[5 + 6 * i] = max(0.0, after[5 + 6 * i])
    off = innovation * innovation / variance
    return off, -0.5 * (off + math.log(variance))


@returning_arrays
def _stretches(dt_s: float, c: Constants) -> tuple[float, Matrix, Matrix]:
    """Return the share of an interval before the hold of its torque, the stretch before it, and that of the hold.

    The share is 0, and the first stretch unused, if the torque was held all the time.
    """
    nominal = abs(dt_s - c[PERIOD]) < _MAX_INTERVAL_DIFFERENCE_S
    lead_s = dt_s - c[HOLD]
    if lead_s <= _MAX_HOLD_EXCESS_SHARE * c[HOLD]:
        held = held_stretch(c) if nominal and lead_s <= _MAX_INTERVAL_DIFFERENCE_S else stretch(c, dt_s)
        return 0.0, held, held
    lead = lead_stretch(c) if nominal else stretch(c, lead_s)
    return lead_s / dt_s, lead, held_stretch(c)


@with_work_arrays
def _advance(
    predicted: Vector,
    hypothesis: Vector,
    moves_var: float,
    lead_part: float,
    lead: Matrix,
    held: Matrix,
    before_N_m: float,
    torque_N_m: float,
    c: Constants,
) -> None:
    """Write to `predicted` the hypothesis at the next sample, before its angle; τ_w changes with variance `moves_var`.

    Before the hold the torque is unknown (the drive sends only every n-th sample, or samples were lost): it is taken as
    the mean of the torques at both ends, with half their difference as its standard deviation.
    """
    if lead_part > 0.0:
        half_difference = 0.5 * (torque_N_m - before_N_m)
        lead_var = c[TORQUE_VAR] + half_difference * half_difference
        _predict(predicted, hypothesis, lead, before_N_m + half_difference, lead_var, lead_part * moves_var, c)
        hypothesis[:] = predicted[:_SIZE]
    _predict(predicted, hypothesis, held, torque_N_m, c[TORQUE_VAR], (1.0 - lead_part) * moves_var, c)


@kernel
def _tell(state: State, time_ns: int, torque_N_m: float, weights: tuple[float, float, float], c: Constants) -> None:
    """Write time, torque, weights and estimate to a state whose hypotheses are complete."""
    quiet, fresh, settling = state[_QUIET:_FRESH], state[_FRESH:_SETTLING], state[_SETTLING:]
    state[TIME] = time_ns
    state[TORQUE] = torque_N_m
    state[FRESH_WEIGHT] = weights[1]
    state[SETTLING_WEIGHT] = weights[2]
    state[TAU_W] = weights[0] * quiet[LOAD] + weights[1] * fresh[LOAD] + weights[2] * settling[LOAD]
    theta_m = weights[0] * quiet[ANGLE_M] + weights[1] * fresh[ANGLE_M] + weights[2] * settling[ANGLE_M]
    theta_j = weights[0] * quiet[ANGLE_J] + weights[1] * fresh[ANGLE_J] + weights[2] * settling[ANGLE_J]
    state[ELONGATION] = c[RADIUS_M] * theta_m - c[RADIUS_J] * theta_j


@kernel
def start(c: Constants, time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """Return the state of a forceps at rest: the wire carries the motor's torque, with the variance of a step."""
    ratio = c[RADIUS_M] / c[RADIUS_J]
    load = motor_torque_N_m / ratio
    hypothesis = np.zeros(_SIZE)
    hypothesis[ANGLE_M] = theta_m_rad
    hypothesis[ANGLE_J] = ratio * theta_m_rad - c[TURN_PER_LOAD] * load
    hypothesis[LOAD] = load
    # Two independent errors, a column each: at rest the jaw follows the motor, and a load stretches the wire.
    for column, variance in (
        (np.array([1.0, 0.0, ratio, 0.0, 0.0]), c[ANGLE_VAR]),
        (np.array([0.0, 0.0, -c[TURN_PER_LOAD], 0.0, 1.0]), c[STEP_VAR]),
    ):
        for i in range(5):
            for j in range(5):
                hypothesis[5 + 5 * i + j] += variance * column[i] * column[j]
    hypothesis[5 + 6 * SPEED_M] = _START_SPEED_VAR_rad2_per_s2
    hypothesis[5 + 6 * SPEED_J] = _START_SPEED_VAR_rad2_per_s2
    state = np.empty(STATE_SIZE)
    state[_QUIET:_FRESH] = hypothesis
    state[_FRESH:_SETTLING] = hypothesis
    state[_SETTLING:] = hypothesis
    _tell(state, time_ns, motor_torque_N_m, (0.5, 0.0, 0.5), c)
    return state


@kernel
def _age(
    after: State, state: State, dt_s: float, stepped: Vector, c: Constants
) -> tuple[tuple[float, float, float], float]:
    """Write to `after` the hypotheses after an interval in which the load may have stepped.

    Return their weights, and the share of "fresh" that is new. `stepped`: room for one hypothesis.
    """
    was_fresh, was_settling = state[FRESH_WEIGHT], state[SETTLING_WEIGHT]
    was_quiet = 1.0 - was_fresh - was_settling
    quiet, fresh, settling = after[_QUIET:_FRESH], after[_FRESH:_SETTLING], after[_SETTLING:]
    # Fresh becomes settling, settling becomes quiet.
    ages = -math.expm1(-c[SETTLE_RATE] * dt_s) * was_fresh
    rests = -math.expm1(-c[QUIET_RATE] * dt_s) * was_settling
    to_quiet, to_settling = was_quiet + rests, was_settling - rests + ages
    mix(quiet, was_quiet / to_quiet, state[_QUIET:_FRESH], rests / to_quiet, state[_SETTLING:])
    stays = (was_settling - rests) / to_settling
    mix(settling, stays, state[_SETTLING:], ages / to_settling, state[_FRESH:_SETTLING])
    # The load steps from either of them.
    from_quiet = -math.expm1(-c[STEP_RATE] * dt_s) * to_quiet
    from_settling = -math.expm1(-c[RESTEP_RATE] * dt_s) * to_settling
    new = from_quiet + from_settling
    to_fresh = was_fresh - ages + new
    mix(stepped, from_quiet / new, quiet, from_settling / new, settling)
    mix(fresh, 1.0 - new / to_fresh, state[_FRESH:_SETTLING], new / to_fresh, stepped)
    return (to_quiet - from_quiet, to_fresh, to_settling - from_settling), new / to_fresh


@subroutine
def _weigh(weights: tuple[float, float, float], logs: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the weights given the log likelihoods of a sample; they sum to 1, none is 0."""
    best = max(logs[0], logs[1], logs[2])
    quiet = weights[0] * math.exp(logs[0] - best)
    fresh = weights[1] * math.exp(logs[1] - best)
    settling = weights[2] * math.exp(logs[2] - best)
    scale = (1.0 - 3.0 * _MIN_WEIGHT) / (quiet + fresh + settling)
    return _MIN_WEIGHT + scale * quiet, _MIN_WEIGHT + scale * fresh, _MIN_WEIGHT + scale * settling


@kernel
def step(state: State, c: Constants, time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """Return the state after a sample; the same state when its stamp isn't later than the last."""
    dt_s = (time_ns - state[TIME]) * 1e-9
    if dt_s <= 0.0:
        return state
    if dt_s > _MAX_GAP_S:
        return start(c, time_ns, theta_m_rad, motor_torque_N_m)
    after, predicted = np.empty(STATE_SIZE), np.empty(_PREDICTED_SIZE)
    quiet, fresh, settling = after[_QUIET:_FRESH], after[_FRESH:_SETTLING], after[_SETTLING:]
    weights, new_part = _age(after, state, dt_s, predicted, c)
    lead_part, lead, held = _stretches(dt_s, c)
    drift_var, before = c[DRIFT] * dt_s, state[TORQUE]
    step_var = drift_var + c[STEP_VAR] * new_part
    _advance(predicted, quiet, drift_var, lead_part, lead, held, before, motor_torque_N_m, c)
    quiet_off, quiet_log = _correct(quiet, predicted, theta_m_rad, c[ANGLE_VAR])
    _advance(predicted, fresh, step_var, lead_part, lead, held, before, motor_torque_N_m, c)
    fresh_off, fresh_log = _correct(fresh, predicted, theta_m_rad, c[ANGLE_VAR])
    _advance(predicted, settling, drift_var, lead_part, lead, held, before, motor_torque_N_m, c)
    settling_off, settling_log = _correct(settling, predicted, theta_m_rad, c[ANGLE_VAR])
    if not (
        quiet_off <= _MAX_NORMALISED_INNOVATION_SQUARED
        or fresh_off <= _MAX_NORMALISED_INNOVATION_SQUARED
        or settling_off <= _MAX_NORMALISED_INNOVATION_SQUARED
    ):
        return start(c, time_ns, theta_m_rad, motor_torque_N_m)
    weights = _weigh(weights, (quiet_log, fresh_log, settling_log))
    _tell(after, time_ns, motor_torque_N_m, weights, c)
    return after


def _make(rig: Rig, sample_time_s: float, over_wire: bool) -> Estimator:
    hold_time_s = sample_time_s if rig.drive is None else rig.drive.sample_time_s
    damping = rig.effects.get("wire_damping", {}).get("damping_N_s_per_m", 0.0)
    sensors = kalman_model.Sensors(
        encoder_quantum_rad=rig.encoder.quantum_rad,
        transport_quantum_rad=WIRE_ANGLE_RAD if over_wire else 0.0,
        current_noise_A=rig.noise.current_A,
        transport_quantum_A=WIRE_CURRENT_A if over_wire else 0.0,
    )
    numbers = kalman_model.constants(rig.plant(), sensors, sample_time_s, hold_time_s, kalman_model.Tuning(), damping)
    return estimator_of_kernels("kalman", start, step, numbers)


ALGORITHMS = (Algorithm("kalman", _make, corrected=True, models=frozenset({"wire_damping"})),)
