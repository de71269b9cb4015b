"""The motion over a step with dry friction: the rule of `friction` for the motor, then for the jaw."""

from hil_forceps.model.composition import Physics
from hil_forceps.model.kernel import inlined
from hil_forceps.model.linear.gains import (
    DAMPING,
    FROM_JAW,
    FROM_MOTOR,
    JAW_MEAN,
    JAW_SLOPE,
    JAW_SPEED,
    JAW_WAY,
    MOTOR_MEAN,
    MOTOR_SLOPE,
    MOTOR_SPEED,
    MOTOR_WAY,
    STIFFNESS,
    VISCOSITY,
    Gains,
)
from hil_forceps.model.physics import State
from hil_forceps.model.step.friction import STOPPED, STUCK, Levels, Response, friction
from hil_forceps.model.step.motion import Motion, Torques, added


@inlined
def settled(
    g: Gains,
    s: int,
    x: State,
    free: Motion,
    push: tuple[float, float],
    inertia: tuple[float, float],
    motor: Levels,
    jaw: Levels,
) -> Motion:
    """Return the motion at the end of a step with dry friction.

    `push`: torques at the start, motor and jaw, without dry friction; `inertia`: I/h of motor and jaw.
    """
    omega_j = x.omega_j_rad_per_s
    guess = max(-jaw.rest, min(jaw.rest, push[1])) if omega_j == 0.0 else (jaw.start if omega_j > 0.0 else -jaw.start)
    response = _response(g, s, MOTOR_SPEED, MOTOR_WAY, MOTOR_MEAN, MOTOR_SLOPE, FROM_MOTOR)
    free_speed = free.omega_m - g[s, MOTOR_SPEED + JAW_MEAN] * guess
    free_way = free.theta_m - g[s, MOTOR_WAY + JAW_MEAN] * guess
    mean, slope, fate_m = friction(x.omega_m_rad_per_s, free_speed, free_way, push[0], inertia[0], response, motor)
    way_j = free.theta_j - g[s, JAW_WAY + MOTOR_MEAN] * mean - g[s, JAW_WAY + MOTOR_SLOPE] * slope
    speed_j = free.omega_j - g[s, JAW_SPEED + MOTOR_MEAN] * mean - g[s, JAW_SPEED + MOTOR_SLOPE] * slope
    response = _response(g, s, JAW_SPEED, JAW_WAY, JAW_MEAN, JAW_SLOPE, FROM_JAW)
    mean_j, slope_j, fate_j = friction(omega_j, speed_j, way_j, push[1], inertia[1], response, jaw)
    end = added(g, s, free, Torques(-mean, -slope, -mean_j, -slope_j))
    return Motion(
        x.theta_m_rad + (0.0 if fate_m == STUCK else end.theta_m),
        0.0 if fate_m >= STOPPED else end.omega_m,
        x.theta_j_rad + (0.0 if fate_j == STUCK else end.theta_j),
        0.0 if fate_j >= STOPPED else end.omega_j,
    )


@inlined
def _response(g: Gains, s: int, speed: int, way: int, mean: int, slope: int, own: int) -> Response:
    """Return how a mass answers to torques on it and to its own speed, by places in the gains."""
    return Response(
        g[s, speed + mean], g[s, speed + slope], g[s, way + mean], g[s, way + slope], g[s, speed + own], g[s, way + own]
    )


@inlined
def settled_again(
    g: Gains,
    s: int,
    x: State,
    free: Motion,
    end: Motion,
    more: Torques,
    push: tuple[float, float],
    inertia: tuple[float, float],
    motor: Levels,
    jaw: Levels,
) -> Motion:
    """Return the motion with more torques, and with levels of friction that change over the step.

    `end`: the result of `settled` without both. While motor and jaw keep their direction, the motion is linear in them.
    """
    rise = motor.end - motor.start if x.omega_m_rad_per_s > 0.0 else motor.start - motor.end
    rise_j = jaw.end - jaw.start if x.omega_j_rad_per_s > 0.0 else jaw.start - jaw.end
    u = Torques(more.motor - 0.5 * rise, more.motor_slope - rise, more.jaw - 0.5 * rise_j, more.jaw_slope - rise_j)
    again = added(g, s, end, u)
    if _go_on(x, end) and _go_on(x, again):
        return again
    return settled(g, s, x, added(g, s, free, more), push, inertia, motor, jaw)


@inlined
def _go_on(x: State, end: Motion) -> bool:
    """Tell whether motor and jaw keep their direction."""
    return x.omega_m_rad_per_s * end.omega_m > 0.0 and x.omega_j_rad_per_s * end.omega_j > 0.0


@inlined
def push_at_start(p: Physics, g: Gains, s: int, x: State, u: Torques) -> tuple[float, float]:
    """Return the torques at the start of the step, motor and jaw, without dry friction."""
    pull = g[s, STIFFNESS] * (p.r_m * x.theta_m_rad - p.r_j * x.theta_j_rad)
    pull += g[s, DAMPING] * (p.r_m * x.omega_m_rad_per_s - p.r_j * x.omega_j_rad_per_s)
    motor = u.motor - 0.5 * u.motor_slope - p.r_m * pull - g[s, VISCOSITY] * x.omega_m_rad_per_s
    return (
        motor,
        u.jaw - 0.5 * u.jaw_slope + p.r_j * pull - p.jaw_viscous_friction_viscosity_N_m_s_per_rad * x.omega_j_rad_per_s,
    )
