"""The truth plant with the catalogue's effects: the pieces of physics, one kernel each, and one RK4 step.

What remembers without a time of its own (presliding, hysteresis) is a function of the way since the start of the step,
which is exact while the way has one direction. Dry friction has a side while a body moves and holds it while it can.
"""

import math
from typing import NamedTuple

from virtual_bus.effects.numbers import EffectNumbers
from virtual_bus.kernel import kernel
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


@kernel
def current_at(u: Inputs, offset_s: float) -> float:
    """Return the true current after a part of the segment: its target, or on the way there with the lag."""
    if u.lag_s == 0.0:
        return u.target_A
    return u.target_A + (u.start_A - u.target_A) * math.exp(-offset_s / u.lag_s)


@kernel
def dead_zone(value: float, half_width: float) -> float:
    """Return what lies beyond ±half_width."""
    if value > half_width:
        return value - half_width
    if value < -half_width:
        return value + half_width
    return 0.0


@kernel
def slipped(z: float, way: float, length: float) -> float:
    """Return the state of a Dahl element after a way of one direction: the solution of z' = (1 − z sgn)/length."""
    if way == 0.0:
        return z
    side = 1.0 if way > 0.0 else -1.0
    return side + (z - side) * math.exp(-abs(way) / length)


@kernel
def warmed(change: float, time_constant_s: float, time_s: float) -> float:
    """Return 1 + c (1 − exp(−t/T)); nothing has warmed before time 0."""
    if change == 0.0 or time_s <= 0.0:
        return 1.0
    return 1.0 - change * math.expm1(-time_s / time_constant_s)


@kernel
def wave(sine: float, cosine: float, phase: float) -> float:
    """Return S sin + C cos; nothing without amplitudes."""
    if sine == 0.0 and cosine == 0.0:
        return 0.0
    return sine * math.sin(phase) + cosine * math.cos(phase)


@kernel
def encoder_angle(theta_m: float, e: EffectNumbers) -> float:
    """Return θ_enc before it is counted, rad."""
    return theta_m * (1.0 + e.encoder_error) + wave(e.encoder_sine, e.encoder_cosine, theta_m)


@kernel
def pulley_radius(theta_m: float, p: TruthParameters, e: EffectNumbers) -> float:
    """Return the effective radius r(θ_m) of the motor pulley in m."""
    eccentric = 1.0 + wave(e.pulley_sine, e.pulley_cosine, theta_m)
    return p.motor_pulley_radius_m * eccentric + e.spool_pitch * theta_m / (2.0 * math.pi)


@kernel
def wound(theta_m: float, p: TruthParameters, e: EffectNumbers) -> float:
    """Return the wire wound up in m: the integral of the radius from θ_m = 0 on."""
    length = p.motor_pulley_radius_m * theta_m
    if e.pulley_sine != 0.0 or e.pulley_cosine != 0.0:
        eccentric = e.pulley_cosine * math.sin(theta_m) + e.pulley_sine * (1.0 - math.cos(theta_m))
        length += p.motor_pulley_radius_m * eccentric
    return length + e.spool_pitch * theta_m**2 / (4.0 * math.pi)


@kernel
def played(behind: float, way: float, play: float) -> float:
    """Return by how much the pulley is behind the motor after a way of one direction: it is taken along at ±play."""
    behind += way
    if behind > play:
        return play
    return -play if behind < -play else behind


@kernel
def behind_at(m: Motion, memory: Memory, e: EffectNumbers) -> float:
    """Return by how much the pulley is behind the motor, rad."""
    return played(memory.behind, m.theta_m - memory.theta_m, e.play) if e.play > 0.0 else 0.0


@kernel
def jaw_lever(theta_j: float, p: TruthParameters, e: EffectNumbers) -> float:
    """Return the lever at which the wire pulls the jaw, m."""
    return p.jaw_pulley_radius_m * (1.0 + wave(e.lever_sine, e.lever_cosine, theta_j))


@kernel
def taken_by_jaw(theta_j: float, p: TruthParameters, e: EffectNumbers) -> float:
    """Return the wire that the jaw has taken from angle 0 on in m: the integral of its lever."""
    length = p.jaw_pulley_radius_m * theta_j
    if e.lever_sine != 0.0 or e.lever_cosine != 0.0:
        # 1 − cos, without cancellation near angle 0
        length += p.jaw_pulley_radius_m * (
            e.lever_cosine * math.sin(theta_j) + 2.0 * e.lever_sine * math.sin(0.5 * theta_j) ** 2
        )
    return length


@kernel
def elongation_of(theta_p: float, theta_j: float, p: TruthParameters, e: EffectNumbers) -> float:
    """Return x in m for a motor pulley at `theta_p`: the motor's angle less what the play takes off."""
    return wound(theta_p, p, e) - taken_by_jaw(theta_j, p, e)


@kernel
def tension_of(m: Motion, memory: Memory, p: TruthParameters, e: EffectNumbers) -> float:
    """Return the tension of the wire in N."""
    behind = behind_at(m, memory, e)
    x = elongation_of(m.theta_m - behind, m.theta_j, p, e)
    stretch = dead_zone(x - e.stretch - m.creep, e.slack)
    force = p.wire_stiffness_N_per_m * stretch * (1.0 + e.beta * stretch**2)
    if e.damping != 0.0 and (stretch != 0.0 or e.slack == 0.0):
        taken_along = e.play == 0.0 or (abs(behind) >= e.play and behind * m.omega_m > 0.0)
        winding = pulley_radius(m.theta_m - behind, p, e) * m.omega_m if taken_along else 0.0
        force += e.damping * (winding - jaw_lever(m.theta_j, p, e) * m.omega_j)
    if e.hysteresis_force != 0.0:
        force += e.hysteresis_force * slipped(memory.hysteresis, x - memory.elongation, e.hysteresis_stretch)
    return force


@kernel
def motor_drive(
    m: Motion, memory: Memory, current_A: float, time_s: float, tension: float, p: TruthParameters, e: EffectNumbers
) -> float:
    """Return all torque on the motor pulley but its dry friction, N m."""
    constant = p.torque_constant_N_m_per_A * warmed(e.constant_change, e.constant_time, time_s)
    torque = constant * current_A * (1.0 + wave(e.ripple_sine, e.ripple_cosine, e.ripple_harmonic * m.theta_m))
    torque += wave(e.cogging_sine, e.cogging_cosine, e.cogging_harmonic * m.theta_m)
    torque -= p.motor_viscous_N_m_s_per_rad * warmed(e.viscous_change, e.viscous_time, time_s) * m.omega_m
    if e.viscous_asymmetry * m.omega_m > 0.0:
        torque -= abs(e.viscous_asymmetry) * m.omega_m
    if e.presliding_level != 0.0:
        torque -= e.presliding_level * slipped(memory.presliding, m.theta_m - memory.theta_m, e.presliding_angle)
    if e.loaded_mu != 0.0:
        grip = slipped(memory.loaded, m.theta_m - memory.theta_m, e.loaded_angle)
        torque -= e.loaded_mu * p.motor_pulley_radius_m * abs(tension) * grip
    return torque - pulley_radius(m.theta_m - behind_at(m, memory, e), p, e) * tension


@kernel
def motor_level(side: float, omega_m: float, tension: float, p: TruthParameters, e: EffectNumbers) -> float:
    """Return the motor's dry friction against motion to one side, N m."""
    level = p.motor_coulomb_N_m + e.mu * p.motor_pulley_radius_m * abs(tension)
    if e.stribeck_rise != 0.0:
        level += e.stribeck_rise * math.exp(-((omega_m / e.stribeck_speed) ** 2))
    if e.film_level != 0.0:
        level -= e.film_level * math.expm1(-abs(omega_m) / e.film_speed)
    if e.asymmetry * side > 0.0:
        level += abs(e.asymmetry)
    return level


@kernel
def jaw_load(theta_j: float, load_N_m: float, env: Environment) -> float:
    """Return τ_w in N m: what the profile says, and the spring."""
    if env.stiffness_N_m_per_rad > 0.0 and theta_j > env.angle_rad:
        return load_N_m + env.stiffness_N_m_per_rad * (theta_j - env.angle_rad)
    return load_N_m


@kernel
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
    weight = wave(e.gravity_sine, e.gravity_cosine, theta_j)
    held = e.coupling_stiffness * theta_j + e.coupling_torque + e.jaw_viscous * omega_j
    if e.grip_level != 0.0 or e.grip_mu != 0.0:
        grip = slipped(memory.gripped, theta_j - memory.theta_j, e.grip_angle)
        held += (e.grip_level + e.grip_mu * p.jaw_pulley_radius_m * abs(tension)) * grip
    return jaw_lever(theta_j, p, e) * tension - weight - held - jaw_load(theta_j, load_N_m, env)


@kernel
def jaw_level(theta_j: float, p: TruthParameters, e: EffectNumbers) -> float:
    """Return the jaw's dry friction, N m."""
    return max(0.0, p.jaw_coulomb_N_m + e.jaw_slope * theta_j + e.jaw_curvature * theta_j**2)


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
        alpha_m = (torque - memory.side_m * motor_level(memory.side_m, omega_m, tension, p, e)) / p.motor_inertia_kg_m2
    if memory.side_j != 0.0:
        omega_j = m.omega_j
        torque = jaw_drive(m.theta_j, m.omega_j, memory, tension, u.load_N_m + u.load_slope * offset_s, p, e, env)
        alpha_j = (torque - memory.side_j * jaw_level(m.theta_j, p, e)) / p.jaw_inertia_kg_m2
    if e.creep_share != 0.0:
        creep = (e.creep_share * tension / p.wire_stiffness_N_per_m - m.creep) / e.creep_time
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


@kernel
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
