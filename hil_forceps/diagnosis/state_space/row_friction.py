"""Where a mass may stick: its dry friction as a state, and what is left open where it comes near standstill."""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.covariance import disturbed, forgotten, freed, moved, spread
from hil_forceps.diagnosis.state_space.kernel import inlined, returning_arrays
from hil_forceps.diagnosis.state_space.layout import CURRENT, ENCODER, FRICTION_J, FRICTION_M, OMEGA_J, OMEGA_M, Series
from hil_forceps.diagnosis.state_space.measurement import corrected, direction, late_s, measured, white_variance
from hil_forceps.diagnosis.state_space.row_plant import may_hold
from hil_forceps.model.composition import Physics

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Flags = NDArray[np.bool_]

_SURE_SIGN_DEVIATIONS = 3.0  # deviations: a speed's sign is known beyond
_SETTLING_ROWS = 300  # after which the filter's deviations stay as they are


@inlined
def near_standstill(first: float, last: float, deviation: float) -> bool:
    """Tell whether a speed's sign isn't sure over a row."""
    return first * last <= 0.0 or min(abs(first), abs(last)) < _SURE_SIGN_DEVIATIONS * deviation


@inlined
def begin_friction(d: Series, row: int, was: tuple[bool, bool], x: Vector, covariance: Matrix) -> tuple[bool, bool]:
    """Begin or end the stretches where a mass may stick; return where it may, motor and jaw."""
    free_m, free_j = may_hold(d, row, 0), may_hold(d, row, 1)
    if not (free_m and was[0]):
        forgotten(covariance, FRICTION_M)
        x[FRICTION_M] = 0.0
    if not (free_j and was[1]):
        forgotten(covariance, FRICTION_J)
        x[FRICTION_J] = 0.0
    return free_m, free_j


@inlined
def open_friction(
    d: Series,
    row: int,
    free: tuple[bool, bool],
    x: Vector,
    ahead: tuple[float, float],
    variance: Vector,
    usual: Vector,
    f: Matrix,
    kept: float,
    covariance: Matrix,
) -> int:
    """Add what dry friction leaves open over a row; return which masses came near standstill though taken to slide.

    `ahead`: speeds at the next row; `usual`: deviations of both speeds while they slide. What they are here would not
    do: doubt makes speeds uncertain, and uncertain speeds make doubt.
    """
    doubtful = 0
    for mass in range(2):
        level = d.friction_level_N_m[row, mass]
        column, speed = (FRICTION_M, OMEGA_M) if mass == 0 else (FRICTION_J, OMEGA_J)
        if free[mass]:
            freed(covariance, column, level, kept)
            continue
        deviation = math.sqrt(variance[speed])
        if d.switching.given:
            doubts = d.switching.doubtful[row] & (1 + mass) != 0
        else:
            doubts = level > 0.0 and near_standstill(x[speed], ahead[mass], min(deviation, usual[mass]))
        if doubts:
            doubtful += 1 + mass
            spread(covariance, f, column, level**2)
    return doubtful


@returning_arrays
def sliding_deviations(p: Physics, d: Series, usual_row: int, f: Matrix, jump: Matrix, kept: Vector) -> Vector:
    """Return the deviations of both speeds that the filter settles at while both masses slide.

    `usual_row`: one from which the load changes as it mostly does (`usual_row_of`). A count is taken as white noise of
    its rounding.
    """
    covariance, work = np.diag(d.first_variance), np.empty((d.states, d.states))
    along, x, settled = np.empty(d.states), np.zeros(d.states), np.zeros(2)
    for _ in range(_SETTLING_ROWS):
        for channel in range(CURRENT):
            if math.isnan(measured(d, channel, usual_row)):
                continue
            variance = direction(channel, late_s(p, d, channel), covariance, along)
            noise = d.count_rad**2 / 12.0 + d.encoder_variance[usual_row]
            if channel != ENCODER:
                noise = white_variance(d, channel)
            information = 1.0 / (variance + noise)
            corrected(x, covariance, along, 0.0, information)
        settled[0], settled[1] = math.sqrt(covariance[OMEGA_M, OMEGA_M]), math.sqrt(covariance[OMEGA_J, OMEGA_J])
        moved(f, covariance, kept, 1.0, work)
        disturbed(covariance, d, usual_row, f, jump, p.K_t)
    return settled


def usual_row_of(d: Series) -> int:
    """Return a row from which the load changes as it mostly does: the median of its process noise."""
    noise = d.load_slope_variance + d.load_jump_variance / d.period_s**2
    return int(np.argsort(noise, kind="stable")[noise.size // 2])
