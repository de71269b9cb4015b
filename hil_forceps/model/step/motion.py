"""Displacements and speeds of the linear plant over a step, by its exact response (`linear.gains`), and its inputs."""

from typing import NamedTuple

from hil_forceps.model.composition import Physics
from hil_forceps.model.kernel import inlined
from hil_forceps.model.linear.gains import (
    FROM_JAW,
    FROM_MOTOR,
    FROM_STRETCH,
    JAW_MEAN,
    JAW_SLOPE,
    JAW_SPEED,
    JAW_WAY,
    MOTOR_MEAN,
    MOTOR_SLOPE,
    MOTOR_SPEED,
    MOTOR_WAY,
    Gains,
)
from hil_forceps.model.physics import State


class Torques(NamedTuple):
    """Torques on the pulleys over a step: mean and slope of each."""

    motor: float
    motor_slope: float
    jaw: float
    jaw_slope: float


class Motion(NamedTuple):
    """Angles and speeds."""

    theta_m: float
    omega_m: float
    theta_j: float
    omega_j: float


class Drive(NamedTuple):
    """Inputs of a step."""

    current: float  # mean over the step
    current_slope: float
    current_end: float
    torque_constant: float  # K_t at the time
    viscosity: float  # D at the time
    load: float  # τ_w, mean over the step
    load_slope: float


@inlined
def row_of(g: Gains, s: int, row: int, stretch: float, omega_m: float, omega_j: float, u: Torques) -> float:
    """Return a row of the gains applied to a state and to torques."""
    total: float = g[s, row + FROM_STRETCH] * stretch
    total += g[s, row + FROM_MOTOR] * omega_m + g[s, row + FROM_JAW] * omega_j
    return total + _response(g, s, row, u)


@inlined
def _response(g: Gains, s: int, row: int, u: Torques) -> float:
    total: float = g[s, row + MOTOR_MEAN] * u.motor + g[s, row + MOTOR_SLOPE] * u.motor_slope
    total += g[s, row + JAW_MEAN] * u.jaw + g[s, row + JAW_SLOPE] * u.jaw_slope
    return total


@inlined
def free_motion(p: Physics, g: Gains, s: int, x: State, u: Torques) -> Motion:
    """Return displacements and final speeds of a step without dry friction."""
    omega_m, omega_j = x.omega_m_rad_per_s, x.omega_j_rad_per_s
    stretch = p.r_m * x.theta_m_rad - p.r_j * x.theta_j_rad
    return Motion(
        row_of(g, s, MOTOR_WAY, stretch, omega_m, omega_j, u),
        row_of(g, s, MOTOR_SPEED, stretch, omega_m, omega_j, u),
        row_of(g, s, JAW_WAY, stretch, omega_m, omega_j, u),
        row_of(g, s, JAW_SPEED, stretch, omega_m, omega_j, u),
    )


@inlined
def added(g: Gains, s: int, m: Motion, u: Torques) -> Motion:
    """Return displacements and final speeds with more torques."""
    return Motion(
        m.theta_m + _response(g, s, MOTOR_WAY, u),
        m.omega_m + _response(g, s, MOTOR_SPEED, u),
        m.theta_j + _response(g, s, JAW_WAY, u),
        m.omega_j + _response(g, s, JAW_SPEED, u),
    )
