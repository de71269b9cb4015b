"""The law of the drive's position loop, as the rig file states it."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.model.kernel import inlined, run_kernel
from hil_forceps.rig.sections import DriveLaw

Vector = NDArray[np.float64]

# Places in the vector of a law.
SAMPLE_TIME, KP, KI, KD, SHARE, LIMIT, ERROR_FIRST, CASCADE_TIME = range(8)


class DriveState(NamedTuple):
    """State of the drive between samples."""

    integral_rad_s: float
    theta_enc_rad: float  # of the last sample; NaN before the first, when there is no difference to take
    velocity_rad_per_s: float  # filtered
    current_A: float  # commanded


def law_vector(drive: DriveLaw, *, backward_euler: bool = False, error_first: bool = True) -> Vector:
    """Return the numbers of a law, by the places above; `SHARE` is the weight of a new velocity in its filter.

    `backward_euler`: discretise the filter so, else exactly. `error_first`: a sample's error enters the integral before
    the current of that sample is computed, else after.
    """
    angle = 2.0 * math.pi * drive.derivative_cutoff_Hz * drive.sample_time_s
    share = angle / (1.0 + angle) if backward_euler else -math.expm1(-angle)
    gains = [drive.sample_time_s, drive.kp_A_per_rad, drive.ki_A_per_rad_s, drive.kd_A_s_per_rad]
    return np.array([*gains, share, drive.current_limit_A, float(error_first), drive.cascade_time_s])


@inlined
def quantise(value: float, quantum: float) -> float:
    """Return `value` rounded to a whole number of quanta, or itself when the quantum is 0."""
    if quantum <= 0.0:
        return value
    return math.floor(value / quantum + 0.5) * quantum


@inlined
def drive_sample(law: Vector, state: DriveState, reference_rad: float, theta_enc_rad: float) -> DriveState:
    """Return the drive's state after a sample; its current is held until the next one."""
    period, ki, limit = law[SAMPLE_TIME], law[KI], law[LIMIT]
    error = reference_rad - theta_enc_rad
    velocity = state.velocity_rad_per_s
    if not math.isnan(state.theta_enc_rad):
        velocity += law[SHARE] * ((theta_enc_rad - state.theta_enc_rad) / period - velocity)
    integral = state.integral_rad_s + (error - law[CASCADE_TIME] * velocity) * period
    if ki > 0.0:
        integral = max(-limit / ki, min(limit / ki, integral))
    used = integral if law[ERROR_FIRST] != 0.0 else state.integral_rad_s
    current = max(-limit, min(limit, law[KP] * error + ki * used - law[KD] * velocity))
    return DriveState(integral, theta_enc_rad, velocity, current)


@run_kernel
def _fill_commands(
    law: Vector, state: DriveState, references_rad: Vector, theta_enc_rad: Vector, commands_A: Vector, integral: Vector
) -> None:
    """Fill `commands_A` and `integral` with what the law has after each sample."""
    for n in range(references_rad.shape[0]):
        state = drive_sample(law, state, references_rad[n], theta_enc_rad[n])
        commands_A[n], integral[n] = state.current_A, state.integral_rad_s


def _commands_and_integrals(
    law: Vector, start: DriveState, references_rad: Vector, theta_enc_rad: Vector
) -> tuple[Vector, Vector]:
    """Return commands and integrals of the law for recorded angles."""
    commands_A, integral = np.empty(references_rad.size), np.empty(references_rad.size)
    angles = (np.ascontiguousarray(references_rad), np.ascontiguousarray(theta_enc_rad))
    _fill_commands(law, start, *angles, commands_A, integral)
    return commands_A, integral


def integral_without_limit(law: Vector, references_rad: Vector, theta_enc_rad: Vector) -> Vector:
    """Return the integral after each sample, from nought, as if it had no limit (n) [rad s]."""
    unlimited = law.copy()
    unlimited[KI] = 0.0
    return _commands_and_integrals(unlimited, DriveState(0.0, math.nan, 0.0, 0.0), references_rad, theta_enc_rad)[1]


def law_current(law: Vector, reference_rad: Vector, theta_enc_rad: Vector, start: DriveState) -> Vector:
    """Return the commands of the law for recorded angles (n) [A]; the one of row k is measured at row k + 1.

    ValueError when the lengths differ.
    """
    if reference_rad.shape != theta_enc_rad.shape or reference_rad.ndim != 1:
        raise ValueError(f"{reference_rad.shape} references for {theta_enc_rad.shape} angles")
    return _commands_and_integrals(law, start, reference_rad, theta_enc_rad)[0]
