"""The closed loop without effects: exact steps of the linear plant, implicit friction, the drive's law.

The simulated world (another package) integrates its own equations with another method and a smoothed friction; a test
compares the two. Here the plant is stepped by its exact discretisation with inputs held. Coulomb friction is the torque
that brings the velocity at the end of the step to zero, limited to its level: it can stop a mass but never drive it.

Plant state (4): θ_m, ω_m, θ_j, ω_j. Drive state (5): ∫e dt, last θ_enc, filtered velocity, current held, samples seen.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.model.kernel import kernel
from hil_forceps.model.linear.two_inertia import Matrix, discretise
from hil_forceps.rig.plant import PlantParameters

Vector = NDArray[np.float64]

DRIVE_INTEGRAL, DRIVE_ANGLE, DRIVE_VELOCITY, DRIVE_CURRENT, DRIVE_SAMPLES = range(5)


class DriveParameters(NamedTuple):
    """The position loop that the drive closes."""

    sample_time_s: float
    kp_A_per_rad: float
    ki_A_per_rad_s: float
    kd_A_s_per_rad: float
    derivative_cutoff_Hz: float
    current_limit_A: float
    cascade_time_s: float = 0.0


class Loop(NamedTuple):
    """Plant and drive as the kernels take them, from `make_loop`."""

    transition: Matrix  # Φ of one plant step
    input_gain: Matrix  # Γ of one plant step
    frictions_N_m: Vector  # τ_Fm, τ_Fj
    drive: Vector  # T, kp, ki, kd, weight of a new value in the velocity's filter, limit, cascade time
    torque_constant_N_m_per_A: float
    encoder_quantum_rad: float  # 0: not quantised
    steps_per_sample: int


class Rollout(NamedTuple):
    """Result of `rollout`, one row per sample of the drive: values at the instant of the sample."""

    states: Matrix  # n×4 plant states
    theta_m_rad: Vector  # encoder angle
    current_A: Vector  # current held over the interval that ended at the sample


def make_loop(
    plant: PlantParameters, drive: DriveParameters, counts_per_rev: int | None = None, plant_step_s: float = 5e-5
) -> Loop:
    """Prepare a loop; ValueError unless the drive's sample time is a whole number of plant steps."""
    steps = round(drive.sample_time_s / plant_step_s)
    if steps < 1 or not math.isclose(steps * plant_step_s, drive.sample_time_s, rel_tol=1e-9):
        raise ValueError(
            f"drive sample time {drive.sample_time_s} s must be a whole number of plant steps of {plant_step_s} s"
        )
    transition, input_gain = discretise(plant, drive.sample_time_s / steps)
    share = 1.0 - math.exp(-2.0 * math.pi * drive.derivative_cutoff_Hz * drive.sample_time_s)
    law = [drive.sample_time_s, drive.kp_A_per_rad, drive.ki_A_per_rad_s, drive.kd_A_s_per_rad]
    return Loop(
        transition,
        input_gain,
        np.array([plant.motor_coulomb_N_m, plant.jaw_coulomb_N_m]),
        np.array([*law, share, drive.current_limit_A, drive.cascade_time_s]),
        plant.torque_constant_N_m_per_A,
        0.0 if counts_per_rev is None else 2.0 * math.pi / counts_per_rev,
        steps,
    )


def rest_state(plant: PlantParameters, theta_j_rad: float) -> Vector:
    """Return the plant at rest with an unstretched wire (x = 0) at jaw angle `theta_j_rad`."""
    ratio = plant.jaw_pulley_radius_m / plant.motor_pulley_radius_m
    return np.array([ratio * theta_j_rad, 0.0, theta_j_rad, 0.0])


@kernel
def friction_N_m(free_velocity: float, velocity_per_torque: float, level_N_m: float) -> float:
    """Return the friction torque of a step that would end at `free_velocity` without it (Moreau's implicit rule)."""
    return max(-level_N_m, min(level_N_m, free_velocity / velocity_per_torque))


@kernel
def plant_step(
    state: Vector, torque_N_m: float, load_N_m: float, transition: Matrix, input_gain: Matrix, frictions_N_m: Vector
) -> Vector:
    """Return the plant state after a step, motor torque and jaw load held."""
    after = np.empty(4)
    for i in range(4):
        total = input_gain[i, 0] * torque_N_m + input_gain[i, 1] * load_N_m
        for j in range(4):
            total += transition[i, j] * state[j]
        after[i] = total
    motor = friction_N_m(after[1], input_gain[1, 0], frictions_N_m[0])
    # The load on the jaw is positive against the motion, so its column is negative.
    jaw = friction_N_m(after[3], -input_gain[3, 1], frictions_N_m[1])
    for i in range(4):
        after[i] += input_gain[i, 1] * jaw - input_gain[i, 0] * motor
    return after


@kernel
def quantise(value: float, quantum: float) -> float:
    """Return `value` rounded to a whole number of quanta, or itself when the quantum is 0."""
    if quantum <= 0.0:
        return value
    return math.floor(value / quantum + 0.5) * quantum


@kernel
def drive_step(state: Vector, reference_rad: float, theta_enc_rad: float, drive: Vector) -> Vector:
    """Return the drive's state after a sample; entry `DRIVE_CURRENT` is held until the next."""
    period, kp, ki, kd, share, limit = drive[0], drive[1], drive[2], drive[3], drive[4], drive[5]
    error = reference_rad - theta_enc_rad
    velocity = 0.0
    if state[DRIVE_SAMPLES] > 0.0:
        raw = (theta_enc_rad - state[DRIVE_ANGLE]) / period
        velocity = state[DRIVE_VELOCITY] + share * (raw - state[DRIVE_VELOCITY])
    integral = state[DRIVE_INTEGRAL] + (error - drive[6] * velocity) * period
    if ki > 0.0:
        integral = max(-limit / ki, min(limit / ki, integral))
    current = max(-limit, min(limit, kp * error + ki * integral - kd * velocity))
    return np.array([integral, theta_enc_rad, velocity, current, state[DRIVE_SAMPLES] + 1.0])


@kernel
def interval(state: Vector, current_A: float, load_N_m: Vector, loop: Loop) -> Vector:
    """Return the plant state after an interval of the drive; `load_N_m` has τ_w for each plant step of it."""
    for i in range(loop.steps_per_sample):
        state = plant_step(
            state,
            loop.torque_constant_N_m_per_A * current_A,
            load_N_m[i],
            loop.transition,
            loop.input_gain,
            loop.frictions_N_m,
        )
    return state


@kernel
def _rollout(state: Vector, references_rad: Vector, load_N_m: Vector, loop: Loop) -> tuple[Matrix, Vector, Vector]:
    samples = references_rad.shape[0]
    states = np.empty((samples, 4))
    angles = np.empty(samples)
    currents = np.empty(samples)
    drive = np.zeros(5)
    for n in range(samples):
        states[n] = state
        angles[n] = quantise(state[0], loop.encoder_quantum_rad)
        currents[n] = drive[DRIVE_CURRENT]
        drive = drive_step(drive, references_rad[n], angles[n], loop.drive)
        first = n * loop.steps_per_sample
        state = interval(state, drive[DRIVE_CURRENT], load_N_m[first : first + loop.steps_per_sample], loop)
    return states, angles, currents


def rollout(loop: Loop, state: Vector, references_rad: Vector, tau_w_N_m: Vector) -> Rollout:
    """Simulate the loop from `state` with the drive at rest.

    `references_rad` (n): the θ_m^ref that the drive's law uses at each sample. `tau_w_N_m` (n·steps_per_sample): load
    on the jaw over each plant step. ValueError when the shapes don't fit.
    """
    samples = references_rad.shape[0]
    if tau_w_N_m.shape != (samples * loop.steps_per_sample,) or state.shape != (4,):
        raise ValueError(
            f"tau_w_N_m must have {samples * loop.steps_per_sample} values, got {tau_w_N_m.shape}; "
            f"state must have 4, got {state.shape}"
        )
    return Rollout(*_rollout(state, references_rad, tau_w_N_m, loop))
