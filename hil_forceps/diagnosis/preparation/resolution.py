"""The step that recorded values come in: of a converter, a wire or a printed table."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

ROUNDING_SHARE = 1e-9  # of the largest value: levels nearer than that are the same
MIN_LEVELS = 3
MAX_STEP_SPREAD_SHARE = 0.01  # of a step: whole multiples of it are as exact


def resolution_of(values: Sequence[Vector]) -> float:
    """Return the step that all values are whole multiples of, counted from the least; 0 where there is none."""
    if not values:
        return 0.0
    levels = np.unique(np.concatenate(values))
    steps = np.diff(levels)
    steps = steps[steps > ROUNDING_SHARE * max(float(np.abs(levels).max()), 1e-300)]
    if steps.size < MIN_LEVELS:
        return 0.0
    least = float(steps.min())
    multiples = steps / least
    return least if float(np.max(np.abs(multiples - np.rint(multiples)))) < MAX_STEP_SPREAD_SHARE else 0.0
