"""Delayed channels: resampling by a fraction of a row."""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.model.parameters import Vector


def late(values: Vector, rows: float, *, linear: bool = False) -> Vector:
    """Return `values` (n) delayed by `rows` (fractional or negative, too), held beyond the ends.

    Interpolated by a cubic through four rows, or linearly, for channels that jump.
    """
    if rows == 0.0:
        return values
    n = values.shape[0]
    at = np.clip(np.arange(n) - rows, 0.0, n - 1.0)
    first = np.minimum(np.floor(at).astype(np.int64), n - 2)
    t = at - first
    if linear:
        return np.asarray(values[first] * (1.0 - t) + values[first + 1] * t)
    before, after = values[np.maximum(first - 1, 0)], values[np.minimum(first + 2, n - 1)]
    here, there = values[first], values[first + 1]
    return np.asarray(
        -before * t * (t - 1.0) * (t - 2.0) / 6.0
        + here * (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0
        - there * (t + 1.0) * t * (t - 2.0) / 2.0
        + after * (t + 1.0) * t * (t - 1.0) / 6.0
    )


def late_load(
    values: Vector, edge_rows: NDArray[np.int64], edge_fractions: Vector, rows: float
) -> tuple[Vector, NDArray[np.int64], Vector]:
    """Return a load with jumps, delayed by `rows`: values, edge_rows, edge_fractions."""
    n = values.shape[0]
    at = np.clip(np.arange(n) - rows, 0.0, n - 1.0)
    first = np.minimum(np.floor(at).astype(np.int64), n - 2)
    t = at - first
    jumps = np.full(n, np.nan)
    jumps[edge_rows] = edge_fractions
    jump = jumps[first]
    weight = np.where(np.isnan(jump), t, (t >= jump).astype(np.float64))
    edges = edge_rows + edge_fractions + rows
    inside = (edges >= 0.0) & (edges < n - 1)
    edges = edges[inside]
    whole = np.floor(edges).astype(np.int64)
    return values[first] * (1.0 - weight) + values[first + 1] * weight, whole, edges - whole
