"""Whether a run's load is that of something elastic which the jaw touches: nothing up to an angle, and straight beyond.

Such a load answers to the jaw at once, also to what no row shows of it, and is no input of its own: it stiffens the
jaw. A load that is given from outside follows one such line over the jaw's angle to within its noise by no chance, when
the jaw passes its angles more than once.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Vector = NDArray[np.float64]

FALSE_REJECTION_RATE = 1e-6  # of a curve that is the true one: its noise is known to some per cent only
MIN_SPREAD_DEVIATIONS = 20.0  # deviations of the load cell that a load must vary by
MIN_PASSES = 3  # over the middle of the angles: less, and any load is a function of the angle


class Contact(NamedTuple):
    """A load that is a function of the jaw's angle."""

    stiffness_N_m_per_rad: float
    angle_rad: float  # where it begins
    upward: bool  # it is touched above that angle, else below


_ANGLES = 64  # at which a contact is first looked for
_ROUNDS = 3  # of closer looks, each between the neighbours of the best


def contact(load: Vector, jaw_rad: Vector, noise_variance: float, angle_variance: float) -> Contact | None:
    """Return the contact that a run's load follows over the jaw's angle; None where it follows none."""
    if np.ptp(load) < MIN_SPREAD_DEVIATIONS * np.sqrt(noise_variance) or _passes(jaw_rad) < MIN_PASSES:
        return None
    best = min((_fitted(load, jaw_rad, upward) for upward in (True, False)), key=lambda found: found[0])
    squares, stiffness, angle, upward = best
    chi2 = squares / (noise_variance + stiffness**2 * angle_variance)
    # Deviations of sensors are known to some per cent: a tenth more power is no misfit.
    if stiffness <= 0.0 or chi2 > 1.1 * float(stats.chi2.isf(FALSE_REJECTION_RATE, load.size - 2)):
        return None
    return Contact(stiffness, angle, upward)


def _passes(angle: Vector) -> int:
    """Return how often a jaw passes the middle of its angles."""
    middle, reach = 0.5 * (float(angle.min()) + float(angle.max())), 0.1 * float(np.ptp(angle))
    side = np.where(angle > middle + reach, 1, np.where(angle < middle - reach, -1, 0))
    return int(np.count_nonzero(np.diff(side[side != 0])))


def _fitted(load: Vector, angle: Vector, upward: bool) -> tuple[float, float, float, bool]:
    """Return sum of squares, stiffness and angle of the best contact on one side."""
    low, high = float(angle.min()), float(angle.max())
    best = (np.inf, 0.0, low, upward)
    for _ in range(_ROUNDS + 1):
        for at in np.linspace(low, high, _ANGLES):
            way = np.maximum(angle - at, 0.0) if upward else np.minimum(angle - at, 0.0)
            power = float(way @ way)
            stiffness = float(way @ load) / power if power > 0.0 else 0.0
            squares = float(np.sum((load - stiffness * way) ** 2))
            best = min(best, (squares, stiffness, float(at), upward))
        step = 2.0 * (high - low) / _ANGLES
        low, high = best[2] - step, best[2] + step
    return best
