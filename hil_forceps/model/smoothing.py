"""A measured angle as a smooth motion: angle, speed and acceleration at the rows, without delay."""

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from hil_forceps.model.parameters import Vector

_POLYNOMIAL_ORDER = 3
# −3 dB of a local cubic: the y at which ∫ (9/8 − 15/8 t²) cos(y t) dt over −1 … 1 is √½ (weights of the fit at the
# middle of its window).
_HALF_POWER_ARGUMENT = 3.34311


class Smooth(NamedTuple):
    """A motion, n each."""

    angle_rad: Vector
    speed_rad_per_s: Vector
    acceleration_rad_per_s2: Vector


def half_window(row_s: float, bandwidth_Hz: float) -> int:
    """Return the rows on each side of a local cubic that is 3 dB down at `bandwidth_Hz`."""
    return max(2, round((_HALF_POWER_ARGUMENT / (math.pi * bandwidth_Hz * row_s) - 1.0) / 2.0))


def smooth(angle_rad: Vector, row_s: float, bandwidth_Hz: float) -> Smooth:
    """Fit a cubic to the rows around each row (n).

    A run shorter than the window gets a shorter one. ValueError when `bandwidth_Hz` isn't positive, or for fewer than 5
    rows.
    """
    if not (math.isfinite(bandwidth_Hz) and bandwidth_Hz > 0.0):
        raise ValueError(f"bandwidth_Hz must be positive, got {bandwidth_Hz!r}")
    window = min(2 * half_window(row_s, bandwidth_Hz) + 1, (angle_rad.shape[0] - 1) // 2 * 2 + 1)
    if window <= _POLYNOMIAL_ORDER:
        raise ValueError(f"{angle_rad.shape[0]} rows are too few to tell a speed: 5 at least")
    values = [
        np.asarray(savgol_filter(angle_rad, window, _POLYNOMIAL_ORDER, deriv=order, delta=row_s)) for order in range(3)
    ]
    return Smooth(*values)
