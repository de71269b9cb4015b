"""The Kalman filter's model of forceps, load and sensors: its constants, and exact transitions over stretches of time.

State (5): θ_m, ω_m, θ_j, ω_j, τ_w. Between samples the plant is linear with the motor torque held; τ_w is held, too,
except where it steps. A stretch of time is a 5×11 matrix: Φ (5×5), the response to a unit of motor torque (5×1), and
the covariance at its end by a unit-variance step of τ_w within it (5×5).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.estimation.kernel import kernel, returning_arrays, run_kernel
from hil_forceps.model.linear.two_inertia import (
    Matrix,
    continuous,
    halvings,
    multiply,
    taylor_exponential,
    wire_mode_rad_per_s,
)
from hil_forceps.rig.plant import PlantParameters

Constants = NDArray[np.float64]

ANGLE_M, SPEED_M, ANGLE_J, SPEED_J, LOAD = range(5)
TORQUE_COLUMN = 5
STEP_COLUMNS = 6
_STRETCH_SIZE = 55

PERIOD, HOLD, TORQUE_VAR, ANGLE_VAR, FRICTION_M, FRICTION_J = range(6)
DRIFT, STEP_VAR, STEP_RATE, RESTEP_RATE, SETTLE_RATE, QUIET_RATE, RADIUS_M, RADIUS_J, TURN_PER_LOAD = range(6, 15)
_RATES = 15
_UNITS = _RATES + 36
_LEAD = _UNITS + 6
_HELD = _LEAD + _STRETCH_SIZE

_FRICTION_SWEEPS = 3

# A step of τ_w within a stretch may be at one of 2**_MIN_STEP_HALVINGS places at least.
_MIN_STEP_HALVINGS = 3


class Tuning(NamedTuple):
    """Expected changes of the load, and errors of model and encoder. The defaults serve any rig."""

    # Standard deviation of a step of the load, as the angle that it turns the jaw by: 2 mN m in the paper.
    step_jaw_turn_rad: float = 0.04
    step_rate_per_s: float = 0.3
    # After a step another one is more likely for a while.
    restep_rate_per_s: float = 1.0
    # Mean times for which a step counts as fresh, and then as settling.
    fresh_s: float = 0.001
    settling_s: float = 0.012
    # Slow change of the load: (share of the step)² per second.
    drift_per_s: float = 1e-3
    # The same with an encoder that counts: its rounding delays the response to slow change, by √(rounding/drift).
    drift_with_counts_per_s: float = 1e-2
    # Error of friction as a share of its level, and of a count's edge as a share of a count. A pulley that sticks has
    # any friction between minus and plus its level: the standard deviation of that is 1/√3 of the level.
    friction_share: float = 0.58
    count_share: float = 0.15


class Sensors(NamedTuple):
    """Resolution and noise of the samples."""

    encoder_quantum_rad: float
    transport_quantum_rad: float  # rounding on the way from drive to estimator, 0: none
    current_noise_A: float
    transport_quantum_A: float


# Without rounding by encoder and transport some error has to be assumed, else the gain has no bound.
_MIN_ANGLE_ERROR_RAD = 1e-10


def constants(
    plant: PlantParameters,
    sensors: Sensors,
    sample_time_s: float,
    hold_time_s: float,
    tuning: Tuning,
    wire_damping_N_s_per_m: float = 0.0,
) -> Constants:
    """Return the constants of the kernels.

    `sample_time_s`: nominal time between samples. `hold_time_s`: for which the drive holds a current; it is shorter if
    the drive sends every n-th sample, and then the torque before the last hold is unknown.
    """
    r_m, r_j = plant.motor_pulley_radius_m, plant.jaw_pulley_radius_m
    hold_time_s = min(sample_time_s, hold_time_s)
    angle_variances = [
        (sensors.encoder_quantum_rad**2 + sensors.transport_quantum_rad**2) / 12.0,
        (tuning.count_share * sensors.encoder_quantum_rad) ** 2,
        _MIN_ANGLE_ERROR_RAD**2,
    ]
    current_variance = sensors.current_noise_A**2 + sensors.transport_quantum_A**2 / 12.0
    turn_per_load = 1.0 / (plant.wire_stiffness_N_per_m * r_j * r_j)
    step = tuning.step_jaw_turn_rad / turn_per_load
    values = np.zeros(_HELD + _STRETCH_SIZE)
    values[PERIOD] = sample_time_s
    values[HOLD] = hold_time_s
    values[TORQUE_VAR] = (
        plant.torque_constant_N_m_per_A**2 * current_variance + (tuning.friction_share * plant.motor_coulomb_N_m) ** 2
    )
    values[ANGLE_VAR] = sum(angle_variances)
    values[FRICTION_M] = plant.motor_coulomb_N_m
    values[FRICTION_J] = plant.jaw_coulomb_N_m
    drift_per_s = tuning.drift_with_counts_per_s if sensors.encoder_quantum_rad > 0.0 else tuning.drift_per_s
    values[DRIFT] = drift_per_s * step * step
    values[STEP_VAR] = step * step
    values[STEP_RATE] = tuning.step_rate_per_s
    values[RESTEP_RATE] = tuning.restep_rate_per_s
    values[SETTLE_RATE] = 1.0 / tuning.fresh_s
    values[QUIET_RATE] = 1.0 / tuning.settling_s
    values[RADIUS_M], values[RADIUS_J], values[TURN_PER_LOAD] = r_m, r_j, turn_per_load
    rates, units = balanced_rates(plant, wire_damping_N_s_per_m)
    values[_RATES:_UNITS] = rates.ravel()
    values[_UNITS:_LEAD] = units
    _fill_stretch(values, max(0.0, sample_time_s - hold_time_s), values[_LEAD:_HELD])
    _fill_stretch(values, hold_time_s, values[_HELD:])
    return values


def balanced_rates(plant: PlantParameters, wire_damping_N_s_per_m: float = 0.0) -> tuple[Matrix, NDArray[np.float64]]:
    """Return the 6×6 rates [1/s] of state, τ_w and motor torque in balanced units, and these units."""
    a, b = continuous(plant)
    if wire_damping_N_s_per_m != 0.0:
        r_m, r_j = plant.motor_pulley_radius_m, plant.jaw_pulley_radius_m
        stretch_rate = wire_damping_N_s_per_m * np.array([r_m, -r_j])
        a[1, 1::2] -= r_m / plant.motor_inertia_kg_m2 * stretch_rate
        a[3, 1::2] += r_j / plant.jaw_inertia_kg_m2 * stretch_rate
    mode = wire_mode_rad_per_s(plant)
    units = np.array([1.0, mode, 1.0, mode, mode**2 * plant.jaw_inertia_kg_m2, mode**2 * plant.motor_inertia_kg_m2])
    rates = np.zeros((6, 6))
    rates[:4, :4] = a
    rates[:4, 4] = b[:, 1]
    rates[:4, 5] = b[:, 0]
    return rates * units[None, :] / units[:, None], units


@returning_arrays
def lead_stretch(c: Constants) -> Matrix:
    """Return the stretch from the last sample to the begin of the hold of this one's torque."""
    return c[_LEAD:_HELD].reshape((5, 11))


@kernel
def held_stretch(c: Constants) -> Matrix:
    """Return the stretch over which the drive held the torque of a sample."""
    return c[_HELD : _HELD + _STRETCH_SIZE].reshape((5, 11))


@returning_arrays
def stretch(c: Constants, dt_s: float) -> Matrix:
    """Return the stretch of `dt_s`, exact but for the places where a step of τ_w may be.

    A step is at the beginning (at the last sample, as of a load that is synchronous with the experiment) or, with the
    same probability, anywhere within.
    """
    units = c[_UNITS:_LEAD]
    rates = c[_RATES:_UNITS].copy().reshape((6, 6)) * dt_s
    count = max(halvings(rates), _MIN_STEP_HALVINGS)
    transition = taylor_exponential(rates * 0.5 ** (count + 1))
    # Mean covariance of a step within: in the middle of the smallest part, then by doubling the mean of a step in the
    # second half, and of one in the first half carried through the second.
    within = np.empty((5, 5))
    for i in range(5):
        for j in range(5):
            within[i, j] = transition[i, LOAD] * transition[j, LOAD]
    transition = multiply(transition, transition)
    for _ in range(count):
        carried = multiply(multiply(transition[:5, :5], within), np.ascontiguousarray(transition[:5, :5].T))
        for i in range(5):
            for j in range(5):
                within[i, j] = 0.5 * (within[i, j] + carried[i, j])
        transition = multiply(transition, transition)
    result = np.empty((5, 11))
    for i in range(5):
        for j in range(6):
            result[i, j] = transition[i, j] * units[i] / units[j]
        for j in range(5):
            at_start = transition[i, LOAD] * transition[j, LOAD]
            scale = units[i] * units[j] / (units[LOAD] * units[LOAD])
            result[i, STEP_COLUMNS + j] = 0.5 * (at_start + within[i, j]) * scale
    return result


@run_kernel
def _fill_stretch(c: Constants, dt_s: float, out: Constants) -> None:
    """Fill `out` with the stretch of `dt_s`, row by row."""
    over = stretch(c, dt_s)
    for i in range(over.shape[0]):
        for j in range(over.shape[1]):
            out[i * over.shape[1] + j] = over[i, j]


@kernel
def frictions_N_m(
    speed_m: float, speed_j: float, over: Matrix, level_m_N_m: float, level_j_N_m: float
) -> tuple[float, float]:
    """Return Coulomb friction of motor and jaw over a stretch that would end at these speeds without it.

    The torques that bring both speeds to zero, each limited to its level: Moreau's implicit rule for two masses, by
    projected Gauss-Seidel.
    """
    motor, jaw = 0.0, 0.0
    for _ in range(_FRICTION_SWEEPS):
        left = speed_m - over[SPEED_M, TORQUE_COLUMN] * motor + over[SPEED_M, LOAD] * jaw
        motor = max(-level_m_N_m, min(level_m_N_m, motor + left / over[SPEED_M, TORQUE_COLUMN]))
        left = speed_j - over[SPEED_J, TORQUE_COLUMN] * motor + over[SPEED_J, LOAD] * jaw
        jaw = max(-level_j_N_m, min(level_j_N_m, jaw - left / over[SPEED_J, LOAD]))
    return motor, jaw
