"""A sample of the drive as the filter knows it: its law acts on a count that a row shows, or on one that none shows.

In a lost row a drive counts an angle of which the filter has mean and variance. So the law is given the count's mean,
and what the count may differ by is part of the state: in proportion to the angle's error, as far as it follows that
(statistical linearisation of the rounding: Gelb, *Applied Optimal Estimation*, 1974, ch. 6), and the rest by chance.
What a drive counts between rows, see `between_rows.py`.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.kernel import inlined, kernel
from hil_forceps.diagnosis.state_space.layout import (
    COMMAND_ERROR,
    COUNT_ERROR,
    DERIVATIVE_ERROR,
    INTEGRAL_ERROR,
    THETA_M,
)
from hil_forceps.model.drive_law import ERROR_FIRST, KD, KI, KP, SAMPLE_TIME, SHARE

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

REACH = 4.0  # deviations: 6e-5 of a normal distribution lies beyond
_OF = (THETA_M, INTEGRAL_ERROR, DERIVATIVE_ERROR, COUNT_ERROR)
_ERRORS = (COUNT_ERROR, INTEGRAL_ERROR, DERIVATIVE_ERROR, COMMAND_ERROR)
_ROOT_2 = math.sqrt(2.0)
_ROOT_2_PI = math.sqrt(2.0 * math.pi)


class Count(NamedTuple):
    """What a drive counts of an angle that is known as a normal distribution."""

    mean_rad: float
    slope: float  # covariance of count and angle over the variance of the angle
    variance: float  # [rad²]: of what is left of the count besides


@inlined
def expected_count(angle_rad: float, deviation_rad: float, quantum_rad: float) -> Count:
    """Return mean, slope and remaining variance of a count; `quantum_rad` 0: the angle itself is read."""
    if quantum_rad <= 0.0:
        return Count(angle_rad, 1.0, 0.0)
    nearest = math.floor(angle_rad / quantum_rad + 0.5)
    reach = int(REACH * deviation_rad / quantum_rad + 0.5)
    # Count n and more is counted beyond the edge below it: sums over edges are those over counts.
    mean, square, slope = 0.0, 0.0, 0.0
    for k in range(-reach, reach + 2):
        away = ((nearest + k - 0.5) * quantum_rad - angle_rad) / deviation_rad
        beyond = 0.5 * math.erfc(away / _ROOT_2)
        if k <= 0:
            mean += beyond - 1.0
            square += (2 * k - 1) * (beyond - 1.0)
        else:
            mean += beyond
            square += (2 * k - 1) * beyond
        slope += math.exp(-0.5 * away * away) / _ROOT_2_PI
    slope *= quantum_rad / deviation_rad
    variance = (square - mean * mean) * quantum_rad * quantum_rad - (slope * deviation_rad) ** 2
    return Count((nearest + mean) * quantum_rad, slope, max(0.0, variance))


@inlined
def sampled(law: Vector, count: float | Vector, reacts: bool, x: Vector | Matrix) -> None:
    """Carry the law's part of the state, or of changes of it, over a sample of the drive; many have a column each.

    `count`: what the count differs by from the one that the law was given; `reacts`: its command is within its limit.
    """
    rate = law[KD] * law[SHARE] / law[SAMPLE_TIME]
    integral = x[INTEGRAL_ERROR] - law[KI] * law[SAMPLE_TIME] * count
    used = integral if law[ERROR_FIRST] != 0.0 else 1.0 * x[INTEGRAL_ERROR]
    x[DERIVATIVE_ERROR] = (1.0 - law[SHARE]) * x[DERIVATIVE_ERROR] - rate * (count - x[COUNT_ERROR])
    x[COMMAND_ERROR] = (used + x[DERIVATIVE_ERROR] - law[KP] * count) * (1.0 if reacts else 0.0)
    x[INTEGRAL_ERROR], x[COUNT_ERROR] = integral, count


@kernel
def sampled_covariance(
    law: Vector, slope: float, count_variance: float, reference_variance: float, reacts: bool, covariance: Matrix
) -> None:
    """Replace a covariance by that after a sample of the drive; the variances are of what comes by chance [rad²]."""
    acts = 1.0 if reacts else 0.0
    pull, rate = law[KI] * law[SAMPLE_TIME], law[KD] * law[SHARE] / law[SAMPLE_TIME]
    at_once, kept = law[KP] + law[ERROR_FIRST] * pull, 1.0 - law[SHARE]
    # Each new error by the old angle, integral, derivative and count; by chance of the new count; of the reference.
    by = (
        (slope, 0.0, 0.0, 0.0),
        (-slope * pull, 1.0, 0.0, 0.0),
        (-slope * rate, 0.0, kept, rate),
        (-slope * acts * (at_once + rate), acts, acts * kept, acts * rate),
    )
    by_count = (1.0, -pull, -rate, -acts * (at_once + rate))
    by_reference = (0.0, pull, 0.0, acts * at_once)
    old, block = np.empty((4, covariance.shape[0])), np.empty((4, 4))
    for k in range(4):
        old[k] = covariance[_OF[k]]
    new = np.empty_like(old)
    for i in range(4):
        new[i] = by[i][0] * old[0] + by[i][1] * old[1] + by[i][2] * old[2] + by[i][3] * old[3]
    for i in range(4):
        for m in range(4):
            block[i, m] = by_count[i] * by_count[m] * count_variance
            block[i, m] += by_reference[i] * by_reference[m] * reference_variance
            for k in range(4):
                block[i, m] += new[i, _OF[k]] * by[m][k]
    for i in range(4):
        covariance[_ERRORS[i]], covariance[:, _ERRORS[i]] = new[i], new[i]
    for i in range(4):
        for m in range(4):
            covariance[_ERRORS[i], _ERRORS[m]] = block[i, m]
