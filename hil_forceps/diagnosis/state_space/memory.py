"""What wire and friction remember of their way, along the filter's course.

Where friction may hold a mass, the filter's angles are never quite at rest: each row's noise moves them, and the plant
moves them back. Added up over some seconds, these ways are far longer than those over which a wire or friction forgets.
So a way back counts in full there from where the filter is sure that a mass turned round, and less before: what was
remembered there is kept, and nothing adds up.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.kernel import inlined, subroutine
from hil_forceps.diagnosis.state_space.layout import OMEGA_J, OMEGA_M, THETA_J, THETA_M, Series
from hil_forceps.diagnosis.state_space.row_plant import may_hold
from hil_forceps.model.composition import Physics, paid_m, wound_m
from hil_forceps.model.physics import State, grips, lost_after, slid, slide

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Of what is known of an angle: as far as a thousand normal deviations are apart.
SURE_DEVIATIONS = 6.5


class Way(NamedTuple):
    """The way of a mass, or of the wire's elongation."""

    turned: float  # where it last turned round for sure
    furthest: float  # from there


class Memory(NamedTuple):
    """Ways, and what is remembered where each last turned (as in `State`)."""

    motor: Way
    jaw: Way
    wire: Way
    loop: float
    presliding: float
    loaded: float
    gripped: float
    lost_rad: float


class Sure(NamedTuple):
    """How long a way back is sure, motor, jaw and wire."""

    motor_rad: float
    jaw_rad: float
    wire_m: float


@inlined
def remembers(p: Physics) -> bool:
    """Tell whether a plant remembers its way; creep of the wire remembers its tension alone."""
    return (
        p.wire_hysteresis_force_N != 0.0
        or p.presliding_friction_level_N_m != 0.0
        or p.loaded_presliding_mu != 0.0
        or p.transmission_play_half_width_rad != 0.0
        or grips(p)
    )


@inlined
def _elongation_m(p: Physics, theta_m_rad: float, lost_rad: float, theta_j_rad: float) -> float:
    length: float = wound_m(p, theta_m_rad - lost_rad) - paid_m(p, theta_j_rad)
    return length


@subroutine
def no_memory(p: Physics, x: Vector) -> Memory:
    """Return the memory of a plant that has come from nowhere."""
    there = _elongation_m(p, x[THETA_M], 0.0, x[THETA_J])
    motor, jaw, wire = Way(x[THETA_M], x[THETA_M]), Way(x[THETA_J], x[THETA_J]), Way(there, there)
    return Memory(motor, jaw, wire, 0.0, 0.0, 0.0, 0.0, 0.0)


@subroutine
def sure_ways(d: Series, row: int, variance: Vector, deviation_m: float) -> Sure:
    """Return how long ways are sure at a row: of a mass that slides, any is.

    `variance`: of the filter's state there; `deviation_m`: of the wire's elongation.
    """
    motor_rad, jaw_rad = 0.0, 0.0
    if may_hold(d, row, 0):
        motor_rad = SURE_DEVIATIONS * math.sqrt(max(0.0, variance[THETA_M]))
    if may_hold(d, row, 1):
        jaw_rad = SURE_DEVIATIONS * math.sqrt(max(0.0, variance[THETA_J]))
    return Sure(motor_rad, jaw_rad, SURE_DEVIATIONS * deviation_m)


@inlined
def _back(way: Way, value: float) -> float:
    """Return how far a value is behind the furthest one."""
    return abs(value - way.furthest) if (value - way.furthest) * (way.furthest - way.turned) < 0.0 else 0.0


@inlined
def _share(way: Way, value: float, sure: float) -> float:
    """Return how much of a way back counts."""
    back = _back(way, value)
    if back <= 0.0:
        return 0.0
    return (back / sure) ** 2 if back < sure else 1.0


@inlined
def _blend(forth: float, back: float, share: float) -> float:
    return forth + share * (back - forth)


@inlined
def _motor(p: Physics, m: Memory, value: float, share: float) -> tuple[float, float, float]:
    """Return presliding, loaded presliding and what play has lost at an angle of the motor."""
    way = value - m.motor.turned
    presliding, loaded = slid(p, m.presliding, m.loaded, way)
    lost = lost_after(p, m.lost_rad, way)
    if share > 0.0:
        out, home = m.motor.furthest - m.motor.turned, value - m.motor.furthest
        there = slid(p, m.presliding, m.loaded, out)
        back = slid(p, there[0], there[1], home)
        presliding, loaded = _blend(presliding, back[0], share), _blend(loaded, back[1], share)
        lost = _blend(lost, lost_after(p, lost_after(p, m.lost_rad, out), home), share)
    return presliding, loaded, lost


@inlined
def _slid_along(state: float, way: Way, length: float, value: float, share: float) -> float:
    """Return what of one way is remembered at a value."""
    found = slide(state, value - way.turned, length)
    if share > 0.0:
        back = slide(slide(state, way.furthest - way.turned, length), value - way.furthest, length)
        found = _blend(found, back, share)
    return found


@inlined
def _gripped(p: Physics, m: Memory, value: float, share: float) -> float:
    return _slid_along(m.gripped, m.jaw, p.jaw_presliding_angle_rad, value, share) if grips(p) else m.gripped


@inlined
def _loop(p: Physics, m: Memory, value: float, share: float) -> float:
    if p.wire_hysteresis_force_N == 0.0:
        return m.loop
    return _slid_along(m.loop, m.wire, p.wire_hysteresis_stretch_m, value, share)


@inlined
def _gone_on(way: Way, value: float, turns: bool) -> Way:
    if turns:
        return Way(way.furthest, value)
    return Way(way.turned, value if _back(way, value) == 0.0 else way.furthest)


@subroutine
def following(p: Physics, m: Memory, x: Vector, sure: Sure) -> Memory:
    """Return what is remembered behind a row; `x`: the filter's state there."""
    if not remembers(p):
        return m
    theta_m, theta_j = x[THETA_M], x[THETA_J]
    share = _share(m.motor, theta_m, sure.motor_rad)
    presliding, loaded, lost = m.presliding, m.loaded, m.lost_rad
    elongation = _elongation_m(p, theta_m, _motor(p, m, theta_m, share)[2], theta_j)
    motor_turns, jaw_turns = share >= 1.0, _share(m.jaw, theta_j, sure.jaw_rad) >= 1.0
    wire_turns = _share(m.wire, elongation, sure.wire_m) >= 1.0
    if motor_turns:
        presliding, loaded, lost = _motor(p, m, m.motor.furthest, 0.0)
    gripped = _gripped(p, m, m.jaw.furthest, 0.0) if jaw_turns else m.gripped
    loop = _loop(p, m, m.wire.furthest, 0.0) if wire_turns else m.loop
    return Memory(
        _gone_on(m.motor, theta_m, motor_turns),
        _gone_on(m.jaw, theta_j, jaw_turns),
        _gone_on(m.wire, elongation, wire_turns),
        loop,
        presliding,
        loaded,
        gripped,
        lost,
    )


@subroutine
def beginning(p: Physics, m: Memory, before: State, x: Vector, sure: Sure) -> State:
    """Return the plant with the filter's angles and speeds; `before`: as it came there, by the row before."""
    loop, presliding, loaded, gripped, lost = m.loop, m.presliding, m.loaded, m.gripped, m.lost_rad
    if remembers(p):
        presliding, loaded, lost = _motor(p, m, x[THETA_M], _share(m.motor, x[THETA_M], sure.motor_rad))
        gripped = _gripped(p, m, x[THETA_J], _share(m.jaw, x[THETA_J], sure.jaw_rad))
        elongation = _elongation_m(p, x[THETA_M], lost, x[THETA_J])
        loop = _loop(p, m, elongation, _share(m.wire, elongation, sure.wire_m))
    memory = (before.creep_m, loop, presliding, loaded, gripped, lost)
    return State(x[THETA_M], x[OMEGA_M], x[THETA_J], x[OMEGA_J], *memory, before.current_A)


@inlined
def elongation_deviation_m(p: Physics, covariance: Matrix) -> float:
    """Return how uncertain the wire's elongation is."""
    motor, jaw = covariance[THETA_M, THETA_M], covariance[THETA_J, THETA_J]
    variance = p.r_m * p.r_m * motor - 2.0 * p.r_m * p.r_j * covariance[THETA_M, THETA_J] + p.r_j * p.r_j * jaw
    return math.sqrt(max(0.0, variance))
