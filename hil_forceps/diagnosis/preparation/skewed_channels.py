"""Channels that are recorded late or early: a series with each of them moved by whole rows, to where it was measured.

What is left of a skew is half a row at most, which the filter takes in to first order. A current is taken between two
rows, so of its skew up to a row is left, and always late: the line between two currents goes no further.
"""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.layout import (
    COMMAND_ERROR,
    CURRENT,
    ENCODER,
    INTEGRAL_ERROR,
    JAW,
    LOAD_CELL,
    RECORDED_STATES,
    STATES,
    Series,
)
from hil_forceps.model.composition import Physics

Vector = NDArray[np.float64]
Values = TypeVar("Values", Vector, NDArray[np.bool_])


def rows_late(plant: Physics, period_s: float) -> tuple[int, int, int, int]:
    """Return by how many rows each channel is to be moved (ENCODER, JAW, LOAD_CELL, CURRENT)."""
    return (
        round(plant.channel_skew_theta_m_s / period_s),
        round(plant.channel_skew_theta_j_s / period_s),
        round(plant.channel_skew_tau_w_s / period_s),
        math.floor(plant.channel_skew_current_s / period_s),
    )


def moved_back(series: Series, late: tuple[int, int, int, int], load_cell_skew_s: float) -> Series:
    """Return the series with each channel at the rows at which it was measured.

    A load cell takes the load's breaks with it: they were found in what it showed. Those go by its whole skew: a break
    that comes between two rows is one in each of them.
    """
    cell_rows = load_cell_skew_s / series.period_s
    series = series._replace(
        shifted_s=np.array(late, dtype=np.float64) * series.period_s,
        jaw_rad=_measured_later(series.jaw_rad, late[JAW]),
        load_N_m=_measured_later(series.load_N_m, late[LOAD_CELL]),
        current_A=_measured_later(series.current_A, late[CURRENT]),
        load_slope_variance=_between_rows(series.load_slope_variance, cell_rows),
        load_jump_variance=_between_rows(series.load_jump_variance, cell_rows),
    )
    if late[ENCODER] == 0:
        return series
    return series._replace(
        encoder_rad=_measured_later(series.encoder_rad, late[ENCODER]),
        encoder_variance=rows_later(series.encoder_variance, late[ENCODER]),
        friction_free_m=rows_later(series.friction_free_m, late[ENCODER]),
    )


def with_unseen_counts(series: Series) -> Series:
    """Return the series of a drive whose encoder is recorded late or early: what it counted at a row, no row shows.

    The counts are weighed by the currents, as counts between rows are. Rows that show the same count before and behind
    tell none: a drive that holds a coarse count passes its edge and comes back within a sample.
    """
    series = series._replace(counted_rad=np.full(series.encoder_rad.size, np.nan))
    if series.states == STATES:
        return series
    return series._replace(
        states=STATES,
        first_state=_with_law(series.first_state),
        first_variance=_with_law(series.first_variance),
    )


def rows_later(values: Values, rows: int) -> Values:
    """Return values so many rows later; at the ends, the first and the last there is."""
    return values[np.clip(np.arange(values.size) + rows, 0, values.size - 1)] if rows else values


def _between_rows(values: Vector, rows: float) -> Vector:
    """Return values so many rows later, each shared between the two rows next to it."""
    whole = math.floor(rows)
    share = rows - whole
    return (1.0 - share) * rows_later(values, whole) + share * rows_later(values, whole + 1)


def _measured_later(values: Vector, rows: int) -> Vector:
    """Return what was measured so many rows later; NaN at the end where the run has no such row."""
    if rows == 0:
        return values
    at = np.arange(values.size) + rows
    return np.where((at >= 0) & (at < values.size), rows_later(values, rows), np.nan)


def _with_law(of_state: Vector) -> Vector:
    """Return a state's values, or variances, with the drive's law: the error of its integral has a place of its own."""
    values = np.zeros(STATES)
    values[: of_state.size] = of_state
    if of_state.size == RECORDED_STATES:
        values[INTEGRAL_ERROR], values[COMMAND_ERROR] = values[COMMAND_ERROR], 0.0
    return values
