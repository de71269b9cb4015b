"""The mean of the state a row on: the model's own step, with the load and the friction that the filter has."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.kernel import inlined, returning_arrays, run_kernel
from hil_forceps.model.composition import (
    Physics,
    backward_friction_N_m,
    forward_friction_N_m,
    motor_friction_N_m,
    motor_viscosity_N_m_s_per_rad,
    without_dry_friction,
)
from hil_forceps.model.current import CurrentStep, current_over, current_step
from hil_forceps.model.linear.gains import PIECES, SHORT, SIZE, TAUT, VISCOSITY, fill_all, fill_multiples
from hil_forceps.model.physics import Kind, State, dead_zone, jaw_level_N_m, kind_of, torque_constant
from hil_forceps.model.step.motion import Drive
from hil_forceps.model.step.refinement import refined_step
from hil_forceps.model.step.single_step import plain_step
from hil_forceps.model.step.whole_step import decays, suits, whole_step

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

STEPS = 4  # of a row, at least; a drive may sample as often within it
# A step in which dry friction stops a mass is exact to first order only. Steps of 0.5 ms left 75 of χ² in two slow runs
# beside friction of a tenth of the load; of 0.25 ms, less than 5.
MAX_STEP_S = 2.5e-4
MIN_LIMIT_DISTANCE_DEVIATIONS = 6.0  # of the command: nearer than this, the limit matters; beyond, 1 in 10⁹ exceed it
_ROOT_2 = math.sqrt(2.0)
_DRIFT_STEP = 0.02  # of D_m: further away, the linear plant is made anew


class Stepper(NamedTuple):
    """What a row's steps are made with, prepared once for a run.

    By regime: where both masses slide, where the motor may stick, where the jaw may, and where both may. Where a mass
    may stick its dry friction is a state of the filter, and the plant has none.
    """

    gains: Matrix
    whole: Matrix
    keeps: Vector
    inertia: tuple[float, float]
    kept: tuple[float, float]
    current: CurrentStep
    steps: int  # of a sample of the drive
    step_s: float
    friction_N_m: float  # of the sliding motor
    kinds: tuple[Kind, Kind, Kind, Kind]
    spans: tuple[int, int, int, int]  # steps tried as one


class Acting(NamedTuple):
    """What acts on the plant over a row."""

    time_s: float
    first: int  # place of the row's first command among all
    load_N_m: float
    load_slope_N_m_per_s: float
    friction_m_N_m: float
    friction_j_N_m: float


@inlined
def steps_in_row(period_s: float) -> int:
    """Return how many steps a row takes: a multiple of `STEPS`."""
    return STEPS * max(1, math.ceil(period_s / (STEPS * MAX_STEP_S) - 1e-3))


def _kinds(p: Physics) -> tuple[Kind, Kind, bool]:
    neither = without_dry_friction(p, True, True)
    return kind_of(p), kind_of(neither), suits(p, kind_of(p), STEPS)


def steps_of(p: Physics) -> tuple[float, ...]:
    """Return what decides how a plant is stepped: between plants that differ in it, steps are less accurate."""
    sliding, free, whole = _kinds(p)
    friction_over_speed = (
        p.stribeck_friction_speed_rad_per_s if p.stribeck_friction_rise_N_m != 0.0 else 0.0,
        p.film_friction_speed_rad_per_s if p.film_friction_level_N_m != 0.0 else 0.0,
    )
    wire = (p.wire_slack_half_width_m > 0.0, p.transmission_play_half_width_rad > 0.0, p.wire_hysteresis_force_N > 0.0)
    late = (p.electrical_lag_time_constant_s > 0.0, p.actuation_delay_delay_s > 0.0)
    return (*sliding, *free, whole, *friction_over_speed, *wire, *late)


@returning_arrays
def stepper(p: Physics, period_s: float, samples: int) -> Stepper:
    """Prepare for a plant, a period of the rows, and samples of the drive in it."""
    in_row = steps_in_row(period_s)
    step_s, steps = period_s / in_row, in_row // samples
    gains, whole = np.empty((SHORT + 2, SIZE)), np.empty((steps, SIZE))
    fill_all(gains, p, motor_viscosity_N_m_s_per_rad(p, 0.0), step_s)
    fill_multiples(whole, p, motor_viscosity_N_m_s_per_rad(p, 0.0), step_s)
    kept = (math.exp(-step_s / p.wire_creep_time_constant_s), math.exp(-step_s / PIECES / p.wire_creep_time_constant_s))
    inertia = (p.I_m / step_s, p.I_j / step_s)
    current = current_step(step_s, steps, p.actuation_delay_delay_s, p.electrical_lag_time_constant_s)
    no_motor, no_jaw = without_dry_friction(p, True, False), without_dry_friction(p, False, True)
    neither = without_dry_friction(p, True, True)
    kinds = (kind_of(p), kind_of(no_motor), kind_of(no_jaw), kind_of(neither))
    spans = (_span(p, steps), _span(no_motor, steps), _span(no_jaw, steps), _span(neither, steps))
    keeps = decays(p, steps, step_s)
    return Stepper(gains, whole, keeps, inertia, kept, current, steps, step_s, p.motor_coulomb, kinds, spans)


@inlined
def _span(p: Physics, steps: int) -> int:
    return steps if suits(p, kind_of(p), steps) else 0


@inlined
def acting_command(p: Physics, command_A: float) -> float:
    """Return what of a command the amplifier gives."""
    return max(
        -p.current_saturation_limit_A,
        min(p.current_saturation_limit_A, dead_zone(command_A, p.amplifier_deadband_half_width_A)),
    )


@inlined
def expected_current_slope(p: Physics, command_A: float, deviation_A: float) -> float:
    """Return the expected slope of the current over a command with this mean and standard deviation.

    It is the probability that the command lies outside the dead zone and within the limit.
    """
    low, high, size = p.amplifier_deadband_half_width_A, p.current_saturation_limit_A, abs(command_A)
    if low == 0.0 and size + MIN_LIMIT_DISTANCE_DEVIATIONS * deviation_A < high:
        return 1.0
    return forward_share(size - low, deviation_A) - forward_share(size - high, deviation_A)


@inlined
def advance(
    p: Physics, s: Stepper, motor_free: bool, jaw_free: bool, x: State, a: Acting, commands_A: Vector, sample: int
) -> State:
    """Return the plant's state a sample of the drive on, by its place in the row.

    `motor_free` and `jaw_free`: whether that mass may stick, so that its dry friction acts as `a` has it.
    """
    steps, regime = s.steps, (1 if motor_free else 0) + (2 if jaw_free else 0)
    at = a.first + sample - s.current.whole_samples
    new = acting_command(p, commands_A[max(at, 0)])
    old = acting_command(p, commands_A[max(at - 1, 0)])
    plant, kind, span = without_dry_friction(p, motor_free, jaw_free), s.kinds[regime], s.spans[regime]
    return _over_sample(plant, kind, s, span, x, a, sample * steps, steps, old, new)


@inlined
def _over_sample(
    p: Physics,
    kind: Kind,
    s: Stepper,
    span: int,
    x: State,
    a: Acting,
    first: int,
    steps: int,
    old_A: float,
    new_A: float,
) -> State:
    """Return the plant's state a sample of the drive on; `first`: of its steps in the row; `span`: tried as one."""
    done = 0
    at_once = s.current.whole_samples == 0 and s.current.mean == 0.0 and s.current.arrival_slope == 0.0
    while done < steps:
        if span > 0 and done % span == 0 and at_once:
            middle_s = (first + done + 0.5 * span) * s.step_s
            constant = torque_constant(p, a.time_s + middle_s)
            current = new_A - a.friction_m_N_m / constant
            load = a.load_N_m + a.load_slope_N_m_per_s * middle_s + a.friction_j_N_m
            slope = a.load_slope_N_m_per_s * s.step_s * span
            d = Drive(current, 0.0, new_A, constant, motor_viscosity_N_m_s_per_rad(p, a.time_s + middle_s), load, slope)
            moves, there = whole_step(p, kind, s.whole, s.keeps, span, x, d, s.friction_N_m)
            if moves:
                x = there
                done += span
                continue
        if done == 0 and span == steps:  # halves, then
            span = span // 2 if not kind.plain and span % 4 == 0 else 0
            continue
        x = _one(p, kind, s, x, a, first, done, old_A, new_A)
        done += 1
    return x


@inlined
def _one(
    p: Physics, kind: Kind, s: Stepper, x: State, a: Acting, first: int, step: int, old_A: float, new_A: float
) -> State:
    mean, slope, end = current_over(s.current, step, x.current_A, old_A, new_A)
    middle_s = (first + step + 0.5) * s.step_s
    constant = torque_constant(p, a.time_s + middle_s)
    mean -= a.friction_m_N_m / constant
    load = a.load_N_m + a.load_slope_N_m_per_s * middle_s + a.friction_j_N_m
    load_slope = a.load_slope_N_m_per_s * s.step_s
    d = Drive(mean, slope, end, constant, motor_viscosity_N_m_s_per_rad(p, a.time_s + middle_s), load, load_slope)
    if kind.plain:
        return plain_step(p, s.gains, s.inertia, x, d)
    if abs(d.viscosity - s.gains[TAUT, VISCOSITY]) > _DRIFT_STEP * p.D_m:
        fill_all(s.gains, p, d.viscosity, s.step_s)
    return refined_step(p, kind, s.gains, s.inertia, s.kept, x, d)


@run_kernel
def friction_at_rest_N_m(
    p: Physics, tension_N: Vector, theta_j_rad: Vector, resolved_rad: tuple[float, float], out: Matrix
) -> None:
    """Fill `out` (n × 2) with the most that the dry friction of motor and jaw holds, row by row.

    Friction that builds up over less than `resolved_rad` (motor, jaw) is included: its state is not observable.
    """
    motor = p.film_friction_level_N_m + max(forward_friction_N_m(p), backward_friction_N_m(p))
    motor_mu, jaw, jaw_mu = 0.0, 0.0, 0.0
    if p.presliding_friction_angle_rad < resolved_rad[0]:
        motor += p.presliding_friction_level_N_m
    if p.loaded_presliding_angle_rad < resolved_rad[0]:
        motor_mu = p.loaded_presliding_mu
    if p.jaw_presliding_angle_rad < resolved_rad[1]:
        jaw, jaw_mu = p.jaw_presliding_level_N_m, p.jaw_presliding_mu
    for row in range(out.shape[0]):
        tension = abs(tension_N[row])
        out[row, 0] = motor_friction_N_m(p, 0.0, tension) + motor + motor_mu * p.r_m * tension
        out[row, 1] = jaw_level_N_m(p, theta_j_rad[row]) + jaw + jaw_mu * p.r_j * tension


@inlined
def expected_friction_m_N_m(p: Physics, omega: float, deviation: float, tension_N: float) -> float:
    """Return the mean of the motor's dry friction where its speed is only known to ± `deviation`."""
    forward = forward_share(omega, deviation)
    level = motor_friction_N_m(p, omega, tension_N)
    return forward * (level + forward_friction_N_m(p)) - (1.0 - forward) * (level + backward_friction_N_m(p))


@inlined
def expected_friction_j_N_m(p: Physics, omega: float, deviation: float, theta: float) -> float:
    """Return the same of the jaw."""
    return (2.0 * forward_share(omega, deviation) - 1.0) * jaw_level_N_m(p, theta)


@inlined
def forward_share(omega: float, deviation: float) -> float:
    """Return how likely a speed of this mean and deviation is positive."""
    if deviation <= 0.0:
        return 1.0 if omega > 0.0 else 0.0
    return 0.5 * math.erfc(-omega / (deviation * _ROOT_2))


def physics_of(theta: Vector) -> Physics:
    """Return the plant of a vector of parameters (`model.parameters.NAMES`)."""
    return Physics(*theta.tolist())
