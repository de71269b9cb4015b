"""What the effects add to the linear plant over a step: values at its start and at its end, a line between.

Stiff additions of the wire and of presliding are held back by their own stiffness, so that no size of an effect makes
the step unstable.
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

    wire: float  # tension above the linear
    motor: float  # torque on the motor pulley, without the wire's and presliding
    jaw: float  # torque on the jaw, without the wire's


@inlined
def wire_of(p: Physics, m: Motion, lost_rad: float, creep_m: float, loop: float) -> Wire:
    """Return the wire at an instant."""
    speed = followed(p, lost_rad, m.omega_m)
    return wire(p, m.theta_m - lost_rad, speed, m.theta_j, m.omega_j, creep_m, loop)


@inlined
def wire_at_ends(p: Physics, kind: Kind, m: Motion, lost_rad: float, creep_m: float, loop: float) -> Wire:
    """Return the wire at an end of a step: `wire_of`, or the linear plant's where it is that."""
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
def _pull(p: Physics, g: Gains, s: int, way: float, change: float) -> tuple[float, float]:
    """Return how much of a change of the wire's tension over a step is put in: (mean, slope)."""
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
            loop, wire_of(p, end, lost, creep, loop).elongation_m - w0.elongation_m, p.wire_hysteresis_stretch_m
        )
    kept_z = (creep, loop, presliding, loaded, gripped, lost)
    return State(end.theta_m, end.omega_m, end.theta_j, end.omega_j, *kept_z, current_A)


@inlined
def nothing_else(x: State, end: Motion, current_A: float) -> State:
    """Return the state at the end of a step that leaves nothing in wire or friction."""
    kept = (x.creep_m, x.loop, x.presliding, x.loaded, x.gripped, x.lost_rad)
    return State(end.theta_m, end.omega_m, end.theta_j, end.omega_j, *kept, current_A)
