"""The plant with every effect of the catalogue: the scalar functions that a step consists of.

The equations are those at the head of `hil_forceps/rig/catalogue.py`. Effects that add to a torque, a level, a radius
or an angle are summed in `composition`. Here are the effects with memory (presliding, play) and the law of the wire.
"""

import math
from typing import NamedTuple

from hil_forceps.model.composition import (
    Physics,
    backward_friction_N_m,
    forward_friction_N_m,
    jaw_friction_N_m,
    level_changes,
    lever_m,
    paid_m,
    radius_m,
    relative_torque_constant,
    torque_changes,
    wire_changes,
    wound_m,
)
from hil_forceps.model.kernel import inlined

_NEWTON_ITERATIONS = 12  # of Newton's method


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
    lost_rad: float  # p: angle by which the pulley lags the motor
    current_A: float  # true current


class Kind(NamedTuple):
    """What every step of a plant can leave out."""

    plain: bool  # linear plant with constant dry friction
    straight: bool  # the wire is linear
    steady: bool  # only the level of dry friction depends on the state
    motor_directed: bool  # what brakes the motor depends on its direction
    jaw_directed: bool  # and the jaw


class Wire(NamedTuple):
    """The wire at an instant."""

    elongation_m: float  # wound(θ_p) − paid(θ_j)
    tension_N: float
    radius_m: float  # of the motor pulley where the wire leaves it
    lever_m: float  # at which it pulls the jaw
    slack: bool


@inlined
def dead_zone(value: float, half_width: float) -> float:
    """Return the part of `value` beyond ±half_width."""
    return value - max(-half_width, min(half_width, value))


@inlined
def slide(state: float, way: float, length: float) -> float:
    """Return z after a displacement `way` s: dz/ds = (1 − z sgn ds)/length, exact (Dahl)."""
    if way > 0.0:
        return 1.0 + (state - 1.0) * math.exp(-way / length)
    if way < 0.0:
        return -1.0 + (state + 1.0) * math.exp(way / length)
    return state


@inlined
def paid_angle(p: Physics, length_m: float) -> float:
    """Return the jaw's angle at which it has taken a length of wire; by Newton's method if the lever varies."""
    theta_j = length_m / p.r_j
    if p.transmission_curve_cosine != 0.0 or p.transmission_curve_sine != 0.0:
        for _ in range(_NEWTON_ITERATIONS):
            theta_j -= (paid_m(p, theta_j) - length_m) / lever_m(p, theta_j)
    return theta_j


@inlined
def lost_after(p: Physics, lost_rad: float, way_rad: float) -> float:
    """Return the angle by which the pulley lags after a displacement of the motor: the play operator, exact."""
    if p.transmission_play_half_width_rad == 0.0:
        return 0.0
    return max(-p.transmission_play_half_width_rad, min(p.transmission_play_half_width_rad, lost_rad + way_rad))


@inlined
def followed(p: Physics, lost_rad: float, omega_m: float) -> float:
    """Return the pulley's speed: the motor's where the play is taken up in its direction, else 0."""
    if p.transmission_play_half_width_rad == 0.0 or lost_rad * omega_m >= p.transmission_play_half_width_rad * abs(
        omega_m
    ):
        return omega_m
    return 0.0


@inlined
def wire(
    p: Physics, theta_p: float, omega_p: float, theta_j: float, omega_j: float, creep_m: float, loop: float
) -> Wire:
    """Return the wire's state from the angles and speeds of motor pulley and jaw."""
    radius, lever = radius_m(p, theta_p), lever_m(p, theta_j)
    elongation = wound_m(p, theta_p) - paid_m(p, theta_j)
    stretch = dead_zone(elongation - p.wire_permanent_stretch_stretch_m - creep_m, p.wire_slack_half_width_m)
    slack = stretch == 0.0 and p.wire_slack_half_width_m > 0.0
    tension = (
        p.k * stretch * (1.0 + p.wire_hardening_beta_per_m2 * stretch * stretch) + p.wire_hysteresis_force_N * loop
    )
    if not slack:
        tension += p.wire_damping_damping_N_s_per_m * (radius * omega_p - lever * omega_j)
    return Wire(elongation, tension, radius, lever, slack)


@inlined
def rub_N_m(p: Physics, presliding: float, loaded: float, tension_N: float) -> float:
    """Return the motor's presliding friction; `presliding` and `loaded` from −1 to 1."""
    rub = p.presliding_friction_level_N_m * presliding
    if p.loaded_presliding_mu != 0.0:
        rub += p.loaded_presliding_mu * p.r_m * abs(tension_N) * loaded
    return rub


@inlined
def slid(p: Physics, presliding: float, loaded: float, way: float) -> tuple[float, float]:
    """Return the states of the motor's presliding friction after a displacement."""
    if p.presliding_friction_level_N_m != 0.0:
        presliding = slide(presliding, way, p.presliding_friction_angle_rad)
    if p.loaded_presliding_mu != 0.0:
        loaded = slide(loaded, way, p.loaded_presliding_angle_rad)
    return presliding, loaded


@inlined
def grip_N_m(p: Physics, gripped: float, tension_N: float) -> float:
    """Return the jaw's presliding friction; `gripped` from −1 to 1."""
    return (p.jaw_presliding_level_N_m + p.jaw_presliding_mu * p.r_j * abs(tension_N)) * gripped


@inlined
def grips(p: Physics) -> bool:
    """Tell whether the jaw has presliding friction."""
    return p.jaw_presliding_level_N_m != 0.0 or p.jaw_presliding_mu != 0.0


@inlined
def jaw_level_N_m(p: Physics, theta_j: float) -> float:
    """Return the level of the jaw's dry friction."""
    return max(0.0, jaw_friction_N_m(p, theta_j))


@inlined
def sided_friction_N_m(p: Physics, omega_m: float) -> float:
    """Return the additional dry friction of the motor in its direction of motion."""
    if omega_m > 0.0:
        return forward_friction_N_m(p)
    return backward_friction_N_m(p) if omega_m < 0.0 else 0.0


@inlined
def torque_constant(p: Physics, time_s: float) -> float:
    """Return K_t at a time."""
    return p.K_t * (1.0 + relative_torque_constant(p, time_s))


@inlined
def kind_of(p: Physics) -> Kind:
    """Return what the steps of a plant can leave out."""
    straight = wire_changes(p) == 0.0
    steady = straight and torque_changes(p) == 0.0
    level = level_changes(p) == 0.0
    return Kind(steady and level, straight, steady, not level or _motor_directed(p), not level or _jaw_directed(p))


@inlined
def _motor_directed(p: Physics) -> bool:
    """Whether Coulomb friction, friction that builds up, or play make the motor's direction matter."""
    return (
        p.motor_coulomb != 0.0
        or forward_friction_N_m(p) != 0.0
        or backward_friction_N_m(p) != 0.0
        or p.viscous_asymmetry_difference_N_m_s_per_rad != 0.0
        or p.presliding_friction_level_N_m != 0.0
        or p.loaded_presliding_mu != 0.0
        or p.transmission_play_half_width_rad != 0.0
    )


@inlined
def _jaw_directed(p: Physics) -> bool:
    """Whether Coulomb friction or friction that builds up make the jaw's direction matter."""
    return p.jaw_coulomb != 0.0 or grips(p)
