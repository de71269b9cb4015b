"""One step in place of several while motor and jaw keep moving: exact for the linear plant, fourth order for effects.

The torques of the effects over the step are a parabola through their values at the start, in the middle and at the end.
These are found by iteration. What a parabola leaves has neither mean nor first moment, and moves no free pulley.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.model.composition import Physics, backward_friction_N_m, forward_friction_N_m, motor_friction_N_m
from hil_forceps.model.kernel import inlined, returning_arrays
from hil_forceps.model.linear.gains import JAW_SPEED, MOTOR_SPEED, Gains
from hil_forceps.model.physics import Kind, State, Wire, grip_N_m, grips, jaw_level_N_m, rub_N_m, slid, slide
from hil_forceps.model.step.effects import excess_of, linear_tension_N, nothing_else, remembered, wire_at_ends
from hil_forceps.model.step.motion import Drive, Motion, Torques, added, free_motion, row_of

# Shares of the motor's friction at its speed, dry and viscous; a torque on the jaw is weighted by what it is at the
# motor:
_MAX_CHANGE_SHARE = 0.2  # change of a torque over the step, ...
_MAX_BEND_SHARE = 0.1  # ... its bend (end less twice the middle), ...
_CONVERGED_SHARE = 1e-3  # ... and what further iterations may change
_USUAL_STEPS = 4  # in a sample; with more of them these shares are smaller
_MAX_ITERATIONS = 8
_BELOW_SHARE = 0.25  # twice an eighth: the second difference changes from step to step
_SLOW_CONTRACTION = 0.5  # ratio of successive changes in the iteration: of friction over speed, ...
_FAST_CONTRACTION = 0.1  # ... and of other effects


class Forces(NamedTuple):
    """Torques of effects and dry friction at an instant."""

    motor: float
    jaw: float
    wire: Wire


class More(NamedTuple):
    """Torques beyond those at the start, in the middle of the step and at its end."""

    motor_middle: float
    motor_end: float
    jaw_middle: float
    jaw_end: float


@inlined
def suits(p: Physics, kind: Kind, steps: int) -> bool:
    """Tell whether `whole_step` can be tried with so many steps in a sample.

    Not with Stribeck friction, which amplifies differences; nor with a lag or dead time of the current or a hysteresis
    of the wire, which a parabola doesn't follow.
    """
    return (
        p.stribeck_friction_rise_N_m == 0.0
        and p.wire_hysteresis_force_N == 0.0
        and p.electrical_lag_time_constant_s == 0.0
        and p.actuation_delay_delay_s == 0.0
        and _even(kind, steps)
    )


@inlined
def _even(kind: Kind, steps: int) -> bool:
    return kind.plain or steps % 2 == 0


@returning_arrays
def decays(p: Physics, steps: int, step_s: float) -> NDArray[np.float64]:
    """Return the share of the creep that is left after one step, after two, and so on."""
    kept = np.empty(steps)
    for k in range(steps):
        kept[k] = math.exp(-(k + 1) * step_s / p.wire_creep_time_constant_s)
    return kept


@inlined
def whole_step(
    p: Physics, kind: Kind, g: Gains, kept: NDArray[np.float64], steps: int, x: State, d: Drive, friction_N_m: float
) -> tuple[bool, State]:
    """Return whether some steps can be taken as one, and the plant's state after them.

    Where what brakes a mass depends on its direction, the mass must keep moving.

    `g` and `kept`: of one step, of two, and so on; `steps` is even unless the plant is plain. `d`: with a steady
    current. `friction_N_m`: the motor's dry friction, where it is part of `d` and not of `p`.
    """
    if not _goes_on(kind, x, x.omega_m_rad_per_s, x.omega_j_rad_per_s):
        return False, x
    now = Motion(x.theta_m_rad, x.omega_m_rad_per_s, x.theta_j_rad, x.omega_j_rad_per_s)
    first = _forces(p, kind, g, x, now, x.creep_m, d)
    u = Torques(d.torque_constant * d.current + first.motor, 0.0, first.jaw - d.load, -d.load_slope)
    end, last = free_motion(p, g, steps - 1, x, u), first.wire
    if not kind.plain:
        found, more, last = _more(p, kind, g, kept, steps, x, d, friction_N_m, first, u, end)
        if not found:
            return False, x
        torques = _over_all(more)
        u = Torques(u.motor + torques.motor, torques.motor_slope, u.jaw + torques.jaw, u.jaw_slope + torques.jaw_slope)
        end = added(g, steps - 1, end, torques)
    there = _moved(x, end)
    if not (_on(kind, x, there) and _on_between(p, kind, g, steps, x, u)):
        return False, x
    if kind.steady:
        return True, nothing_else(x, there, d.current_end)
    return True, remembered(p, x, there, first.wire, last, kept[steps - 1], d.current_end)


@inlined
def _more(
    p: Physics,
    kind: Kind,
    g: Gains,
    kept: NDArray[np.float64],
    steps: int,
    x: State,
    d: Drive,
    friction_N_m: float,
    first: Forces,
    start: Torques,
    end: Motion,
) -> tuple[bool, More, Wire]:
    """Return whether the iteration converged, the torques beyond `first`, and the wire at the end.

    `start`: torques with `first` held; `end`: displacements and speeds that follow from them.
    """
    half = steps // 2 - 1
    middle = free_motion(
        p, g, half, x, Torques(start.motor, 0.0, start.jaw - 0.25 * start.jaw_slope, 0.5 * start.jaw_slope)
    )
    drawn = p.wire_creep_share * first.wire.tension_N / p.k  # limit of the creep
    creep, creep_end = drawn + kept[half] * (x.creep_m - drawn), drawn + kept[steps - 1] * (x.creep_m - drawn)
    scale = max(friction_N_m, motor_friction_N_m(p, x.omega_m_rad_per_s, first.wire.tension_N))
    scale += p.film_friction_level_N_m + d.viscosity * abs(x.omega_m_rad_per_s)
    if scale == 0.0:
        return False, More(0.0, 0.0, 0.0, 0.0), first.wire
    felt = scale / (jaw_level_N_m(p, x.theta_j_rad) + scale * p.r_j / p.r_m)  # weight of a torque on the jaw
    scale *= min(1.0, (_USUAL_STEPS / g.shape[0]) ** 4)
    left = _SLOW_CONTRACTION if kind.steady else _FAST_CONTRACTION
    more, moved, wire_end = More(0.0, 0.0, 0.0, 0.0), 0.0, first.wire
    for _ in range(_MAX_ITERATIONS):
        at = _moved(x, added(g, half, middle, _over_half(more)))
        at_end = _moved(x, added(g, steps - 1, end, _over_all(more)))
        if not (_on(kind, x, at) and _on(kind, x, at_end)):
            break
        m, e = _forces(p, kind, g, x, at, creep, d), _forces(p, kind, g, x, at_end, creep_end, d)
        was, more = more, More(m.motor - first.motor, e.motor - first.motor, m.jaw - first.jaw, e.jaw - first.jaw)
        if not (_smooth(more, felt, scale) and _same_wire(p, x, first.wire, m.wire, e.wire)):
            break
        before, moved, wire_end = moved, _apart(more, was, felt), e.wire
        if before > 0.0:
            left = min(_SLOW_CONTRACTION, moved / before)
        if moved * left <= _CONVERGED_SHARE * scale:
            return True, more, wire_end
    return False, more, wire_end


@inlined
def _forces(p: Physics, kind: Kind, g: Gains, x: State, at: Motion, creep_m: float, d: Drive) -> Forces:
    """Return torques of effects and friction at an instant after x, for motion in one direction and no play left."""
    motor, jaw = 0.0, 0.0
    w = Wire(0.0, 0.0 if kind.plain else linear_tension_N(p, at), p.r_m, p.r_j, False)
    if not kind.steady:
        way = at.theta_m - x.theta_m_rad
        w = wire_at_ends(p, kind, at, x.lost_rad, creep_m, x.loop)
        more = excess_of(p, kind, g, 0, at, w, d, d.current)
        presliding, loaded = slid(p, x.presliding, x.loaded, way)
        gripped = slide(x.gripped, at.theta_j - x.theta_j_rad, p.jaw_presliding_angle_rad) if grips(p) else 0.0
        motor = more.motor - p.r_m * more.wire - rub_N_m(p, presliding, loaded, w.tension_N)
        jaw = more.jaw + p.r_j * more.wire - grip_N_m(p, gripped, w.tension_N)
    level, level_j = motor_friction_N_m(p, at.omega_m, w.tension_N), jaw_level_N_m(p, at.theta_j)
    if at.omega_m > 0.0:
        motor -= level + forward_friction_N_m(p)
    else:
        motor += level + backward_friction_N_m(p)
    return Forces(motor, jaw - level_j if at.omega_j > 0.0 else jaw + level_j, w)


@inlined
def _smooth(more: More, felt: float, scale: float) -> bool:
    """Tell whether torques change and bend little enough for a parabola; half a cosine changes without a bend."""
    motor, jaw = max(abs(more.motor_middle), abs(more.motor_end)), max(abs(more.jaw_middle), abs(more.jaw_end))
    bend, bend_j = abs(more.motor_end - 2.0 * more.motor_middle), abs(more.jaw_end - 2.0 * more.jaw_middle)
    return max(motor, felt * jaw) <= _MAX_CHANGE_SHARE * scale and max(bend, felt * bend_j) <= _MAX_BEND_SHARE * scale


@inlined
def _apart(a: More, b: More, felt: float) -> float:
    motor = max(abs(a.motor_middle - b.motor_middle), abs(a.motor_end - b.motor_end))
    return max(motor, felt * abs(a.jaw_middle - b.jaw_middle), felt * abs(a.jaw_end - b.jaw_end))


@inlined
def _same_wire(p: Physics, x: State, first: Wire, middle: Wire, last: Wire) -> bool:
    """Tell whether the wire stays taut on the same side and the pulley follows the motor."""
    if p.wire_slack_half_width_m > 0.0 and not (
        first.tension_N * middle.tension_N > 0.0 and middle.tension_N * last.tension_N > 0.0
    ):
        return False
    return p.transmission_play_half_width_rad == 0.0 or x.lost_rad == (
        p.transmission_play_half_width_rad if x.omega_m_rad_per_s > 0.0 else -p.transmission_play_half_width_rad
    )


@inlined
def _on_between(p: Physics, kind: Kind, g: Gains, steps: int, x: State, u: Torques) -> bool:
    """Tell whether motor and jaw keep their direction, at the end of each step and between."""
    if not (kind.motor_directed or kind.jaw_directed):
        return True
    stretch = p.r_m * x.theta_m_rad - p.r_j * x.theta_j_rad
    speed_m, speed_j = x.omega_m_rad_per_s, x.omega_j_rad_per_s
    last_m, last_j, change_m, change_j = speed_m, speed_j, 0.0, 0.0
    for k in range(steps):
        share = (k + 1.0) / steps
        until = 0.5 * (share - 1.0)  # from the middle of all steps to the middle of those so far
        part = Torques(
            u.motor + until * u.motor_slope, share * u.motor_slope, u.jaw + until * u.jaw_slope, share * u.jaw_slope
        )
        omega_m = row_of(g, k, MOTOR_SPEED, stretch, speed_m, speed_j, part)
        omega_j = row_of(g, k, JAW_SPEED, stretch, speed_m, speed_j, part)
        # Between two steps a parabola lies an eighth of its second difference below the slower of both, at most.
        below_m = _BELOW_SHARE * abs(omega_m - last_m - change_m) if k > 0 else 0.0
        below_j = _BELOW_SHARE * abs(omega_j - last_j - change_j) if k > 0 else 0.0
        slower_m, slower_j = min(abs(omega_m), abs(last_m)) - below_m, min(abs(omega_j), abs(last_j)) - below_j
        if not _goes_on(kind, x, omega_m, omega_j) or (kind.motor_directed and slower_m <= 0.0):
            return False
        if kind.jaw_directed and slower_j <= 0.0:
            return False
        last_m, last_j, change_m, change_j = omega_m, omega_j, omega_m - last_m, omega_j - last_j
    return True


@inlined
def _on(kind: Kind, x: State, m: Motion) -> bool:
    return _goes_on(kind, x, m.omega_m, m.omega_j)


@inlined
def _goes_on(kind: Kind, x: State, omega_m: float, omega_j: float) -> bool:
    """Tell whether motor and jaw keep their direction, as far as it matters to what brakes them."""
    if kind.motor_directed and not x.omega_m_rad_per_s * omega_m > 0.0:
        return False
    return not kind.jaw_directed or x.omega_j_rad_per_s * omega_j > 0.0


@inlined
def _moved(x: State, way: Motion) -> Motion:
    """Return angles for displacements."""
    return Motion(x.theta_m_rad + way.theta_m, way.omega_m, x.theta_j_rad + way.theta_j, way.omega_j)


@inlined
def _over_all(more: More) -> Torques:
    """Return mean and slope over the step of parabolas that begin at 0."""
    motor, jaw = (4.0 * more.motor_middle + more.motor_end) / 6.0, (4.0 * more.jaw_middle + more.jaw_end) / 6.0
    return Torques(motor, more.motor_end, jaw, more.jaw_end)


@inlined
def _over_half(more: More) -> Torques:
    """Return the same over the first half of the step."""
    motor, jaw = (8.0 * more.motor_middle - more.motor_end) / 24.0, (8.0 * more.jaw_middle - more.jaw_end) / 24.0
    return Torques(motor, more.motor_middle, jaw, more.jaw_middle)
