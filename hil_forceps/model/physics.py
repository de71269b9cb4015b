"""The plant with every effect of the catalogue: its numbers and its forces, as scalar functions.

The equations are those at the head of `hil_forceps/rig/catalogue.py`.
"""

import math
from typing import NamedTuple

from hil_forceps.model.kernel import inlined

_TURN = 2.0 * math.pi
_ROUNDS = 12  # of Newton's method


class Physics(NamedTuple):
    """The vector of `parameters.NAMES`, in its order, under short names."""

    r_m: float
    r_j: float
    I_m: float
    I_j: float
    D_m: float
    motor_coulomb: float
    jaw_coulomb: float
    k: float
    K_t: float
    stribeck_rise: float
    stribeck_speed: float
    presliding_level: float
    presliding_angle: float
    load_mu: float
    asymmetry: float
    viscous_change: float
    viscous_time: float
    jaw_slope: float
    jaw_curvature: float
    gravity_sine: float
    gravity_cosine: float
    slack: float
    hardening: float
    loop_force: float
    loop_stretch: float
    creep_share: float
    creep_time: float
    damping: float
    zero_stretch: float
    constant_change: float
    constant_time: float
    cogging_sine: float
    cogging_cosine: float
    cogging_harmonic: float
    ripple_sine: float
    ripple_cosine: float
    ripple_harmonic: float
    current_offset: float
    current_gain: float
    deadband: float
    lag: float
    delay: float
    skew_theta_m: float
    skew_current: float
    skew_theta_j: float
    skew_tau_w: float
    encoder_sine: float
    encoder_cosine: float
    encoder_scale: float
    pulley_sine: float
    pulley_cosine: float
    pitch: float
    limit: float
    play: float
    lever_sine: float
    lever_cosine: float
    coupling_stiffness: float
    coupling_torque: float
    loaded_mu: float
    loaded_angle: float
    viscous_asymmetry: float
    film_level: float
    film_speed: float
    grip_level: float
    grip_mu: float
    grip_angle: float
    jaw_viscous: float


class State(NamedTuple):
    """The plant's state."""

    theta_m_rad: float
    omega_m_rad_per_s: float
    theta_j_rad: float
    omega_j_rad_per_s: float
    creep_m: float  # x_c
    loop: float  # z of the wire's hysteresis
    presliding: float  # z of the motor's presliding
    loaded: float  # z of the presliding that grows with tension
    gripped: float  # z of the jaw's presliding
    lost_rad: float  # p: how far the pulley stays behind the motor
    current_A: float  # true current


class Kind(NamedTuple):
    """What a step can leave out, told once for all of them."""

    plain: bool  # nothing beyond the linear plant with constant friction is on
    straight: bool  # the wire is the linear plant's
    steady: bool  # nothing but friction's level hangs on the state


class Wire(NamedTuple):
    """The wire at an instant."""

    elongation_m: float  # wound(θ_p) − paid(θ_j)
    tension_N: float
    radius_m: float  # of the motor pulley where the wire leaves it
    lever_m: float  # at which it pulls the jaw
    slack: bool


@inlined
def dead_zone(value: float, half_width: float) -> float:
    """Return what of `value` lies beyond ±half_width."""
    return value - max(-half_width, min(half_width, value))


@inlined
def slide(state: float, way: float, length: float) -> float:
    """Return z after sliding `way`: z' = 1 − z sgn over way/length, exact."""
    if way > 0.0:
        return 1.0 + (state - 1.0) * math.exp(-way / length)
    if way < 0.0:
        return -1.0 + (state + 1.0) * math.exp(way / length)
    return state


@inlined
def wound_m(p: Physics, theta_m: float) -> float:
    """Return the length of wire wound up from θ_m = 0 on, the integral of the radius."""
    wound = p.r_m * theta_m
    if p.pulley_cosine != 0.0 or p.pulley_sine != 0.0:
        wound += p.r_m * (p.pulley_cosine * math.sin(theta_m) + p.pulley_sine * (1.0 - math.cos(theta_m)))
    return wound + p.pitch * theta_m * theta_m / (2.0 * _TURN)


@inlined
def radius_m(p: Physics, theta_m: float) -> float:
    """Return the effective radius of the motor pulley."""
    radius = p.r_m
    if p.pulley_cosine != 0.0 or p.pulley_sine != 0.0:
        radius += p.r_m * (p.pulley_cosine * math.cos(theta_m) + p.pulley_sine * math.sin(theta_m))
    return radius + p.pitch * theta_m / _TURN


@inlined
def paid_m(p: Physics, theta_j: float) -> float:
    """Return the length of wire that the jaw takes from θ_j = 0 on, the integral of its lever."""
    paid = p.r_j * theta_j
    if p.lever_cosine != 0.0 or p.lever_sine != 0.0:
        paid += p.r_j * (p.lever_cosine * math.sin(theta_j) + p.lever_sine * (1.0 - math.cos(theta_j)))
    return paid


@inlined
def lever_m(p: Physics, theta_j: float) -> float:
    """Return the lever at which the wire pulls the jaw."""
    lever = p.r_j
    if p.lever_cosine != 0.0 or p.lever_sine != 0.0:
        lever += p.r_j * (p.lever_cosine * math.cos(theta_j) + p.lever_sine * math.sin(theta_j))
    return lever


@inlined
def paid_angle(p: Physics, length_m: float) -> float:
    """Return the jaw's angle at which it has taken a length of wire: Newton's method, exact without a lever's curve."""
    theta_j = length_m / p.r_j
    if p.lever_cosine != 0.0 or p.lever_sine != 0.0:
        for _ in range(_ROUNDS):
            theta_j -= (paid_m(p, theta_j) - length_m) / lever_m(p, theta_j)
    return theta_j


@inlined
def lost_after(p: Physics, lost_rad: float, way_rad: float) -> float:
    """Return how far the pulley stays behind after a way of the motor: the play operator, exact."""
    if p.play == 0.0:
        return 0.0
    return max(-p.play, min(p.play, lost_rad + way_rad))


@inlined
def followed(p: Physics, lost_rad: float, omega_m: float) -> float:
    """Return the pulley's speed: the motor's at the end of the play that it moves to, 0 within."""
    if p.play == 0.0 or lost_rad * omega_m >= p.play * abs(omega_m):
        return omega_m
    return 0.0


@inlined
def wire(
    p: Physics, theta_p: float, omega_p: float, theta_j: float, omega_j: float, creep_m: float, loop: float
) -> Wire:
    """Return the wire's state from the angles and speeds of motor pulley and jaw."""
    radius, lever = radius_m(p, theta_p), lever_m(p, theta_j)
    elongation = wound_m(p, theta_p) - paid_m(p, theta_j)
    stretch = dead_zone(elongation - p.zero_stretch - creep_m, p.slack)
    slack = stretch == 0.0 and p.slack > 0.0
    tension = p.k * stretch * (1.0 + p.hardening * stretch * stretch) + p.loop_force * loop
    if not slack:
        tension += p.damping * (radius * omega_p - lever * omega_j)
    return Wire(elongation, tension, radius, lever, slack)


@inlined
def gravity_N_m(p: Physics, theta_j: float) -> float:
    """Return the load of the jaw's weight."""
    if p.gravity_cosine == 0.0 and p.gravity_sine == 0.0:
        return 0.0
    return p.gravity_cosine * math.cos(theta_j) + p.gravity_sine * math.sin(theta_j)


@inlined
def coupling_N_m(p: Physics, theta_j: float) -> float:
    """Return the load of what the jaw is coupled to."""
    return p.coupling_stiffness * theta_j + p.coupling_torque


@inlined
def ripple(p: Physics, theta_m: float) -> float:
    """Return the relative change of the motor's torque with its angle."""
    if p.ripple_sine == 0.0 and p.ripple_cosine == 0.0:
        return 0.0
    phase = p.ripple_harmonic * theta_m
    return p.ripple_sine * math.sin(phase) + p.ripple_cosine * math.cos(phase)


@inlined
def cogging_N_m(p: Physics, theta_m: float) -> float:
    """Return the torque that the motor's angle makes without current."""
    if p.cogging_sine == 0.0 and p.cogging_cosine == 0.0:
        return 0.0
    phase = p.cogging_harmonic * theta_m
    return p.cogging_sine * math.sin(phase) + p.cogging_cosine * math.cos(phase)


@inlined
def motor_level_N_m(p: Physics, omega_m: float, tension_N: float) -> float:
    """Return the level of the motor's friction, the same in both directions."""
    level = p.motor_coulomb + p.load_mu * p.r_m * abs(tension_N)
    if p.stribeck_rise != 0.0:
        share = omega_m / p.stribeck_speed
        level += p.stribeck_rise * math.exp(-share * share)
    if p.film_level != 0.0:
        level += p.film_level * (1.0 - math.exp(-abs(omega_m) / p.film_speed))
    return level


@inlined
def motor_rest_N_m(p: Physics, tension_N: float) -> float:
    """Return the level of the motor's friction at standstill: `motor_level_N_m` at no speed, without an exponential."""
    return p.motor_coulomb + p.load_mu * p.r_m * abs(tension_N) + p.stribeck_rise


@inlined
def rub_N_m(p: Physics, presliding: float, loaded: float, tension_N: float) -> float:
    """Return the motor's friction that builds up over a way; `presliding` and `loaded` from −1 to 1."""
    rub = p.presliding_level * presliding
    if p.loaded_mu != 0.0:
        rub += p.loaded_mu * p.r_m * abs(tension_N) * loaded
    return rub


@inlined
def slid(p: Physics, presliding: float, loaded: float, way: float) -> tuple[float, float]:
    """Return the states of the motor's friction that builds up over a way, after a way."""
    if p.presliding_level != 0.0:
        presliding = slide(presliding, way, p.presliding_angle)
    if p.loaded_mu != 0.0:
        loaded = slide(loaded, way, p.loaded_angle)
    return presliding, loaded


@inlined
def grip_N_m(p: Physics, gripped: float, tension_N: float) -> float:
    """Return the jaw's friction that builds up over a way; `gripped` from −1 to 1."""
    return (p.grip_level + p.grip_mu * p.r_j * abs(tension_N)) * gripped


@inlined
def grips(p: Physics) -> bool:
    """Whether the jaw has friction that builds up over a way."""
    return p.grip_level != 0.0 or p.grip_mu != 0.0


@inlined
def jaw_level_N_m(p: Physics, theta_j: float) -> float:
    """Return the level of the jaw's friction."""
    return max(0.0, p.jaw_coulomb + (p.jaw_slope + p.jaw_curvature * theta_j) * theta_j)


@inlined
def encoder_rad(p: Physics, theta_m: float) -> float:
    """Return the angle that the encoder shows, before it counts."""
    angle = (1.0 + p.encoder_scale) * theta_m
    if p.encoder_sine != 0.0 or p.encoder_cosine != 0.0:
        angle += p.encoder_sine * math.sin(theta_m) + p.encoder_cosine * math.cos(theta_m)
    return angle


@inlined
def torque_constant(p: Physics, time_s: float) -> float:
    """Return K_t at a time."""
    if p.constant_change == 0.0:
        return p.K_t
    return p.K_t * (1.0 + p.constant_change * (1.0 - math.exp(-time_s / p.constant_time)))


@inlined
def viscosity(p: Physics, time_s: float) -> float:
    """Return D at a time, the mean of both directions."""
    mean = p.D_m + 0.5 * abs(p.viscous_asymmetry)
    if p.viscous_change == 0.0:
        return mean
    return mean + p.D_m * p.viscous_change * (1.0 - math.exp(-time_s / p.viscous_time))


@inlined
def unlike_N_m(p: Physics, omega_m: float) -> float:
    """Return how much more than their mean the viscous friction of one direction brakes: a torque, one way always."""
    return 0.5 * p.viscous_asymmetry * abs(omega_m)


@inlined
def kind_of(p: Physics) -> Kind:
    """Return what the steps of a plant can leave out."""
    of_wire = abs(p.slack) + abs(p.hardening) + abs(p.loop_force) + abs(p.creep_share) + abs(p.zero_stretch)
    of_wire += abs(p.pulley_sine) + abs(p.pulley_cosine) + abs(p.pitch) + abs(p.play)
    of_wire += abs(p.lever_sine) + abs(p.lever_cosine)
    motor = abs(p.presliding_level) + abs(p.viscous_change) + abs(p.loaded_mu) + abs(p.viscous_asymmetry)
    motor += abs(p.cogging_sine) + abs(p.cogging_cosine) + abs(p.ripple_sine) + abs(p.ripple_cosine)
    jaw = abs(p.gravity_sine) + abs(p.gravity_cosine) + abs(p.coupling_stiffness) + abs(p.coupling_torque)
    jaw += abs(p.grip_level) + abs(p.grip_mu)
    level = abs(p.stribeck_rise) + abs(p.load_mu) + abs(p.film_level) + abs(p.jaw_slope) + abs(p.jaw_curvature)
    steady = of_wire + motor + jaw == 0.0
    return Kind(steady and level == 0.0, of_wire == 0.0, steady)
