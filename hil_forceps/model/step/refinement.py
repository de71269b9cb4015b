"""Steps that are repeated in short pieces where one step is too coarse.

That is where the wire becomes taut or slack, the motor passes through its play, or its friction changes with speed.
"""

import math

from hil_forceps.model.composition import Physics
from hil_forceps.model.kernel import inlined, subroutine
from hil_forceps.model.linear.gains import PIECES, SHORT, TAUT, Gains
from hil_forceps.model.physics import Kind, State
from hil_forceps.model.step.effects import wire_of
from hil_forceps.model.step.motion import Drive, Motion
from hil_forceps.model.step.single_step import full_step, level_step

_STRIBECK_REACH = 3.0  # times the Stribeck speed: exp(−9) of the rise is left
_MIN_FILM_REACH = 0.3  # of the film's speed: below it, and where the film is stiff, a step may need pieces
_MAX_SPEED_CHANGE_SHARE = 0.2  # of the speed over which friction changes: over less it is nearly linear
# Of I/h: largest slope of friction over speed for one step. For a film's accuracy half of I/h would do, but χ² is
# discontinuous where a fit passes that slope, and one fit of a film stopped there.
_MAX_FRICTION_SLOPE_SHARE = 0.1


@inlined
def _uneven(
    change_N_m: float, over_rad_per_s: float, reach: float, inertia_per_step: float, speeds: tuple[float, float]
) -> bool:
    """Tell whether friction that changes over a speed, and up to `reach` times it, changes too fast for one step."""
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
    """Tell whether a step has to be repeated in pieces."""
    if p.transmission_play_half_width_rad > 0.0 and (
        abs(x.lost_rad) < p.transmission_play_half_width_rad or abs(end.lost_rad) < p.transmission_play_half_width_rad
    ):
        return True
    if p.wire_slack_half_width_m > 0.0:
        before = wire_of(p, Motion(x.theta_m_rad, 0.0, x.theta_j_rad, 0.0), x.lost_rad, x.creep_m, x.loop)
        after = wire_of(p, Motion(end.theta_m_rad, 0.0, end.theta_j_rad, 0.0), end.lost_rad, end.creep_m, end.loop)
        if before.slack != after.slack or before.tension_N * after.tension_N < 0.0:
            return True
    speeds = (x.omega_m_rad_per_s, end.omega_m_rad_per_s)
    if p.stribeck_friction_rise_N_m != 0.0 and _uneven(
        p.stribeck_friction_rise_N_m, p.stribeck_friction_speed_rad_per_s, _STRIBECK_REACH, inertia_per_step, speeds
    ):
        return True
    if p.film_friction_level_N_m != 0.0:
        # At higher speeds the film's slope is below half of I/h: L/ω_f exp(−|ω|/ω_f) < I/2h.
        over = 2.0 * p.film_friction_level_N_m / p.film_friction_speed_rad_per_s / inertia_per_step
        if min(abs(speeds[0]), abs(speeds[1])) >= max(_MIN_FILM_REACH, over - 1.0) * p.film_friction_speed_rad_per_s:
            return False  # ln x ≤ x − 1, which takes far less time
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
    """Return `full_step`, or the quicker `level_step` where it is the same."""
    if kind.steady:
        return level_step(p, g, base, inertia, x, d)
    return full_step(p, kind, g, base, inertia, kept, x, d)


@subroutine
def _in_pieces(
    p: Physics, kind: Kind, g: Gains, inertia: tuple[float, float], kept: float, x: State, d: Drive
) -> State:
    """Return the state after a step in `PIECES`; `kept`: share of the creep that is left after a piece."""
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
    """Return a step, in pieces where needed; `kept`: share of the creep left after a step and after a piece."""
    end = _one_step(p, kind, g, TAUT, inertia, kept[0], x, d)
    if _sudden(p, inertia[0], x, end):
        return _in_pieces(p, kind, g, inertia, kept[1], x, d)
    return end
