"""What wire and friction remember of their way, along the filter's course.

The filter's angles are never quite at rest: each row's noise moves them, and the plant moves them back. Added up over
some seconds of a hold, these ways are far longer than those over which a wire or friction forgets. So what is
remembered changes with ways that are longer than the filter's angles are uncertain (the play operator: Brokate and
Sprekels, Hysteresis and Phase Transitions, 1996, section 2.2). A shorter way counts as long as it lasts.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.kernel import inlined, subroutine
from hil_forceps.diagnosis.state_space.layout import OMEGA_J, OMEGA_M, THETA_J, THETA_M
from hil_forceps.model.composition import Physics, paid_m, wound_m
from hil_forceps.model.physics import State, grips, lost_after, slid, slide

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Of what is known of an angle. Of a mass at rest the filter's angle scatters by 0.7 of that: 1 row in 50 000 is beyond.
REACH_DEVIATIONS = 3.0


class Memory(NamedTuple):
    """What is remembered, and of which way."""

    theta_m_rad: float
    theta_j_rad: float
    elongation_m: float
    loop: float  # this and the others as in `State`
    presliding: float
    loaded: float
    gripped: float
    lost_rad: float


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
def elongation_m(p: Physics, theta_m_rad: float, lost_rad: float, theta_j_rad: float) -> float:
    """Return what the wire is longer by than between pulleys at 0."""
    length: float = wound_m(p, theta_m_rad - lost_rad) - paid_m(p, theta_j_rad)
    return length


@subroutine
def no_memory(p: Physics, x: Vector) -> Memory:
    """Return the memory of a plant that has come from nowhere."""
    there = elongation_m(p, x[THETA_M], 0.0, x[THETA_J])
    return Memory(x[THETA_M], x[THETA_J], there, 0.0, 0.0, 0.0, 0.0, 0.0)


@inlined
def _moved(p: Physics, m: Memory, theta_m_rad: float, theta_j_rad: float) -> Memory:
    """Return the memory with the angles at some others; the wire's own stays."""
    presliding, loaded = slid(p, m.presliding, m.loaded, theta_m_rad - m.theta_m_rad)
    lost = lost_after(p, m.lost_rad, theta_m_rad - m.theta_m_rad)
    gripped = slide(m.gripped, theta_j_rad - m.theta_j_rad, p.jaw_presliding_angle_rad) if grips(p) else m.gripped
    return Memory(theta_m_rad, theta_j_rad, m.elongation_m, m.loop, presliding, loaded, gripped, lost)


@inlined
def _stretched(p: Physics, m: Memory, elongation: float) -> Memory:
    """Return the memory with the wire at another elongation."""
    loop = m.loop
    if p.wire_hysteresis_force_N != 0.0:
        loop = slide(loop, elongation - m.elongation_m, p.wire_hysteresis_stretch_m)
    return Memory(m.theta_m_rad, m.theta_j_rad, elongation, loop, m.presliding, m.loaded, m.gripped, m.lost_rad)


@inlined
def _within(followed: float, value: float, reach: float) -> float:
    return max(value - reach, min(value + reach, followed))


@subroutine
def following(p: Physics, m: Memory, x: Vector, variance: Vector, elongation_deviation_m: float) -> Memory:
    """Return what is remembered behind a row; `x` and `variance`: of the filter's state there."""
    if not remembers(p):
        return m
    theta_m = _within(m.theta_m_rad, x[THETA_M], REACH_DEVIATIONS * math.sqrt(max(0.0, variance[THETA_M])))
    theta_j = _within(m.theta_j_rad, x[THETA_J], REACH_DEVIATIONS * math.sqrt(max(0.0, variance[THETA_J])))
    kept = _moved(p, m, theta_m, theta_j)
    here = _moved(p, kept, x[THETA_M], x[THETA_J])
    now = elongation_m(p, x[THETA_M], here.lost_rad, x[THETA_J])
    return _stretched(p, kept, _within(m.elongation_m, now, REACH_DEVIATIONS * elongation_deviation_m))


@inlined
def beginning(p: Physics, m: Memory, before: State, x: Vector) -> State:
    """Return the plant with the filter's angles and speeds; `before`: as it came there, by the row before."""
    here = m
    if remembers(p):
        here = _moved(p, m, x[THETA_M], x[THETA_J])
        here = _stretched(p, here, elongation_m(p, x[THETA_M], here.lost_rad, x[THETA_J]))
    memory = (before.creep_m, here.loop, here.presliding, here.loaded, here.gripped, here.lost_rad)
    return State(x[THETA_M], x[OMEGA_M], x[THETA_J], x[OMEGA_J], *memory, before.current_A)


@inlined
def elongation_deviation_m(p: Physics, covariance: Matrix) -> float:
    """Return how uncertain the wire's elongation is."""
    motor, jaw = covariance[THETA_M, THETA_M], covariance[THETA_J, THETA_J]
    variance = p.r_m * p.r_m * motor - 2.0 * p.r_m * p.r_j * covariance[THETA_M, THETA_J] + p.r_j * p.r_j * jaw
    return math.sqrt(max(0.0, variance))
