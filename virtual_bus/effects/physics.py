"""The truth plant with the catalogue's effects: the pieces of physics, one kernel each, and one RK4 step.

What remembers without a time of its own (presliding, hysteresis) is a function of the way since the start of the step,
which is exact while the way has one direction. Dry friction has a side while a body moves and holds it while it can.
"""

import math
from typing import NamedTuple

from virtual_bus.effects.composition import (
    EffectNumbers,
    jaw_friction_N_m,
    jaw_load_N_m,
    lever_m,
    motor_drag_N_m,
    motor_friction_N_m,
    motor_torque_N_m,
    radius_m,
    relative_torque,
    relative_torque_constant,
    relative_viscosity,
    taken_m,
    wound_m,
)
from virtual_bus.kernel import kernel, subroutine
from virtual_bus.plant.plant import TruthParameters


class Motion(NamedTuple):
    """What the integrator moves, or its rate of change; rad, rad/s, m."""

    theta_m: float
    omega_m: float
    theta_j: float
    omega_j: float
    creep: float  # x_c


class Memory(NamedTuple):
    """What a step takes as it was at its start."""

    theta_m: float
    theta_j: float
    elongation: float
    presliding: float  # z of the motor's micro-slip
    hysteresis: float  # z of the wire
    side_m: float  # direction in which dry friction brakes the motor: ±1, or 0 while it holds
    side_j: float
    behind: float  # the pulley is behind the motor by this within the play, rad
    loaded: float  # z of the micro-slip that grows with tension
    gripped: float  # z of the jaw's micro-slip


class Environment(NamedTuple):
    """A spring at the jaw beyond an angle: part of τ_w. No stiffness: none."""

    stiffness_N_m_per_rad: float
    angle_rad: float


class Inputs(NamedTuple):
    """What acts from the start of a segment on; `time_s` is what drifts count."""

    target_A: float
    start_A: float
    lag_s: float
    load_N_m: float
    load_slope: float
    time_s: float


@subroutine
def current_at(u: Inputs, offset_s: float) -> float:
    """Return the true current after a part of the segment: its target, or on the way there with the lag."""
    if u.lag_s == 0.0:
        return u.target_A
    return u.target_A + (u.start_A - u.target_A) * math.exp(-offset_s / u.lag_s)


@subroutine
def dead_zone(value: float, half_width: float) -> float:
    """Return what lies beyond ±half_width."""
    if value > half_width:
        return value - half_width
    if value < -half_width:
        return value + half_width
    return 0.0


@subroutine
def slipped(z: float, way: float, length: float) -> float:
    """Return the state of a Dahl element after a way of one direction: the solution of z' = (1 − z sgn)/length."""
    if way == 0.0:
        return z
    side = 1.0 if way > 0.0 else -1.0
    return side + (z - side) * math.exp(-abs(way) / length)


@kernel
def played(behind: float, way: float, play: float) -> float:
    """Return by how much the pulley is behind the motor after a way of one direction: it is taken along at ±play."""
    behind += way
    if behind > play:
        return play
    return -play if behind < -play else behind


@subroutine
def behind_at(m: Motion, memory: Memory, e: EffectNumbers) -> float:
    """Return by how much the pulley is behind the motor, rad."""
    return (
        played(memory.behind, m.theta_m - memory.theta_m, e.transmission_play_half_width_rad)
        if e.transmission_play_half_width_rad > 0.0
        else 0.0
    )


@kernel
def elongation_of(theta_p: float, theta_j: float, p: TruthParameters, e: EffectNumbers) -> float:
    """Return x in m for a motor pulley at `theta_p`: the motor's angle less what the play takes off."""
    return wound_m(p, e, theta_p) - taken_m(p, e, theta_j)


@kernel
def tension_of(m: Motion, memory: Memory, p: TruthParameters, e: EffectNumbers) -> float:
    """Return the tension of the wire in N."""
    behind = behind_at(m, memory, e)
    x = elongation_of(m.theta_m - behind, m.theta_j, p, e)
    stretch = dead_zone(x - e.wire_permanent_stretch_stretch_m - m.creep, e.wire_slack_half_width_m)
    force = p.wire_stiffness_N_per_m * stretch * (1.0 + e.wire_hardening_beta_per_m2 * stretch**2)
    if e.wire_damping_damping_N_s_per_m != 0.0 and (stretch != 0.0 or e.wire_slack_half_width_m == 0.0):
        taken_along = e.transmission_play_half_width_rad == 0.0 or (
            abs(behind) >= e.transmission_play_half_width_rad and behind * m.omega_m > 0.0
        )
        winding = radius_m(p, e, m.theta_m - behind) * m.omega_m if taken_along else 0.0
        force += e.wire_damping_damping_N_s_per_m * (winding - lever_m(p, e, m.theta_j) * m.omega_j)
    if e.wire_hysteresis_force_N != 0.0:
        force += e.wire_hysteresis_force_N * slipped(
            memory.hysteresis, x - memory.elongation, e.wire_hysteresis_stretch_m
        )
    return force


@subroutine
def motor_drive(
    m: Motion, memory: Memory, current_A: float, time_s: float, tension: float, p: TruthParameters, e: EffectNumbers
) -> float:
    """Return all torque on the motor pulley but its dry friction, N m."""
    constant = p.torque_constant_N_m_per_A * (1.0 + relative_torque_constant(p, e, time_s))
    torque = constant * current_A * (1.0 + relative_torque(p, e, m.theta_m)) + motor_torque_N_m(p, e, m.theta_m)
    torque -= p.motor_viscous_N_m_s_per_rad * (1.0 + relative_viscosity(p, e, time_s)) * m.omega_m
    torque -= motor_drag_N_m(p, e, m.omega_m)
    if e.presliding_friction_level_N_m != 0.0:
        torque -= e.presliding_friction_level_N_m * slipped(
            memory.presliding, m.theta_m - memory.theta_m, e.presliding_friction_angle_rad
        )
    if e.loaded_presliding_mu != 0.0:
        grip = slipped(memory.loaded, m.theta_m - memory.theta_m, e.loaded_presliding_angle_rad)
        torque -= e.loaded_presliding_mu * p.motor_pulley_radius_m * abs(tension) * grip
    return torque - radius_m(p, e, m.theta_m - behind_at(m, memory, e)) * tension


@subroutine
def jaw_load(theta_j: float, load_N_m: float, env: Environment) -> float:
    """Return τ_w in N m: what the profile says, and the spring."""
    if env.stiffness_N_m_per_rad > 0.0 and theta_j > env.angle_rad:
        return load_N_m + env.stiffness_N_m_per_rad * (theta_j - env.angle_rad)
    return load_N_m


@subroutine
def jaw_drive(
    theta_j: float,
    omega_j: float,
    memory: Memory,
    tension: float,
    load_N_m: float,
    p: TruthParameters,
    e: EffectNumbers,
    env: Environment,
) -> float:
    """Return all torque on the jaw but its dry friction, N m."""
    held = jaw_load_N_m(p, e, theta_j, omega_j)
    if e.jaw_presliding_level_N_m != 0.0 or e.jaw_presliding_mu != 0.0:
        grip = slipped(memory.gripped, theta_j - memory.theta_j, e.jaw_presliding_angle_rad)
        held += (e.jaw_presliding_level_N_m + e.jaw_presliding_mu * p.jaw_pulley_radius_m * abs(tension)) * grip
    return lever_m(p, e, theta_j) * tension - held - jaw_load(theta_j, load_N_m, env)


@subroutine
def jaw_level(theta_j: float, p: TruthParameters, e: EffectNumbers) -> float:
    """Return the jaw's dry friction, N m."""
    return max(0.0, jaw_friction_N_m(p, e, theta_j))


@kernel
def motion_rate(
    m: Motion, memory: Memory, u: Inputs, offset_s: float, p: TruthParameters, e: EffectNumbers, env: Environment
) -> Motion:
    """Time derivative of the motion; a body that friction holds doesn't move."""
    tension = tension_of(m, memory, p, e)
    omega_m, omega_j, alpha_m, alpha_j, creep = 0.0, 0.0, 0.0, 0.0, 0.0
    if memory.side_m != 0.0:
        omega_m = m.omega_m
        torque = motor_drive(m, memory, current_at(u, offset_s), u.time_s + offset_s, tension, p, e)
        alpha_m = (
            torque - memory.side_m * motor_friction_N_m(p, e, memory.side_m, omega_m, tension)
        ) / p.motor_inertia_kg_m2
    if memory.side_j != 0.0:
        omega_j = m.omega_j
        torque = jaw_drive(m.theta_j, m.omega_j, memory, tension, u.load_N_m + u.load_slope * offset_s, p, e, env)
        alpha_j = (torque - memory.side_j * jaw_level(m.theta_j, p, e)) / p.jaw_inertia_kg_m2
    if e.wire_creep_share != 0.0:
        creep = (e.wire_creep_share * tension / p.wire_stiffness_N_per_m - m.creep) / e.wire_creep_time_constant_s
    return Motion(omega_m, alpha_m, omega_j, alpha_j, creep)


@kernel
def shifted(m: Motion, rate: Motion, time_s: float) -> Motion:
    """Return the motion after `time_s` at a constant rate."""
    return Motion(
        m.theta_m + time_s * rate.theta_m,
        m.omega_m + time_s * rate.omega_m,
        m.theta_j + time_s * rate.theta_j,
        m.omega_j + time_s * rate.omega_j,
        m.creep + time_s * rate.creep,
    )


@subroutine
def runge_kutta(
    m: Motion,
    memory: Memory,
    u: Inputs,
    offset_s: float,
    step_s: float,
    p: TruthParameters,
    e: EffectNumbers,
    env: Environment,
) -> Motion:
    """One classical Runge-Kutta step, each body's friction on one side throughout."""
    half = 0.5 * step_s
    k1 = motion_rate(m, memory, u, offset_s, p, e, env)
    k2 = motion_rate(shifted(m, k1, half), memory, u, offset_s + half, p, e, env)
    k3 = motion_rate(shifted(m, k2, half), memory, u, offset_s + half, p, e, env)
    k4 = motion_rate(shifted(m, k3, step_s), memory, u, offset_s + step_s, p, e, env)
    sixth = step_s / 6.0
    m = shifted(shifted(m, k1, sixth), k2, 2.0 * sixth)
    return shifted(shifted(m, k3, 2.0 * sixth), k4, sixth)
