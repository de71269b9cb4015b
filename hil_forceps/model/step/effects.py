"""What the effects add to the linear plant over a step: values at its start and end, a line between.

Stiff additions, of wire and presliding, are implicit, so that no size of an effect makes the step unstable.
"""

from typing import NamedTuple

from hil_forceps.model.composition import Physics, jaw_load_N_m, motor_drag_N_m, motor_torque_N_m, relative_torque
from hil_forceps.model.kernel import inlined
from hil_forceps.model.linear.gains import (
    DAMPING,
    JAW_MEAN,
    JAW_SLOPE,
    JAW_WAY,
    MOTOR_MEAN,
    MOTOR_SLOPE,
    MOTOR_WAY,
    STIFFNESS,
    VISCOSITY,
    Gains,
)
from hil_forceps.model.physics import Kind, State, Wire, followed, grips, lost_after, slid, slide, wire
from hil_forceps.model.step.motion import Drive, Motion, Torques


class Excess(NamedTuple):
    """What the effects add to the linear plant at an instant."""

    wire: float  # tension beyond that of the linear wire
    motor: float  # torque on the motor pulley, without the wire's and presliding
    jaw: float  # torque on the jaw, without the wire's


@inlined
def wire_of(p: Physics, m: Motion, lost_rad: float, creep_m: float, loop: float) -> Wire:
    """Return the wire at an instant."""
    speed = followed(p, lost_rad, m.omega_m)
    return wire(p, m.theta_m - lost_rad, speed, m.theta_j, m.omega_j, creep_m, loop)


@inlined
def wire_at_ends(p: Physics, kind: Kind, m: Motion, lost_rad: float, creep_m: float, loop: float) -> Wire:
    """Return the wire at an end of a step: `wire_of`, or that of the linear plant if the wire is linear."""
    if not kind.straight:
        return wire_of(p, m, lost_rad, creep_m, loop)
    return Wire(p.r_m * m.theta_m - p.r_j * m.theta_j, linear_tension_N(p, m), p.r_m, p.r_j, False)


@inlined
def linear_tension_N(p: Physics, m: Motion) -> float:
    """Return the tension of the linear plant's wire."""
    return p.k * (p.r_m * m.theta_m - p.r_j * m.theta_j) + p.wire_damping_damping_N_s_per_m * (
        p.r_m * m.omega_m - p.r_j * m.omega_j
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
    """Return mean and slope of the change of a force over a step.

    `change`: that of a displacement `way`, which the force itself reduces by `way_of_mean` (> 0) per unit of its mean
    and by `way_of_slope` per unit of its slope. Soft: a line from start to end, with half the change as its mean.
    Stiff: the value at the end alone, found implicitly, which damps.
    """
    stiffness = change / way if way != 0.0 else 0.0
    if not stiffness > 0.0:
        return 0.5 * change, change
    blend = 1.0 / (1.0 + way_of_mean * stiffness)
    mean = 1.0 - 0.5 * blend
    change /= 1.0 + (way_of_mean * mean + way_of_slope * blend) * stiffness
    return mean * change, blend * change


@inlined
def _pull(p: Physics, g: Gains, s: int, way: float, change: float) -> tuple[float, float]:
    """Return mean and slope of a change of the wire's tension over a step."""
    by_mean = p.r_m * p.r_m * g[s, MOTOR_WAY + MOTOR_MEAN] + p.r_j * p.r_j * g[s, JAW_WAY + JAW_MEAN]
    by_mean -= p.r_m * p.r_j * (g[s, MOTOR_WAY + JAW_MEAN] + g[s, JAW_WAY + MOTOR_MEAN])
    by_slope = p.r_m * p.r_m * g[s, MOTOR_WAY + MOTOR_SLOPE] + p.r_j * p.r_j * g[s, JAW_WAY + JAW_SLOPE]
    by_slope -= p.r_m * p.r_j * (g[s, MOTOR_WAY + JAW_SLOPE] + g[s, JAW_WAY + MOTOR_SLOPE])
    return held_back(change, way, by_mean, by_slope)


@inlined
def corrections(
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
    """Return what the change of the effects over a step adds to torques that are held at their values at its start.

    `ways`: changes of the elongation and of the presliding friction of motor and jaw.
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
def remembered(p: Physics, x: State, end: Motion, w0: Wire, w1: Wire, kept: float, current_A: float) -> State:
    """Return the state at the end of a step, with the memories of wire and friction updated."""
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
            loop, wire_of(p, end, lost, creep, loop).elongation_m - w0.elongation_m, p.wire_hysteresis_stretch_m
        )
    kept_z = (creep, loop, presliding, loaded, gripped, lost)
    return State(end.theta_m, end.omega_m, end.theta_j, end.omega_j, *kept_z, current_A)


@inlined
def nothing_else(x: State, end: Motion, current_A: float) -> State:
    """Return the state at the end of a step that leaves the memories of wire and friction as they are."""
    kept = (x.creep_m, x.loop, x.presliding, x.loaded, x.gripped, x.lost_rad)
    return State(end.theta_m, end.omega_m, end.theta_j, end.omega_j, *kept, current_A)
