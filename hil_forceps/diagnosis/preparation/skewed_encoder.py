"""What a drive counted where its encoder is recorded late: not what the rows show.

At a row the drive counts an angle between two that are recorded later. Where both show the same count, so did the
drive. Elsewhere its count is unknown, as in a lost row.
"""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.layout import COMMAND_ERROR, INTEGRAL_ERROR, RECORDED_STATES, STATES, Series

Vector = NDArray[np.float64]


def counted_beside(series: Series, skew_s: float) -> Series:
    """Return the series where the encoder is recorded `skew_s` late."""
    if skew_s == 0.0:
        return series
    counted = np.full(series.encoder_rad.size, np.nan)
    before, after = (_rows_later(series.encoder_rad, math.floor(skew_s / series.period_s) + i) for i in range(2))
    same = before == after
    counted[same] = before[same]
    if series.states == STATES:
        return series._replace(counted_rad=counted)
    return series._replace(
        counted_rad=counted,
        states=STATES,
        first_state=_with_law(series.first_state),
        first_variance=_with_law(series.first_variance),
    )


def _rows_later(values: Vector, rows: int) -> Vector:
    """Return values so many rows later, or earlier; NaN where there are none."""
    later = np.full(values.size, np.nan)
    first, stop = max(0, -rows), min(values.size, values.size - rows)
    if first < stop:
        later[first:stop] = values[first + rows : stop + rows]
    return later


def _with_law(of_state: Vector) -> Vector:
    """Return a state's values, or variances, with the drive's law: the error of its integral has a place of its own."""
    values = np.zeros(STATES)
    values[:RECORDED_STATES] = of_state
    values[INTEGRAL_ERROR], values[COMMAND_ERROR] = values[COMMAND_ERROR], 0.0
    return values
