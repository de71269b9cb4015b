"""Friction higher at low speed."""

import math


def motor_friction_N_m(rise_N_m: float, speed_rad_per_s: float, omega_m_rad_per_s: float) -> float:
    """Return the rise of dry friction at a speed."""
    if rise_N_m == 0.0:
        return 0.0
    return rise_N_m * math.exp(-((omega_m_rad_per_s / speed_rad_per_s) ** 2))
