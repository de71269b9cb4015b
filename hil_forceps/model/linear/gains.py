"""Exact response of the linear plant over one step, wire taut or slack; effects are added to it.

The linear plant is the paper's, with damping of the wire and viscous friction of the jaw. It is invariant to a common
rotation of both pulleys, so its response depends on the linear stretch x = r_m θ_m − r_j θ_j and the two speeds. Inputs
are a torque on each pulley, held (mean) or a line through zero at the middle of the step (slope).
"""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.model.composition import Physics
from hil_forceps.model.kernel import subroutine, with_work_arrays
from hil_forceps.model.linear.two_inertia import expm

Gains = NDArray[np.float64]

TAUT, SLACK = 0, 1  # rows: state of the wire, ...
SHORT = 2  # ... plus this for a piece of a step
PIECES = 8  # of a step
MOTOR_WAY, MOTOR_SPEED, JAW_WAY, JAW_SPEED = 0, 7, 14, 21  # where each quantity's coefficients begin in a row
FROM_STRETCH, FROM_MOTOR, FROM_JAW, MOTOR_MEAN, MOTOR_SLOPE, JAW_MEAN, JAW_SLOPE = range(7)
VISCOSITY, STIFFNESS, DAMPING = 28, 29, 30  # of the plant that the row belongs to
SIZE = 31


@with_work_arrays
def fill_gains(
    row: Gains,
    r_m: float,
    r_j: float,
    I_m: float,
    I_j: float,
    D_m: float,
    D_j: float,
    k: float,
    c: float,
    step_s: float,
) -> None:
    """Fill `row` (`SIZE`) with the response over `step_s` of a plant with viscosities D, stiffness k, damping c."""
    speed_unit = 1.0 / step_s
    motor_unit, jaw_unit = I_m * speed_unit * speed_unit, I_j * speed_unit * speed_unit
    # Units: time in steps, angles in radians, torques in I/step². Entries are then of the size of the response itself.
    joint = np.zeros((8, 8))
    stiff_m, stiff_j = k / motor_unit, k / jaw_unit
    damp_m, damp_j = c * speed_unit / motor_unit, c * speed_unit / jaw_unit
    joint[0, 1] = joint[2, 3] = 1.0
    joint[1, 0], joint[1, 2] = -stiff_m * r_m * r_m, stiff_m * r_m * r_j
    joint[1, 1], joint[1, 3] = -D_m * speed_unit / motor_unit - damp_m * r_m * r_m, damp_m * r_m * r_j
    joint[3, 0], joint[3, 2] = stiff_j * r_m * r_j, -stiff_j * r_j * r_j
    joint[3, 1], joint[3, 3] = damp_j * r_m * r_j, -D_j * speed_unit / jaw_unit - damp_j * r_j * r_j
    joint[1, 4] = joint[3, 5] = 1.0
    joint[4, 6] = joint[5, 7] = 1.0
    after = expm(joint)
    for i in range(4):
        unit = 1.0 if i in {0, 2} else speed_unit
        at = 7 * i
        row[at + FROM_STRETCH] = (-after[i, 2] / r_j if i < 2 else after[i, 0] / r_m) * unit
        row[at + FROM_MOTOR] = after[i, 1] * unit / speed_unit
        row[at + FROM_JAW] = after[i, 3] * unit / speed_unit
        row[at + MOTOR_MEAN] = after[i, 4] * unit / motor_unit
        row[at + MOTOR_SLOPE] = (after[i, 6] - 0.5 * after[i, 4]) * unit / motor_unit
        row[at + JAW_MEAN] = after[i, 5] * unit / jaw_unit
        row[at + JAW_SLOPE] = (after[i, 7] - 0.5 * after[i, 5]) * unit / jaw_unit
    row[VISCOSITY], row[STIFFNESS], row[DAMPING] = D_m, k, c


@subroutine
def fill_all(gains: Gains, p: Physics, viscosity: float, step_s: float) -> None:
    """Fill a table (4×`SIZE`) with the responses over a step and over a piece of it, taut and slack."""
    for base, length in ((0, step_s), (SHORT, step_s / PIECES)):
        fill_gains(
            gains[base + TAUT],
            p.r_m,
            p.r_j,
            p.I_m,
            p.I_j,
            viscosity,
            p.jaw_viscous_friction_viscosity_N_m_s_per_rad,
            p.k,
            p.wire_damping_damping_N_s_per_m,
            length,
        )
        fill_gains(
            gains[base + SLACK],
            p.r_m,
            p.r_j,
            p.I_m,
            p.I_j,
            viscosity,
            p.jaw_viscous_friction_viscosity_N_m_s_per_rad,
            0.0,
            0.0,
            length,
        )


@subroutine
def fill_multiples(gains: Gains, p: Physics, viscosity: float, step_s: float) -> None:
    """Fill a table (n×`SIZE`) with the responses over one step, two, and so on, wire taut."""
    for k in range(gains.shape[0]):
        fill_gains(
            gains[k],
            p.r_m,
            p.r_j,
            p.I_m,
            p.I_j,
            viscosity,
            p.jaw_viscous_friction_viscosity_N_m_s_per_rad,
            p.k,
            p.wire_damping_damping_N_s_per_m,
            (k + 1) * step_s,
        )
