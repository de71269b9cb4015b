"""One step of the plant with every effect: exact where it is linear, second order where it is not.

The response of the linear plant to the inputs is exact (`motion`). What the effects add is evaluated at the start, and
at the end that is predicted with its values at the start; a line between is added (`effects`). Dry friction has its own
rule (`frictional_motion`).
"""

from hil_forceps.model.composition import (
    Physics,
    backward_friction_N_m,
    forward_friction_N_m,
    motor_friction_at_rest_N_m,
    motor_friction_N_m,
)
from hil_forceps.model.kernel import inlined
from hil_forceps.model.linear.gains import SLACK, TAUT, Gains
from hil_forceps.model.physics import Kind, State, grip_N_m, grips, jaw_level_N_m, lost_after, rub_N_m, slid, slide
from hil_forceps.model.step.effects import (
    corrections,
    excess_of,
    linear_tension_N,
    nothing_else,
    remembered,
    wire_at_ends,
    wire_of,
)
from hil_forceps.model.step.friction import Levels
from hil_forceps.model.step.frictional_motion import push_at_start, settled, settled_again
from hil_forceps.model.step.motion import Drive, Motion, Torques, free_motion


@inlined
def full_step(
    p: Physics, kind: Kind, g: Gains, base: int, inertia: tuple[float, float], kept: float, x: State, d: Drive
) -> State:
    """Return the plant's state after a step, with every effect that depends on the state.

    `base`: first row of the gains for a step of this length; `inertia`: I/h of motor and jaw; `kept`: share of the
    creep that is left.
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
    free, push = free_motion(p, g, s, x, u), push_at_start(p, g, s, x, u)
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
        w1 = wire_of(p, end, lost, creep, slide(x.loop, w1.elongation_m - w0.elongation_m, p.wire_hysteresis_stretch_m))
    last = excess_of(p, kind, g, s, end, w1, d, d.current + 0.5 * d.current_slope)
    slipped, loaded = slid(p, x.presliding, x.loaded, way)
    gripped = slide(x.gripped, end.theta_j - now.theta_j, p.jaw_presliding_angle_rad) if grips(p) else 0.0
    rub, grip = rub_N_m(p, slipped, loaded, w1.tension_N), grip_N_m(p, gripped, w1.tension_N)
    ways = (w1.elongation_m - w0.elongation_m, rub - rubbed, grip - held)
    last_level, last_level_j = motor_friction_N_m(p, end.omega_m, w1.tension_N), jaw_level_N_m(p, end.theta_j)
    more = corrections(p, kind, g, s, x, end, ways, first, last)
    motor, jaw = Levels(level, last_level, rest, forward, backward), Levels(level_j, last_level_j, level_j, 0.0, 0.0)
    end = settled_again(g, s, x, free, end, more, push, inertia, motor, jaw)
    return remembered(p, x, end, w0, w1, kept, d.current_end)


@inlined
def level_step(p: Physics, g: Gains, s: int, inertia: tuple[float, float], x: State, d: Drive) -> State:
    """Return the result of `full_step` where only the level of dry friction depends on the state."""
    now = Motion(x.theta_m_rad, x.omega_m_rad_per_s, x.theta_j_rad, x.omega_j_rad_per_s)
    tension = linear_tension_N(p, now)
    u = Torques(d.torque_constant * d.current, d.torque_constant * d.current_slope, -d.load, -d.load_slope)
    free, push = free_motion(p, g, s, x, u), push_at_start(p, g, s, x, u)
    level, rest = motor_friction_N_m(p, now.omega_m, tension), motor_friction_at_rest_N_m(p, tension)
    forward, backward = forward_friction_N_m(p), backward_friction_N_m(p)
    level_j = jaw_level_N_m(p, now.theta_j)
    jaw = Levels(level_j, level_j, level_j, 0.0, 0.0)
    end = settled(g, s, x, free, push, inertia, Levels(level, level, rest, forward, backward), jaw)
    last_level, last_level_j = (
        motor_friction_N_m(p, end.omega_m, linear_tension_N(p, end)),
        jaw_level_N_m(p, end.theta_j),
    )
    # Far from standstill the level no longer changes with speed: then this is the result.
    if last_level != level or last_level_j != level_j:
        motor = Levels(level, last_level, rest, forward, backward)
        jaw = Levels(level_j, last_level_j, level_j, 0.0, 0.0)
        end = settled_again(g, s, x, free, end, Torques(0.0, 0.0, 0.0, 0.0), push, inertia, motor, jaw)
    return nothing_else(x, end, d.current_end)


@inlined
def plain_step(p: Physics, g: Gains, inertia: tuple[float, float], x: State, d: Drive) -> State:
    """Return the plant's state after a step, without any effect that depends on the state."""
    forward, backward = forward_friction_N_m(p), backward_friction_N_m(p)
    motor = Levels(p.motor_coulomb, p.motor_coulomb, p.motor_coulomb, forward, backward)
    jaw = Levels(p.jaw_coulomb, p.jaw_coulomb, p.jaw_coulomb, 0.0, 0.0)
    u = Torques(d.torque_constant * d.current, d.torque_constant * d.current_slope, -d.load, -d.load_slope)
    free, push = free_motion(p, g, TAUT, x, u), push_at_start(p, g, TAUT, x, u)
    end = settled(g, TAUT, x, free, push, inertia, motor, jaw)
    return nothing_else(x, end, d.current_end)
