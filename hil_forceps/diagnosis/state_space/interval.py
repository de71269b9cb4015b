"""The likelihood of a count: an angle of known mean and deviation lies between two edges.

With score and information of the mean it is exact; with the first two moments behind it, it is Curry's Gaussian fit.
In deviations, the score is the mean of the truncated normal and the information what truncation takes of its variance.
"""

import math

import numpy as np

from hil_forceps.diagnosis.state_space.kernel import inlined, subroutine

_ROOT_HALF = math.sqrt(0.5)
_ROOT_2PI = math.sqrt(2.0 * math.pi)
_TAIL_DEVIATIONS = 2.0  # deviations: beyond, differences of the normal distribution lose digits
_NARROW_DEVIATIONS = 0.5  # deviations: so do those of edges as near
# Behind a count the density is flatter than a normal one, and the next count tells less than its information. With
# these shares of it the innovations of simulated tracks are nearly white: predicted to 0.09 to 0.5 of a count, with
# 0.1 to 3.4 counts a row, their correlations are at most 0.02. Narrower ones gain less (decision 0026).
_OVERSTATED_PER_DEVIATION = 1.0 / 80.0
_MAX_OVERSTATED_SHARE = 0.15
_REACH_EXPONENT = 20.0  # exp(−20) of the density at the nearer edge: what lies beyond has no say
_NODES, _WEIGHTS = (tuple(v) for v in np.polynomial.legendre.leggauss(12))  # 1e-5 of the result over that reach


@subroutine
def interval_likelihood(low: float, high: float, mean: float, deviation: float) -> tuple[float, float, float]:
    """Return log P(low < x < high), its slope in the mean, and minus its curvature, for x ~ N(mean, deviation²)."""
    a, b = (low - mean) / deviation, (high - mean) / deviation
    width = (high - low) / deviation  # not b − a: far off, that has no digits left
    sign = 1.0
    if a + b < 0.0:  # mirrored, so that the nearer edge is a
        a, b, sign = -b, -a, -1.0
    if a > _TAIL_DEVIATIONS or width < _NARROW_DEVIATIONS:
        log_p, score, information = _by_quadrature(a, width)
    else:
        if a > 0.0:
            p = 0.5 * (math.erfc(a * _ROOT_HALF) - math.erfc(b * _ROOT_HALF))
        else:
            p = 1.0 - 0.5 * math.erfc(-a * _ROOT_HALF) - 0.5 * math.erfc(b * _ROOT_HALF)
        at_a, at_b = math.exp(-0.5 * a * a) / _ROOT_2PI, math.exp(-0.5 * b * b) / _ROOT_2PI
        score = (at_a - at_b) / p
        information = score * score - (a * at_a - b * at_b) / p
        log_p = math.log(p)
    # A truncated normal's variance is no less than 0 and no more than it was; rounding may say otherwise.
    return log_p, sign * score / deviation, max(0.0, min(1.0, information)) / (deviation * deviation)


@inlined
def share_kept(width: float) -> float:
    """Return which share of an interval's information lessens the variance; `width`: of the interval, in deviations."""
    return 1.0 - min(_MAX_OVERSTATED_SHARE, width * _OVERSTATED_PER_DEVIATION)


@subroutine
def _by_quadrature(a: float, width: float) -> tuple[float, float, float]:
    """Return the same in deviations, by moments of the density behind the nearer edge, exp(−a t − t²/2) at a + t."""
    reach = min(width, _REACH_EXPONENT / max(a, 1.0))
    total, first = 0.0, 0.0
    for node, weight in zip(_NODES, _WEIGHTS):  # noqa: B905  # not known to the compiler
        t = 0.5 * reach * (1.0 + node)
        density = weight * math.exp(-t * (a + 0.5 * t))
        total += density
        first += density * t
    mean = first / total
    second = 0.0
    for node, weight in zip(_NODES, _WEIGHTS):  # noqa: B905
        t = 0.5 * reach * (1.0 + node)
        second += weight * math.exp(-t * (a + 0.5 * t)) * (t - mean) ** 2
    log_p = -0.5 * a * a - math.log(_ROOT_2PI) + math.log(0.5 * reach * total)
    return log_p, a + mean, 1.0 - second / total
