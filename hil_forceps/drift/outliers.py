"""Single sessions that lie apart from the others: another load, a wire laid wrongly, a fit gone wrong.

One such session would pass for scatter, or at an end for a change. It is told by what leaving it out would gain
(auxiliary residuals; de Jong and Penzer, Diagnosing Shocks in Time Series, JASA 93, 1998).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, stats

from hil_forceps.drift.regression import fitted
from hil_forceps.drift.scatter import Scatter, scatters, whitened

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

MOST_SHARE = 0.1  # of the sessions: where more lie apart, the scatter is not Gaussian, and they are part of it


def auxiliary_residuals(series: Vector, columns: Matrix, deviations: Vector, scatter: Scatter) -> Vector:
    """Return for each session by how many deviations it differs from what all others tell of it."""
    white, _ = whitened(np.eye(series.size), deviations, scatter)
    inverse = white.T @ white  # of the covariance
    spread = inverse @ columns
    projected = inverse - spread @ linalg.pinvh(columns.T @ spread) @ spread.T
    return np.asarray((projected @ series) / np.sqrt(np.maximum(np.diag(projected), 1e-300)))


def outliers(series: Vector, columns: Matrix, deviations: Vector, rate: float) -> Sequence[int]:
    """Return places of sessions that lie apart, the farthest first; by chance one in `rate` of series has any."""
    kept = np.arange(series.size)
    found: list[int] = []
    beyond = float(stats.norm.isf(0.5 * rate / series.size))
    while len(found) + 1 <= MOST_SHARE * series.size:
        own = deviations[kept]
        scatter = fitted(series[kept], columns[kept], own, scatters(own)).scatter
        apart = np.abs(auxiliary_residuals(series[kept], columns[kept], own, scatter))
        farthest = int(np.argmax(apart))
        if apart[farthest] < beyond:
            break
        found.append(int(kept[farthest]))
        kept = np.delete(kept, farthest)
    return found
