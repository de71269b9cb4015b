"""Jaw torque and jaw angle from the motor's side of a transmission whose friction has memory: one step per sample.

The paper's balance (1)-(3) has Coulomb friction and one ratio. A wire in a long shaft, led over pulleys, has friction
that builds up over a displacement (Dahl, "A solid friction model", 1968; a sum of such elements as in Al-Bender,
Lampaert, Swevers, IEEE TAC 50(11), 2005), grows with the tension (capstan) and varies along the stroke, as the ratio
does. With x the low-passed pulley angle θ scaled to −1 … 1 over its range, u the input at the pulley (torque or
current), ω and α speed and acceleration, z_i the friction elements, and s = tanh(ω/ω_0) friction that reverses at once,
as a rotor's,

    τ̂_w = Σ c_p x^p + u Σ a_p x^p + Σ_i z_i (Σ f_ip x^p + u Σ h_ip x^p) + s (Σ d_p x^p + u Σ e_p x^p)
          + (b + b' u) ω + J α
    θ̂_j = the same with other coefficients, and ρ θ in place of c_1 x

    dz_i = (1 − z_i sgn dθ_d) / δ_i dθ_d + e^(−|dθ_d| / δ_0) du / u_0,  |z_i| ≤ 1

θ_d is the angle of the motor's own encoder if there is one (its motion through the play of a gear counts), else θ. At
rest, friction responds to force instead of displacement. It takes up a changing u, over u_0, so that hardly any of it
reaches the wire (stiction; Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994). The first equation is
the balance at the jaw; the second is (3) with the wire's stretch by tension and friction. Both are linear in everything
but δ_i, u_0 and the corner of the low-pass. Outside its range, where nothing was fitted, x is held at ±1; ρ θ
continues. The estimates are causal and assume nothing about the load.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.estimation.kernel import kernel, returning_arrays, subroutine

Vector = NDArray[np.float64]
State = NDArray[np.float64]

ELEMENTS = 3
_SHAPE, _GAIN, _FRICTION, _LOADED, _SUDDEN = 4, 3, 4, 2, 2  # number of powers of x in each group
TERMS = _SHAPE + _GAIN + ELEMENTS * (_FRICTION + _LOADED) + 2 * _SUDDEN + 3
MAX_REST_RAD_PER_S = 0.02  # ω_0: at lower speeds the direction is uncertain
MAX_REST_RAD = 3e-5  # δ_0: larger displacements in a sample are motion, not rest
TERM_DRIVE = _SHAPE  # the term u itself, low-passed
TERM_SPEED = TERMS - 3
_SLOPE = 1  # the term x; for the jaw's angle it isn't held at the ends of the range

TAU_W, THETA_J = 3, 4
_TIME, _DRIVE_ANGLE, _FIRST = 0, 1, 5  # of a state; from _FIRST on the low-passes, two poles each, then the elements
_LOW_PASSES = 3  # of θ, θ_d and u
_Z = _FIRST + 2 * _LOW_PASSES
_SIZE = _Z + ELEMENTS
_CORNER, _MIDDLE, _HALF, _STANDSTILL, _LENGTHS = 0, 1, 2, 3, 4  # of the constants
_TORQUE = _LENGTHS + ELEMENTS
_ANGLE = _TORQUE + TERMS


class Structure(NamedTuple):
    """The parameters in which the model isn't linear."""

    corner_rad_per_s: float  # of the low-pass, two equal poles
    presliding_rad: tuple[float, float, float]  # δ_i
    range_rad: tuple[float, float]  # of θ where the model was fitted
    standstill: float = 0.0  # u_0, in the unit of u; 0: friction at rest doesn't respond to u


class Sample(NamedTuple):
    """Measurements on the motor's side at one instant."""

    time_ns: int
    theta_m_rad: float
    theta_drive_rad: float  # θ_m again where the motor has no encoder of its own
    drive: float  # u in N m or A, as in the fit


def constants(structure: Structure, torque: Vector | None = None, angle: Vector | None = None) -> Vector:
    """Return the constants of the kernels; `torque` and `angle` are coefficients [TERMS], zero if not known yet."""
    low, high = structure.range_rad
    if not high > low or not structure.corner_rad_per_s > 0 or not min(structure.presliding_rad) > 0:
        raise ValueError(f"range, corner and presliding lengths must be positive, got {structure}")
    if not structure.standstill >= 0:
        raise ValueError(f"standstill must be 0 or positive, got {structure}")
    head = [structure.corner_rad_per_s, 0.5 * (low + high), 0.5 * (high - low), structure.standstill]
    head += structure.presliding_rad
    nothing = np.zeros(TERMS)
    return np.concatenate([head, nothing if torque is None else torque, nothing if angle is None else angle])


@kernel
def start(c: Vector, time_ns: int, theta_m_rad: float, theta_drive_rad: float, drive: float) -> State:
    """Return the state after the first sample: at rest, friction elements at 0."""
    state = np.zeros(_SIZE)
    state[_TIME] = float(time_ns)
    state[_DRIVE_ANGLE] = theta_drive_rad
    for pole in range(2):
        state[_FIRST + pole] = theta_m_rad
        state[_FIRST + 2 + pole] = theta_drive_rad
        state[_FIRST + 4 + pole] = drive
    return _with_estimates(state, c)


@kernel
def step(state: State, c: Vector, time_ns: int, theta_m_rad: float, theta_drive_rad: float, drive: float) -> State:
    """Return the state after a sample; the same state when its stamp isn't later than the last."""
    dt_s = (time_ns - state[_TIME]) * 1e-9
    if dt_s <= 0.0:
        return state
    new = state.copy()
    new[_TIME] = float(time_ns)
    new[_DRIVE_ANGLE] = theta_drive_rad
    share = 1.0 - np.exp(-c[_CORNER] * dt_s)
    inputs = (theta_m_rad, theta_drive_rad, drive)
    for n in range(_LOW_PASSES):
        first = _FIRST + 2 * n
        new[first] += share * (inputs[n] - new[first])
        new[first + 1] += share * (new[first] - new[first + 1])
    way = theta_drive_rad - state[_DRIVE_ANGLE]
    limit = 1.0 if way > 0.0 else -1.0
    taken = 0.0
    if c[_STANDSTILL] > 0.0:
        taken = np.exp(-abs(way) / MAX_REST_RAD) * (new[_FIRST + 5] - state[_FIRST + 5]) / c[_STANDSTILL]
    for n in range(ELEMENTS):
        z = min(1.0, max(-1.0, new[_Z + n] + taken))
        new[_Z + n] = limit + (z - limit) * np.exp(-abs(way) / c[_LENGTHS + n])
    return _with_estimates(new, c)


@kernel
def _fill(state: State, c: Vector, row: Vector) -> float:
    """Fill `row` [TERMS] with the terms of the model; return x before it is held within the range."""
    free: float = (state[_FIRST + 1] - c[_MIDDLE]) / c[_HALF]
    x = min(1.0, max(-1.0, free))
    drive = state[_FIRST + 5]
    # speed and acceleration from the low-pass itself, without differences
    speed = c[_CORNER] * (state[_FIRST + 2] - state[_FIRST + 3])
    acceleration = c[_CORNER] * (c[_CORNER] * (state[_DRIVE_ANGLE] - state[_FIRST + 2]) - speed)
    at = _powers(row, 0, x, _SHAPE, 1.0)
    at = _powers(row, at, x, _GAIN, drive)
    for n in range(ELEMENTS):
        at = _powers(row, at, x, _FRICTION, state[_Z + n])
        at = _powers(row, at, x, _LOADED, state[_Z + n] * drive)
    direction = np.tanh(speed / MAX_REST_RAD_PER_S)
    at = _powers(row, at, x, _SUDDEN, direction)
    at = _powers(row, at, x, _SUDDEN, direction * drive)
    row[at] = speed
    row[at + 1] = speed * drive
    row[at + 2] = acceleration
    return free


@subroutine
def _powers(row: Vector, at: int, x: float, count: int, factor: float) -> int:
    value = factor
    for n in range(count):
        row[at + n] = value
        value *= x
    return at + count


@returning_arrays
def _with_estimates(state: State, c: Vector) -> State:
    row = np.empty(TERMS)
    free = _fill(state, c, row)
    torque = 0.0
    angle = (free - row[_SLOPE]) * c[_ANGLE + _SLOPE]
    for n in range(TERMS):
        torque += row[n] * c[_TORQUE + n]
        angle += row[n] * c[_ANGLE + n]
    state[TAU_W] = torque
    state[THETA_J] = angle
    return state


@kernel
def run(
    c: Vector, time_ns: NDArray[np.int64], theta_m_rad: Vector, theta_drive_rad: Vector, drive: Vector
) -> tuple[Vector, Vector]:
    """Return τ̂_w [N m] and θ̂_j [rad] at each sample: `start` and `step` over arrays of one length."""
    samples = time_ns.shape[0]
    tau_w, theta_j = np.empty(samples), np.empty(samples)
    state = start(c, time_ns[0], theta_m_rad[0], theta_drive_rad[0], drive[0])
    for n in range(samples):
        if n > 0:
            state = step(state, c, time_ns[n], theta_m_rad[n], theta_drive_rad[n], drive[n])
        tau_w[n] = state[TAU_W]
        theta_j[n] = state[THETA_J]
    return tau_w, theta_j


@kernel
def terms(
    c: Vector, time_ns: NDArray[np.int64], theta_m_rad: Vector, theta_drive_rad: Vector, drive: Vector
) -> tuple[Vector, Vector]:
    """Return the model's terms [samples, TERMS] for a fit, and x [samples] before it is held within the range."""
    samples = time_ns.shape[0]
    rows, free = np.empty((samples, TERMS)), np.empty(samples)
    state = start(c, time_ns[0], theta_m_rad[0], theta_drive_rad[0], drive[0])
    for n in range(samples):
        if n > 0:
            state = step(state, c, time_ns[n], theta_m_rad[n], theta_drive_rad[n], drive[n])
        free[n] = _fill(state, c, rows[n])
    return rows, free


def for_angle(rows: Vector, free: Vector) -> Vector:
    """Return the terms for the jaw's angle, in which x isn't held at the ends of the range."""
    changed = rows.copy()
    changed[:, _SLOPE] = free
    return changed


def term_names() -> tuple[str, ...]:
    """Return the model's terms in words, in the order of the coefficients; u is the input."""
    groups = [("", _SHAPE), ("u", _GAIN)]
    for n in range(1, ELEMENTS + 1):
        groups += [(f"z{n}", _FRICTION), (f"z{n} u", _LOADED)]
    groups += [("s", _SUDDEN), ("s u", _SUDDEN)]
    names = [f"{head} x^{power}".strip() for head, count in groups for power in range(count)]
    return (*names, "speed", "speed u", "acceleration")
