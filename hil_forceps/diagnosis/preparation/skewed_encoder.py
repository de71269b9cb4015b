"""A drive whose encoder is recorded late or early: what it counted at a row, no row shows."""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.layout import COMMAND_ERROR, INTEGRAL_ERROR, RECORDED_STATES, STATES, Series

Vector = NDArray[np.float64]


def counted_unseen(series: Series) -> Series:
    """Return the series with counts at its rows that are not those of the drive.

    They are weighed by the currents, as counts between rows are. Rows that show the same count before and behind tell
    none: a drive that holds a coarse count passes its edge and comes back within a sample.
    """
    counted = np.full(series.encoder_rad.size, np.nan)
    if series.states == STATES:
        return series._replace(counted_rad=counted)
    return series._replace(
        counted_rad=counted,
        states=STATES,
        first_state=_with_law(series.first_state),
        first_variance=_with_law(series.first_variance),
    )


def _with_law(of_state: Vector) -> Vector:
    """Return a state's values, or variances, with the drive's law: the error of its integral has a place of its own."""
    values = np.zeros(STATES)
    values[: of_state.size] = of_state
    if of_state.size == RECORDED_STATES:
        values[INTEGRAL_ERROR], values[COMMAND_ERROR] = values[COMMAND_ERROR], 0.0
    return values
