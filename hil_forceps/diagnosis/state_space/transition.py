"""The linear part of the transition from row to row, and the covariance that a jump of the load brings."""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.kernel import returning_arrays, subroutine
from hil_forceps.diagnosis.state_space.layout import (
    COMMAND_ERROR,
    FRICTION_J,
    FRICTION_M,
    LOAD,
    LOAD_SLOPE,
    OMEGA_J,
    OMEGA_M,
    PLANT_STATES,
    STATES,
    THETA_J,
    THETA_M,
)
from hil_forceps.model.composition import Physics, motor_viscosity_N_m_s_per_rad
from hil_forceps.model.linear.gains import (
    FROM_JAW,
    FROM_MOTOR,
    FROM_STRETCH,
    JAW_MEAN,
    JAW_SLOPE,
    JAW_SPEED,
    JAW_WAY,
    MOTOR_MEAN,
    MOTOR_SPEED,
    MOTOR_WAY,
    SIZE,
    fill_gains,
)

Matrix = NDArray[np.float64]

TAUT, SLACK = 0, 1
_JUMP_INSTANTS = 16  # at which a jump may be, for its mean effect: the midpoint rule is then within 1e-3
FRICTION_MEMORY_S = 3e-3  # of dry friction where a mass may stick  # tuned: 0.5 to 20 ms tried on holds


@returning_arrays
def transition(p: Physics, period_s: float, stiff: bool) -> Matrix:
    """Return F (STATES²): the state a row on for a change of the state; wire taut (`stiff`) or slack."""
    g = np.empty(SIZE)
    k, c = (p.k, p.wire_damping_damping_N_s_per_m) if stiff else (0.0, 0.0)
    fill_gains(
        g,
        p.r_m,
        p.r_j,
        p.I_m,
        p.I_j,
        motor_viscosity_N_m_s_per_rad(p, 0.0),
        p.jaw_viscous_friction_viscosity_N_m_s_per_rad,
        k,
        c,
        period_s,
    )
    f = np.zeros((STATES, STATES))
    starts = (MOTOR_WAY, MOTOR_SPEED, JAW_WAY, JAW_SPEED)
    for i in range(PLANT_STATES):
        at = starts[i]
        f[i, THETA_M] = g[at + FROM_STRETCH] * p.r_m
        f[i, THETA_J] = -g[at + FROM_STRETCH] * p.r_j
        f[i, OMEGA_M] = g[at + FROM_MOTOR]
        f[i, OMEGA_J] = g[at + FROM_JAW]
        f[i, LOAD] = -g[at + JAW_MEAN]
        f[i, LOAD_SLOPE] = -period_s * (0.5 * g[at + JAW_MEAN] + g[at + JAW_SLOPE])
        f[i, FRICTION_M] = -g[at + MOTOR_MEAN]
        f[i, FRICTION_J] = -g[at + JAW_MEAN]
        f[i, COMMAND_ERROR] = p.K_t * g[at + MOTOR_MEAN]
    for i in range(STATES):
        f[i, i] += 0.0 if i in (OMEGA_M, OMEGA_J) else 1.0
    f[LOAD, LOAD_SLOPE] = period_s
    return f


@subroutine
def friction_kept(period_s: float) -> float:
    """Return how much of a friction torque is kept over a row where a mass may stick."""
    return math.exp(-period_s / FRICTION_MEMORY_S)


@returning_arrays
def jump_covariance(p: Physics, period_s: float) -> Matrix:
    """Return the second moment (STATES²) of what a unit jump of the load does, anywhere within a row."""
    total = np.zeros((STATES, STATES))
    for i in range(_JUMP_INSTANTS):
        f = transition(p, period_s * (i + 0.5) / _JUMP_INSTANTS, True)
        answer = np.zeros(STATES)
        answer[:PLANT_STATES] = f[:PLANT_STATES, LOAD]
        answer[LOAD] = 1.0
        for j in range(STATES):
            total[j] += answer[j] * answer / _JUMP_INSTANTS
    return total


@subroutine
def stiffened(f: Matrix, stiffness: float, period_s: float, out: Matrix) -> None:
    """Fill `out` with F where the load answers to the jaw's angle: evenly over a row, by what the jaw moves."""
    for i in range(STATES):
        for j in range(STATES):
            out[i, j] = f[i, j]
    per = elastic_share(f, stiffness, period_s)
    for j in range(STATES):
        moved = per * (f[THETA_J, j] - (1.0 if j == THETA_J else 0.0))
        for i in range(PLANT_STATES):
            out[i, j] += f[i, LOAD_SLOPE] * moved
        out[LOAD, j] += period_s * moved


@subroutine
def elastic_share(f: Matrix, stiffness: float, period_s: float) -> float:
    """Return the slope of an elastic load per angle by which the jaw would move without it."""
    share: float = stiffness / period_s / (1.0 - f[THETA_J, LOAD_SLOPE] * stiffness / period_s)
    return share
