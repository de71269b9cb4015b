"""A drive whose encoder is recorded late or early: what it counted at a row, no row shows."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.layout import COMMAND_ERROR, INTEGRAL_ERROR, RECORDED_STATES, STATES, Series

Vector = NDArray[np.float64]
Values = TypeVar("Values", Vector, NDArray[np.bool_])


def skewed(series: Series, rows: int) -> Series:
    """Return the series with its encoder as recorded some rows later, and with counts that are not those of the drive.

    They are weighed by the currents, as counts between rows are. Rows that show the same count before and behind tell
    none: a drive that holds a coarse count passes its edge and comes back within a sample.
    """
    n = series.encoder_rad.size
    there = (np.arange(n) + rows >= 0) & (np.arange(n) + rows < n)
    series = series._replace(
        encoder_rad=np.where(there, rows_later(series.encoder_rad, rows), np.nan),
        encoder_variance=rows_later(series.encoder_variance, rows),
        friction_free_m=rows_later(series.friction_free_m, rows),
        shifted_s=rows * series.period_s,
        counted_rad=np.full(n, np.nan),
    )
    if series.states == STATES:
        return series
    return series._replace(
        states=STATES,
        first_state=_with_law(series.first_state),
        first_variance=_with_law(series.first_variance),
    )


def rows_later(values: Values, rows: int) -> Values:
    """Return values so many rows later; at the ends, the first and the last there is."""
    return values[np.clip(np.arange(values.size) + rows, 0, values.size - 1)]


def _with_law(of_state: Vector) -> Vector:
    """Return a state's values, or variances, with the drive's law: the error of its integral has a place of its own."""
    values = np.zeros(STATES)
    values[: of_state.size] = of_state
    if of_state.size == RECORDED_STATES:
        values[INTEGRAL_ERROR], values[COMMAND_ERROR] = values[COMMAND_ERROR], 0.0
    return values
