"""Estimates over sessions without drift: y_k = μ + u_k + v_k.

v_k is the error of session k's own fit, of known deviation. u_k is what differs between sessions (temperature, how the
wire lies): an autoregression u_k = φ u_{k-1} + e_k of unknown deviation and correlation φ. With φ = 0 it is white; with
φ = 1 it is a random walk from μ on, and the whole is the local level model (Durbin and Koopman, Time Series Analysis by
State Space Methods, 2nd ed., chapter 2). Sessions count one by one: wear comes by use, not by days.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hil_forceps.kernels.compiler import kernel_compiler

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
_kernel = kernel_compiler(("hil_forceps/drift/scatter.py",))

CORRELATIONS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.97, 1.0)
# Deviations of e over the usual deviation of a session's own error, a quarter apart: of 100 sessions the log likelihood
# between two of them is less than 2 below its best (a deviation is known to 1/√200, a correlation to √(1 − φ²)/10).
RATIOS = tuple(0.25 * 1.25**step for step in range(32))  # up to 250


class Scatter(NamedTuple):
    """What differs between sessions."""

    correlation: float  # from session to session
    deviation: float  # of its changes e


def scatters(deviations: Vector) -> list[Scatter]:
    """Return all scatters that are looked at beside sessions with these deviations of their own."""
    usual = float(np.median(deviations))
    found = [Scatter(0.0, 0.0)]
    for correlation in CORRELATIONS:
        found += [Scatter(correlation, ratio * usual) for ratio in RATIOS]
    return found


def whitened(columns: Matrix, deviations: Vector, scatter: Scatter) -> tuple[Matrix, float]:
    """Return columns (n × m) whitened by a scatter and each session's own deviation, and half the log determinant."""
    start = scatter.deviation**2 / (1.0 - scatter.correlation**2) if scatter.correlation < 1.0 else 0.0
    out = np.ascontiguousarray(columns, dtype=np.float64).copy()
    half = _whiten(out, deviations, scatter.correlation, scatter.deviation, start)
    return out, float(half)


@_kernel
def _whiten(columns: Matrix, deviations: Vector, correlation: float, deviation: float, start: float) -> float:
    """Replace columns by their innovations over their deviations: a Kalman filter with one state."""
    rows, count = columns.shape
    state = np.zeros(count)
    variance, half = start, 0.0
    for k in range(rows):
        total = variance + deviations[k] ** 2
        root = np.sqrt(total)
        half += np.log(root)
        gain = variance / total
        for j in range(count):
            innovation = columns[k, j] - state[j]
            columns[k, j] = innovation / root
            state[j] = correlation * (state[j] + gain * innovation)
        variance = correlation**2 * variance * (1.0 - gain) + deviation**2
    return half


def drawn(rng: np.random.Generator, deviations: Vector, scatter: Scatter, count: int) -> Matrix:
    """Return so many courses (n × count) of estimates without drift about 0."""
    rows = deviations.size
    e = scatter.deviation * rng.standard_normal((rows, count))
    e[0] *= 1.0 / np.sqrt(1.0 - scatter.correlation**2) if scatter.correlation < 1.0 else 0.0
    e = lfilter([1.0], [1.0, -scatter.correlation], e, axis=0)
    return np.asarray(e + deviations[:, np.newaxis] * rng.standard_normal((rows, count)))
