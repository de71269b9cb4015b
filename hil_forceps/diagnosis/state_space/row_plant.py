"""The plant and what acts on it from a row to the next, by the filter's state."""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.advance import Acting, expected_friction_j_N_m, expected_friction_m_N_m
from hil_forceps.diagnosis.state_space.kernel import inlined, returning_arrays, subroutine
from hil_forceps.diagnosis.state_space.layout import (
    CURRENT_NOISE,
    FRICTION_J,
    FRICTION_M,
    JAW_NOISE,
    LOAD,
    LOAD_NOISE,
    LOAD_SLOPE,
    OMEGA_J,
    OMEGA_M,
    THETA_J,
    THETA_M,
    Series,
)
from hil_forceps.diagnosis.state_space.transition import friction_kept
from hil_forceps.model.composition import Physics
from hil_forceps.model.physics import State

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Deviations of a speed over what friction takes from it in a row. With √(2/π) the mean friction would take all of it;
# with half as much it turns a mass round to the same speed, which is where it stops dying away.
STOPPED_DEVIATIONS = 0.5 * math.sqrt(2.0 / math.pi)


@returning_arrays
def noise_kept(d: Series, samples: int) -> Vector:
    """Return how much of each state beyond the plant's is kept over so many samples of the drive."""
    kept, share = np.ones(d.states), samples / d.samples
    kept[FRICTION_M] = kept[FRICTION_J] = friction_kept(share * d.period_s)
    kept[JAW_NOISE], kept[LOAD_NOISE] = d.noise_correlation[0] ** share, d.noise_correlation[1] ** share
    kept[CURRENT_NOISE] = d.noise_correlation[2] ** share
    return kept


@subroutine
def first_plant(d: Series) -> State:
    """Return the plant at the first row: wire and friction remember nothing."""
    x = d.first_state
    return State(x[THETA_M], x[OMEGA_M], x[THETA_J], x[OMEGA_J], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, d.first_current_A)


@inlined
def may_hold(d: Series, row: int, mass: int) -> bool:
    """Tell whether dry friction may hold a mass (0 motor, 1 jaw) from a row to the next, so that it is a state.

    Less friction than the load leaves open is not: the plant's own step has it, with the instant at which it stops.
    """
    free: bool = d.friction_free_m[row] if mass == 0 else d.friction_free_j[row]
    return free and d.friction_level_N_m[row, mass] > 0.0


@inlined
def _stopped(d: Series, deceleration_rad_per_s2: float) -> float:
    """Return by how much a speed is uncertain at least where friction may stop a mass within a row.

    What is stopped has no sign for all of a row. With less, friction that is held over a row turns the mass round, and
    from row to row more.
    """
    stopped: float = STOPPED_DEVIATIONS * deceleration_rad_per_s2 * d.period_s
    return stopped


@inlined
def friction_on(p: Physics, d: Series, row: int, x: Vector, variance: Vector) -> tuple[float, float]:
    """Return the dry friction that the plant's step is without, motor and jaw: its mean, and the filter's state."""
    motor, jaw = 0.0, 0.0
    if may_hold(d, row, 0):
        tension = p.k * (p.r_m * x[THETA_M] - p.r_j * x[THETA_J])
        deviation = max(_stopped(d, d.friction_level_N_m[row, 0] / p.I_m), math.sqrt(variance[OMEGA_M]))
        motor = expected_friction_m_N_m(p, x[OMEGA_M], deviation, tension) + x[FRICTION_M]
    if may_hold(d, row, 1):
        deviation = max(_stopped(d, d.friction_level_N_m[row, 1] / p.I_j), math.sqrt(variance[OMEGA_J]))
        jaw = expected_friction_j_N_m(p, x[OMEGA_J], deviation, x[THETA_J]) + x[FRICTION_J]
    return motor, jaw


@inlined
def acting_on(p: Physics, d: Series, row: int, x: Vector, variance: Vector, elastic_slope: float) -> Acting:
    """Return what acts from a row to the next; `x` and `variance`: of the filter's state there."""
    friction = friction_on(p, d, row, x, variance)
    load_slope = x[LOAD_SLOPE] + elastic_slope
    time_s = d.begin_s + row * d.period_s
    return Acting(time_s, row * d.samples, x[LOAD], load_slope, friction[0], friction[1])


@inlined
def is_slack(p: Physics, x: Vector) -> bool:
    """Tell whether the wire of a plant with a dead zone is in it."""
    return (
        p.wire_slack_half_width_m > 0.0
        and abs(p.r_m * x[THETA_M] - p.r_j * x[THETA_J] - p.wire_permanent_stretch_stretch_m)
        < p.wire_slack_half_width_m
    )


@inlined
def end_friction(d: Series, row: int, x: Vector | Matrix) -> None:
    """Set a change of the friction's states to 0 where a mass slides, or has only now come to where it may stick."""
    before = max(row - 1, 0)
    if not (may_hold(d, row, 0) and (row == 0 or may_hold(d, before, 0))):
        x[FRICTION_M] = 0.0
    if not (may_hold(d, row, 1) and (row == 0 or may_hold(d, before, 1))):
        x[FRICTION_J] = 0.0
