"""A load alone, as an integrated random walk: likelihood, smoothed course, and the shocks that it asks for.

The shocks are de Jong and Penzer's: the size that a change of level or slope at a row would have, and its χ², from one
pass of the smoother (Diagnosing shocks in time series, JASA 93, 1998).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.kernel import run_kernel, subroutine

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_SETTLING = 2  # rows before the likelihood counts: start and slope are unknown


class Shocks(NamedTuple):
    """n each: shocks between row k and k + 1, and the course."""

    slope: Vector  # size of a change of slope
    slope_chi2: Vector
    jump: Vector  # size of a jump
    jump_chi2: Vector
    course: Vector  # smoothed load
    open_variance: Vector  # of the load as filtered


class Filtering(NamedTuple):
    """What the filter leaves for the smoother, n rows: means (2), covariances (3), and both as predicted."""

    mean: Matrix
    covariance: Matrix
    ahead: Matrix
    covariance_ahead: Matrix


@run_kernel
def load_pass(
    load: Vector, noise: float, slope_variance: Vector, jump_variance: Vector, h: float, work: Filtering, out: Shocks
) -> float:
    """Fill `out`; return the log likelihood. `noise`: variance of the load cell; `h`: period of the rows in s."""
    n = load.size
    mean, cov, ahead, cov_ahead = work.mean, work.covariance, work.ahead, work.covariance_ahead
    x0, x1, a, b, c = load[0], 0.0, 1.0, 0.0, 1.0
    log_likelihood = 0.0
    for k in range(n):
        if k > 0:
            x0 += h * x1
            a += 2.0 * h * b + h * h * c + jump_variance[k - 1]
            b += h * c
            c += slope_variance[k - 1]
        ahead[k, 0], ahead[k, 1] = x0, x1
        cov_ahead[k, 0], cov_ahead[k, 1], cov_ahead[k, 2] = a, b, c
        total, error = a + noise, load[k] - x0
        if k > _SETTLING:
            log_likelihood -= 0.5 * (error * error / total + math.log(total))
        g0, g1 = a / total, b / total
        x0 += g0 * error
        x1 += g1 * error
        c -= g1 * b
        b -= g0 * b
        a -= g0 * a
        mean[k, 0], mean[k, 1] = x0, x1
        cov[k, 0], cov[k, 1], cov[k, 2] = a, b, c
        out.open_variance[k] = a
    _backward(mean, cov, ahead, cov_ahead, h, out)
    return log_likelihood


@subroutine
def _backward(mean: Matrix, cov: Matrix, ahead: Matrix, cov_ahead: Matrix, h: float, out: Shocks) -> None:
    """Smooth, and fill the shocks: with r = P⁻(x_s − x⁻) and N its variance, a shock is r/N and its χ² r²/N."""
    n = mean.shape[0]
    s0, s1 = mean[n - 1, 0], mean[n - 1, 1]
    va, vb, vc = cov[n - 1, 0], cov[n - 1, 1], cov[n - 1, 2]
    out.course[n - 1] = s0
    for k in range(n - 2, -1, -1):
        a, b, c = cov[k, 0], cov[k, 1], cov[k, 2]
        pa, pb, pc = cov_ahead[k + 1, 0], cov_ahead[k + 1, 1], cov_ahead[k + 1, 2]
        det = pa * pc - pb * pb
        i00, i01, i11 = pc / det, -pb / det, pa / det
        m00, m01, m10, m11 = a + h * b, b, b + h * c, c
        g00, g01 = m00 * i00 + m01 * i01, m00 * i01 + m01 * i11
        g10, g11 = m10 * i00 + m11 * i01, m10 * i01 + m11 * i11
        d0, d1 = s0 - ahead[k + 1, 0], s1 - ahead[k + 1, 1]
        r0, r1 = i00 * d0 + i01 * d1, i01 * d0 + i11 * d1
        e00, e01, e11 = pa - va, pb - vb, pc - vc
        n00 = i00 * (e00 * i00 + e01 * i01) + i01 * (e01 * i00 + e11 * i01)
        n11 = i01 * (e00 * i01 + e01 * i11) + i11 * (e01 * i01 + e11 * i11)
        if n00 > 0.0:
            out.jump[k], out.jump_chi2[k] = r0 / n00, r0 * r0 / n00
        if n11 > 0.0:
            out.slope[k], out.slope_chi2[k] = r1 / n11, r1 * r1 / n11
        s0, s1 = mean[k, 0] + g00 * d0 + g01 * d1, mean[k, 1] + g10 * d0 + g11 * d1
        out.course[k] = s0
        va, vb, vc = (
            a - (g00 * (e00 * g00 + e01 * g01) + g01 * (e01 * g00 + e11 * g01)),
            b - (g00 * (e00 * g10 + e01 * g11) + g01 * (e01 * g10 + e11 * g11)),
            c - (g10 * (e00 * g10 + e01 * g11) + g11 * (e01 * g10 + e11 * g11)),
        )


def empty_shocks(rows: int) -> Shocks:
    """Return room for the shocks of a load."""
    return Shocks(*(np.zeros(rows) for _ in Shocks._fields))


def empty_filtering(rows: int) -> Filtering:
    """Return room for what the filter leaves."""
    return Filtering(*(np.empty((rows, columns)) for columns in (2, 3, 2, 3)))
