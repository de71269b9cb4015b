"""A sample of the drive as the filter knows it: its law acts on a count that a row shows, or on one that none shows.

In a lost row a drive counts an angle of which the filter has mean and variance. So the law is given the count's mean,
and what the count may differ by is part of the state: in proportion to the angle's error, as far as it follows that
(statistical linearisation of the rounding: Gelb, *Applied Optimal Estimation*, 1974, ch. 6), and the rest by chance.
What a drive counts between rows, see `between_rows.py`.
"""

import math
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.kernel import as_its_caller, inlined, with_work_arrays
from hil_forceps.diagnosis.state_space.layout import (
    COMMAND_ERROR,
    COUNT_ERROR,
    DERIVATIVE_ERROR,
    INTEGRAL_ERROR,
    THETA_M,
)
from hil_forceps.model.drive_law import CASCADE_TIME, ERROR_FIRST, KD, KI, KP, SAMPLE_TIME, SHARE

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Errors = TypeVar("Errors", float, Vector)

REACH_DEVIATIONS = 4.0  # deviations: 6e-5 of a normal distribution lies beyond
_ERRORS = (INTEGRAL_ERROR, DERIVATIVE_ERROR, COUNT_ERROR, COMMAND_ERROR)  # as `law_errors` returns them
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
    reach = int(REACH_DEVIATIONS * deviation_rad / quantum_rad + 0.5)
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


@as_its_caller
def law_errors(
    law: Vector, integral: Errors, derivative: Errors, before: Errors, error: Errors, count: Errors
) -> tuple[Errors, Errors, Errors, Errors]:
    """Return errors of the law behind a sample: of integral [A], derivative [A], count [rad] and command [A].

    `before`: of the last count; `error` and `count`: of this sample's control error and count [rad]. Vectors hold many.
    """
    cascade = law[CASCADE_TIME] / law[KD] if law[CASCADE_TIME] > 0.0 else 0.0
    filtered = (1.0 - law[SHARE]) * derivative - law[KD] * law[SHARE] / law[SAMPLE_TIME] * (count - before)
    summed = integral + law[KI] * law[SAMPLE_TIME] * (error + cascade * filtered)
    used = summed if law[ERROR_FIRST] != 0.0 else 1.0 * integral
    return summed, filtered, count, law[KP] * error + used + filtered


@inlined
def derivative_left(law: Vector, samples: int) -> float:
    """Return what an error of the derivative adds to the command that many samples later, over the error."""
    after = (0.0, 1.0, 0.0, 1.0)
    for _ in range(samples):
        after = law_errors(law, after[0], after[1], 0.0, 0.0, 0.0)
    return after[3]


@as_its_caller
def sampled(law: Vector, count: float | Vector, reacts: bool, x: Vector | Matrix) -> None:
    """Carry the law's part of the state, or of changes of it, over a sample of the drive; many have a column each.

    `count`: what the count differs by from the one that the law was given; `reacts`: its command is within its limit.
    """
    after = law_errors(law, x[INTEGRAL_ERROR], x[DERIVATIVE_ERROR], x[COUNT_ERROR], -1.0 * count, count)
    x[INTEGRAL_ERROR], x[DERIVATIVE_ERROR], x[COUNT_ERROR] = after[0], after[1], after[2]
    x[COMMAND_ERROR] = after[3] * (1.0 if reacts else 0.0)


@with_work_arrays
def sampled_covariance(
    law: Vector, slope: float, count_variance: float, reference_variance: float, reacts: bool, covariance: Matrix
) -> None:
    """Replace a covariance by that after a sample of the drive; the variances are of what comes by chance [rad²]."""
    acts = (1.0, 1.0, 1.0, 1.0 if reacts else 0.0)
    by_integral = law_errors(law, 1.0, 0.0, 0.0, 0.0, 0.0)
    by_derivative = law_errors(law, 0.0, 1.0, 0.0, 0.0, 0.0)
    by_before = law_errors(law, 0.0, 0.0, 1.0, 0.0, 0.0)
    by_count = law_errors(law, 0.0, 0.0, 0.0, -1.0, 1.0)
    by_reference = law_errors(law, 0.0, 0.0, 0.0, 1.0, 0.0)
    new, block = np.empty((4, covariance.shape[0])), np.empty((4, 4))
    for j in range(covariance.shape[0]):
        angle, integral = slope * covariance[THETA_M, j], covariance[INTEGRAL_ERROR, j]
        derivative, before = covariance[DERIVATIVE_ERROR, j], covariance[COUNT_ERROR, j]
        for i in range(4):
            own = by_count[i] * angle + by_integral[i] * integral
            new[i, j] = acts[i] * (own + by_derivative[i] * derivative + by_before[i] * before)
    for i in range(4):
        for m in range(4):
            by_chance = (
                by_count[i] * by_count[m] * count_variance + by_reference[i] * by_reference[m] * reference_variance
            )
            block[i, m] = slope * by_count[m] * new[i, THETA_M] + by_integral[m] * new[i, INTEGRAL_ERROR]
            block[i, m] += by_derivative[m] * new[i, DERIVATIVE_ERROR] + by_before[m] * new[i, COUNT_ERROR]
            block[i, m] = acts[m] * (block[i, m] + acts[i] * by_chance)
    for i in range(4):
        covariance[_ERRORS[i]], covariance[:, _ERRORS[i]] = new[i], new[i]
    for i in range(4):
        for m in range(4):
            covariance[_ERRORS[i], _ERRORS[m]] = block[i, m]
