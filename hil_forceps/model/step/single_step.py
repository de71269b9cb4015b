"""One step of the plant with every effect: exact where it is linear, second order where it is not.

The linear plant answers exactly to what the step brings (`gains`); what the effects add to it is evaluated at the start
and at the end that follows from its value at the start, and put in as a line between. Stiff additions of the wire and
of presliding are held back by their own stiffness, so that no size of an effect makes the step unstable. Dry friction
has its own rule (`friction`). A step in which the wire comes taut or slack, the motor passes through its play or the
speeds at which its friction falls, is taken again in short pieces.
"""

import math
from typing import NamedTuple

from hil_forceps.model.composition import (
    Physics,
    backward_friction_N_m,
    forward_friction_N_m,
    jaw_load_N_m,
    motor_drag_N_m,
    motor_friction_at_rest_N_m,
    motor_friction_N_m,
    motor_torque_N_m,
    relative_torque,
)
from hil_forceps.model.kernel import inlined, subroutine
from hil_forceps.model.linear.gains import (
    DAMPING,
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
    PIECES,
    SHORT,
    SLACK,
    STIFFNESS,
    TAUT,
    VISCOSITY,
    Gains,
)
from hil_forceps.model.physics import (
    Kind,
    State,
    Wire,
    followed,
    grip_N_m,
    grips,
    jaw_level_N_m,
    lost_after,
    rub_N_m,
    slid,
    slide,
    wire,
)
from hil_forceps.model.step.friction import STOPPED, STUCK, Levels, Response, friction

_STRIBECK_REACH = 3.0  # times the Stribeck speed: exp(−9) of the rise is left
_MIN_FILM_REACH = 0.3  # of the film's speed: below it a step may want pieces, and up to where the film is stiff
_MAX_SPEED_CHANGE_SHARE = 0.2  # of the speed over which friction changes: over less it is as good as a line
# Of I/h: what friction's slope may be for a step to take it as it comes. Half of it would do for a film, by what it
# moves; but where a fit comes by that slope χ² has a step, and one film's fit stopped there.
_MAX_FRICTION_SLOPE_SHARE = 0.1


class Torques(NamedTuple):
    """What acts on the pulleys over a step: mean and slope of each."""

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
    """What drives a step from outside."""

    current: float  # mean over the step
    current_slope: float
    current_end: float
    torque_constant: float  # K_t at the time
    viscosity: float  # D at the time
    load: float  # τ_w, mean over the step
    load_slope: float


class Excess(NamedTuple):
    """What the effects add to the linear plant at an instant."""

    wire: float  # tension above the linear
    motor: float  # torque on the motor pulley, without the wire's and presliding
    jaw: float  # torque on the jaw, without the wire's


@inlined
def row_of(g: Gains, s: int, row: int, stretch: float, omega_m: float, omega_j: float, u: Torques) -> float:
    """Return what a row of the gains makes of a state and of torques."""
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
    """Return ways and end speeds of a step without dry friction."""
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
    """Return ways and end speeds with more torques."""
    return Motion(
        m.theta_m + _response(g, s, MOTOR_WAY, u),
        m.omega_m + _response(g, s, MOTOR_SPEED, u),
        m.theta_j + _response(g, s, JAW_WAY, u),
        m.omega_j + _response(g, s, JAW_SPEED, u),
    )


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
    response = Response(
        g[s, MOTOR_SPEED + MOTOR_MEAN],
        g[s, MOTOR_SPEED + MOTOR_SLOPE],
        g[s, MOTOR_WAY + MOTOR_MEAN],
        g[s, MOTOR_WAY + MOTOR_SLOPE],
    )
    free_speed = free.omega_m - g[s, MOTOR_SPEED + JAW_MEAN] * guess
    free_way = free.theta_m - g[s, MOTOR_WAY + JAW_MEAN] * guess
    mean, slope, fate_m = friction(x.omega_m_rad_per_s, free_speed, free_way, push[0], inertia[0], response, motor)
    way_j = free.theta_j - g[s, JAW_WAY + MOTOR_MEAN] * mean - g[s, JAW_WAY + MOTOR_SLOPE] * slope
    speed_j = free.omega_j - g[s, JAW_SPEED + MOTOR_MEAN] * mean - g[s, JAW_SPEED + MOTOR_SLOPE] * slope
    response = Response(
        g[s, JAW_SPEED + JAW_MEAN], g[s, JAW_SPEED + JAW_SLOPE], g[s, JAW_WAY + JAW_MEAN], g[s, JAW_WAY + JAW_SLOPE]
    )
    mean_j, slope_j, fate_j = friction(omega_j, speed_j, way_j, push[1], inertia[1], response, jaw)
    end = added(g, s, free, Torques(-mean, -slope, -mean_j, -slope_j))
    return Motion(
        x.theta_m_rad + (0.0 if fate_m == STUCK else end.theta_m),
        0.0 if fate_m >= STOPPED else end.omega_m,
        x.theta_j_rad + (0.0 if fate_j == STUCK else end.theta_j),
        0.0 if fate_j >= STOPPED else end.omega_j,
    )


@inlined
def _settled_again(
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
    """Return the motion at the end with more torques, and friction that ends at other levels than it begins with.

    `end`: the motion as `settled` without both. Where motor and jaw go on as they went, it is linear in them.
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
    """Tell whether motor and jaw go the way they went."""
    return x.omega_m_rad_per_s * end.omega_m > 0.0 and x.omega_j_rad_per_s * end.omega_j > 0.0


@inlined
def _push(p: Physics, g: Gains, s: int, x: State, u: Torques) -> tuple[float, float]:
    """Return the torques at the start of the step, motor and jaw, without dry friction."""
    pull = g[s, STIFFNESS] * (p.r_m * x.theta_m_rad - p.r_j * x.theta_j_rad)
    pull += g[s, DAMPING] * (p.r_m * x.omega_m_rad_per_s - p.r_j * x.omega_j_rad_per_s)
    motor = u.motor - 0.5 * u.motor_slope - p.r_m * pull - g[s, VISCOSITY] * x.omega_m_rad_per_s
    return (
        motor,
        u.jaw - 0.5 * u.jaw_slope + p.r_j * pull - p.jaw_viscous_friction_viscosity_N_m_s_per_rad * x.omega_j_rad_per_s,
    )


@inlined
def excess_of(p: Physics, kind: Kind, g: Gains, s: int, m: Motion, w: Wire, d: Drive, current_A: float) -> Excess:
    """Return what the effects add at an instant."""
    linear = g[s, STIFFNESS] * (p.r_m * m.theta_m - p.r_j * m.theta_j)
    linear += g[s, DAMPING] * (p.r_m * m.omega_m - p.r_j * m.omega_j)
    motor = d.torque_constant * current_A * relative_torque(p, m.theta_m) + motor_torque_N_m(p, m.theta_m)
    motor -= (d.viscosity - g[s, VISCOSITY]) * m.omega_m + motor_drag_N_m(p, m.omega_m)
    motor -= (w.radius_m - p.r_m) * w.tension_N
    jaw = (w.lever_m - p.r_j) * w.tension_N - jaw_load_N_m(p, m.theta_j)
    return Excess(0.0 if kind.straight else w.tension_N - linear, motor, jaw)


@inlined
def held_back(change: float, way: float, way_of_mean: float, way_of_slope: float) -> tuple[float, float]:
    """Return how much of a force's change over a step is put in: (mean, slope).

    `change` is what a way of `way` would bring; the force itself shortens the way by `way_of_mean` per unit of its mean
    (0 < way_of_mean) and `way_of_slope` per unit of its slope. Soft: half of it and all of it, a line from start to
    end. Stiff: the end's value alone, found implicitly, which damps.
    """
    stiffness = change / way if way != 0.0 else 0.0
    if not stiffness > 0.0:
        return 0.5 * change, change
    blend = 1.0 / (1.0 + way_of_mean * stiffness)
    mean = 1.0 - 0.5 * blend
    change /= 1.0 + (way_of_mean * mean + way_of_slope * blend) * stiffness
    return mean * change, blend * change


@inlined
def _wire_of(p: Physics, m: Motion, lost_rad: float, creep_m: float, loop: float) -> Wire:
    speed = followed(p, lost_rad, m.omega_m)
    return wire(p, m.theta_m - lost_rad, speed, m.theta_j, m.omega_j, creep_m, loop)


@inlined
def wire_at_ends(p: Physics, kind: Kind, m: Motion, lost_rad: float, creep_m: float, loop: float) -> Wire:
    """Return the wire at an end of a step: `_wire_of`, or the linear plant's where it is that."""
    if not kind.straight:
        return _wire_of(p, m, lost_rad, creep_m, loop)
    return Wire(p.r_m * m.theta_m - p.r_j * m.theta_j, linear_tension_N(p, m), p.r_m, p.r_j, False)


@inlined
def linear_tension_N(p: Physics, m: Motion) -> float:
    """Return the tension of the linear plant's wire."""
    return p.k * (p.r_m * m.theta_m - p.r_j * m.theta_j) + p.wire_damping_damping_N_s_per_m * (
        p.r_m * m.omega_m - p.r_j * m.omega_j
    )


@inlined
def _pull(p: Physics, g: Gains, s: int, way: float, change: float) -> tuple[float, float]:
    """Return how much of a change of the wire's tension over a step is put in: (mean, slope)."""
    by_mean = p.r_m * p.r_m * g[s, MOTOR_WAY + MOTOR_MEAN] + p.r_j * p.r_j * g[s, JAW_WAY + JAW_MEAN]
    by_mean -= p.r_m * p.r_j * (g[s, MOTOR_WAY + JAW_MEAN] + g[s, JAW_WAY + MOTOR_MEAN])
    by_slope = p.r_m * p.r_m * g[s, MOTOR_WAY + MOTOR_SLOPE] + p.r_j * p.r_j * g[s, JAW_WAY + JAW_SLOPE]
    by_slope -= p.r_m * p.r_j * (g[s, MOTOR_WAY + JAW_SLOPE] + g[s, JAW_WAY + MOTOR_SLOPE])
    return held_back(change, way, by_mean, by_slope)


@inlined
def _corrections(
    p: Physics,
    kind: Kind,
    g: Gains,
    s: int,
    x: State,
    end: Motion,
    ways: tuple[float, float, float],
    first: Excess,
    last: Excess,
) -> Torques:
    """Return what the change of the effects over the step adds to the torques at its start, held.

    `ways`: the wire's (its elongation), and how much friction that builds up over a way has changed, motor and jaw.
    """
    pull, pull_slope = 0.0, 0.0
    if not kind.straight:
        pull, pull_slope = _pull(p, g, s, ways[0], last.wire - first.wire)
    rub, rub_slope = 0.0, 0.0
    if ways[1] != 0.0:
        way = end.theta_m - x.theta_m_rad
        rub, rub_slope = held_back(ways[1], way, g[s, MOTOR_WAY + MOTOR_MEAN], g[s, MOTOR_WAY + MOTOR_SLOPE])
    grip, grip_slope = 0.0, 0.0
    if ways[2] != 0.0:
        way = end.theta_j - x.theta_j_rad
        grip, grip_slope = held_back(ways[2], way, g[s, JAW_WAY + JAW_MEAN], g[s, JAW_WAY + JAW_SLOPE])
    motor, jaw = last.motor - first.motor, last.jaw - first.jaw
    return Torques(
        0.5 * motor - p.r_m * pull - rub,
        motor - p.r_m * pull_slope - rub_slope,
        0.5 * jaw + p.r_j * pull - grip,
        jaw + p.r_j * pull_slope - grip_slope,
    )


@inlined
def full_step(
    p: Physics, kind: Kind, g: Gains, base: int, inertia: tuple[float, float], kept: float, x: State, d: Drive
) -> State:
    """Return the plant's state a step on with every effect that hangs on the state.

    `base`: where the gains for a step of this length begin; `inertia`: I/h of motor and jaw; `kept`: what creep keeps.
    """
    now = Motion(x.theta_m_rad, x.omega_m_rad_per_s, x.theta_j_rad, x.omega_j_rad_per_s)
    w0 = wire_at_ends(p, kind, now, x.lost_rad, x.creep_m, x.loop)
    s = base + (SLACK if w0.slack else TAUT)
    first = excess_of(p, kind, g, s, now, w0, d, d.current - 0.5 * d.current_slope)
    rubbed, held = rub_N_m(p, x.presliding, x.loaded, w0.tension_N), grip_N_m(p, x.gripped, w0.tension_N)
    u = Torques(
        d.torque_constant * d.current + first.motor - rubbed - p.r_m * first.wire,
        d.torque_constant * d.current_slope,
        first.jaw + p.r_j * first.wire - d.load - held,
        -d.load_slope,
    )
    free, push = free_motion(p, g, s, x, u), _push(p, g, s, x, u)
    level, rest = motor_friction_N_m(p, now.omega_m, w0.tension_N), motor_friction_at_rest_N_m(p, w0.tension_N)
    forward, backward = forward_friction_N_m(p), backward_friction_N_m(p)
    level_j = jaw_level_N_m(p, now.theta_j)
    jaw = Levels(level_j, level_j, level_j, 0.0, 0.0)
    end = settled(g, s, x, free, push, inertia, Levels(level, level, rest, forward, backward), jaw)

    creep = kept * x.creep_m + (1.0 - kept) * p.wire_creep_share * w0.tension_N / p.k
    way = end.theta_m - now.theta_m
    lost = lost_after(p, x.lost_rad, way)
    w1 = wire_at_ends(p, kind, end, lost, creep, x.loop)
    if p.wire_hysteresis_force_N != 0.0:
        w1 = _wire_of(
            p, end, lost, creep, slide(x.loop, w1.elongation_m - w0.elongation_m, p.wire_hysteresis_stretch_m)
        )
    last = excess_of(p, kind, g, s, end, w1, d, d.current + 0.5 * d.current_slope)
    slipped, loaded = slid(p, x.presliding, x.loaded, way)
    gripped = slide(x.gripped, end.theta_j - now.theta_j, p.jaw_presliding_angle_rad) if grips(p) else 0.0
    rub, grip = rub_N_m(p, slipped, loaded, w1.tension_N), grip_N_m(p, gripped, w1.tension_N)
    ways = (w1.elongation_m - w0.elongation_m, rub - rubbed, grip - held)
    last_level, last_level_j = motor_friction_N_m(p, end.omega_m, w1.tension_N), jaw_level_N_m(p, end.theta_j)
    more = _corrections(p, kind, g, s, x, end, ways, first, last)
    motor, jaw = Levels(level, last_level, rest, forward, backward), Levels(level_j, last_level_j, level_j, 0.0, 0.0)
    end = _settled_again(g, s, x, free, end, more, push, inertia, motor, jaw)
    return remembered(p, x, end, w0, w1, kept, d.current_end)


@inlined
def level_step(p: Physics, g: Gains, s: int, inertia: tuple[float, float], x: State, d: Drive) -> State:
    """Return what `full_step` does where nothing but friction's level hangs on the state."""
    now = Motion(x.theta_m_rad, x.omega_m_rad_per_s, x.theta_j_rad, x.omega_j_rad_per_s)
    tension = linear_tension_N(p, now)
    u = Torques(d.torque_constant * d.current, d.torque_constant * d.current_slope, -d.load, -d.load_slope)
    free, push = free_motion(p, g, s, x, u), _push(p, g, s, x, u)
    level, rest = motor_friction_N_m(p, now.omega_m, tension), motor_friction_at_rest_N_m(p, tension)
    forward, backward = forward_friction_N_m(p), backward_friction_N_m(p)
    level_j = jaw_level_N_m(p, now.theta_j)
    jaw = Levels(level_j, level_j, level_j, 0.0, 0.0)
    end = settled(g, s, x, free, push, inertia, Levels(level, level, rest, forward, backward), jaw)
    last_level, last_level_j = (
        motor_friction_N_m(p, end.omega_m, linear_tension_N(p, end)),
        jaw_level_N_m(p, end.theta_j),
    )
    # Far from standstill, friction that hangs on speed no longer changes: then the end is found already.
    if last_level != level or last_level_j != level_j:
        motor = Levels(level, last_level, rest, forward, backward)
        jaw = Levels(level_j, last_level_j, level_j, 0.0, 0.0)
        end = _settled_again(g, s, x, free, end, Torques(0.0, 0.0, 0.0, 0.0), push, inertia, motor, jaw)
    return nothing_else(x, end, d.current_end)


@inlined
def remembered(p: Physics, x: State, end: Motion, w0: Wire, w1: Wire, kept: float, current_A: float) -> State:
    """Return the state at the end of a step, with what wire and friction remember of it."""
    creep, loop, gripped = x.creep_m, x.loop, x.gripped
    way = end.theta_m - x.theta_m_rad
    lost = lost_after(p, x.lost_rad, way)
    if p.wire_creep_share != 0.0:
        creep = kept * creep + (1.0 - kept) * p.wire_creep_share * 0.5 * (w0.tension_N + w1.tension_N) / p.k
    presliding, loaded = slid(p, x.presliding, x.loaded, way)
    if grips(p):
        gripped = slide(gripped, end.theta_j - x.theta_j_rad, p.jaw_presliding_angle_rad)
    if p.wire_hysteresis_force_N != 0.0:
        loop = slide(
            loop, _wire_of(p, end, lost, creep, loop).elongation_m - w0.elongation_m, p.wire_hysteresis_stretch_m
        )
    kept_z = (creep, loop, presliding, loaded, gripped, lost)
    return State(end.theta_m, end.omega_m, end.theta_j, end.omega_j, *kept_z, current_A)


@inlined
def nothing_else(x: State, end: Motion, current_A: float) -> State:
    """Return the state at the end of a step that leaves nothing in wire or friction."""
    kept = (x.creep_m, x.loop, x.presliding, x.loaded, x.gripped, x.lost_rad)
    return State(end.theta_m, end.omega_m, end.theta_j, end.omega_j, *kept, current_A)


@inlined
def plain_step(p: Physics, g: Gains, inertia: tuple[float, float], x: State, d: Drive) -> State:
    """Return the plant's state a step on, without an effect that hangs on the state."""
    forward, backward = forward_friction_N_m(p), backward_friction_N_m(p)
    motor = Levels(p.motor_coulomb, p.motor_coulomb, p.motor_coulomb, forward, backward)
    jaw = Levels(p.jaw_coulomb, p.jaw_coulomb, p.jaw_coulomb, 0.0, 0.0)
    u = Torques(d.torque_constant * d.current, d.torque_constant * d.current_slope, -d.load, -d.load_slope)
    free, push = free_motion(p, g, TAUT, x, u), _push(p, g, TAUT, x, u)
    end = settled(g, TAUT, x, free, push, inertia, motor, jaw)
    return nothing_else(x, end, d.current_end)


@inlined
def _uneven(
    change_N_m: float, over_rad_per_s: float, reach: float, inertia_per_step: float, speeds: tuple[float, float]
) -> bool:
    """Whether friction that changes over some speed, and up to `reach` times that, does so too fast for a step."""
    first, last = speeds
    if min(abs(first), abs(last)) >= reach * over_rad_per_s or (first == 0.0 and last == 0.0):
        return False
    turns = first * last <= 0.0
    return (
        turns
        or abs(last - first) > _MAX_SPEED_CHANGE_SHARE * over_rad_per_s
        or abs(change_N_m) > _MAX_FRICTION_SLOPE_SHARE * inertia_per_step * over_rad_per_s
    )


@inlined
def _sudden(p: Physics, inertia_per_step: float, x: State, end: State) -> bool:
    """Whether something happened in a step that wants shorter ones."""
    if p.transmission_play_half_width_rad > 0.0 and (
        abs(x.lost_rad) < p.transmission_play_half_width_rad or abs(end.lost_rad) < p.transmission_play_half_width_rad
    ):
        return True
    if p.wire_slack_half_width_m > 0.0:
        before = _wire_of(p, Motion(x.theta_m_rad, 0.0, x.theta_j_rad, 0.0), x.lost_rad, x.creep_m, x.loop)
        after = _wire_of(p, Motion(end.theta_m_rad, 0.0, end.theta_j_rad, 0.0), end.lost_rad, end.creep_m, end.loop)
        if before.slack != after.slack or before.tension_N * after.tension_N < 0.0:
            return True
    speeds = (x.omega_m_rad_per_s, end.omega_m_rad_per_s)
    if p.stribeck_friction_rise_N_m != 0.0 and _uneven(
        p.stribeck_friction_rise_N_m, p.stribeck_friction_speed_rad_per_s, _STRIBECK_REACH, inertia_per_step, speeds
    ):
        return True
    if p.film_friction_level_N_m != 0.0:
        # Beyond, its slope is at most half of what a step can take: L/ω_f exp(−|ω|/ω_f) < I/2h.
        over = 2.0 * p.film_friction_level_N_m / p.film_friction_speed_rad_per_s / inertia_per_step
        if min(abs(speeds[0]), abs(speeds[1])) >= max(_MIN_FILM_REACH, over - 1.0) * p.film_friction_speed_rad_per_s:
            return False  # ln x ≤ x − 1, and far quicker
        stiff = math.log(max(1.0, over))
        return _uneven(
            p.film_friction_level_N_m,
            p.film_friction_speed_rad_per_s,
            max(_MIN_FILM_REACH, stiff),
            inertia_per_step,
            speeds,
        )
    return False


@inlined
def _one_step(
    p: Physics, kind: Kind, g: Gains, base: int, inertia: tuple[float, float], kept: float, x: State, d: Drive
) -> State:
    """Return `full_step`, by the shorter way where the plant allows it."""
    if kind.steady:
        return level_step(p, g, base, inertia, x, d)
    return full_step(p, kind, g, base, inertia, kept, x, d)


@subroutine
def _in_pieces(
    p: Physics, kind: Kind, g: Gains, inertia: tuple[float, float], kept: float, x: State, d: Drive
) -> State:
    """Return the state after a step taken in `PIECES`; `kept`: what creep keeps over a piece."""
    scale = 1.0 / PIECES
    for piece in range(PIECES):
        at = (piece + 0.5) * scale - 0.5
        current, load = d.current + at * d.current_slope, d.load + at * d.load_slope
        slopes = (d.current_slope * scale, d.load_slope * scale)
        part = Drive(current, slopes[0], d.current_end, d.torque_constant, d.viscosity, load, slopes[1])
        x = _one_step(p, kind, g, SHORT, (inertia[0] * PIECES, inertia[1] * PIECES), kept, x, part)
    return x


@inlined
def refined_step(
    p: Physics, kind: Kind, g: Gains, inertia: tuple[float, float], kept: tuple[float, float], x: State, d: Drive
) -> State:
    """Return `full_step`, in pieces where it has to be; `kept`: what creep keeps over a step and over a piece."""
    end = _one_step(p, kind, g, TAUT, inertia, kept[0], x, d)
    if _sudden(p, inertia[0], x, end):
        return _in_pieces(p, kind, g, inertia, kept[1], x, d)
    return end
