"""Friction that a film of grease gives way to near standstill."""

import math


def motor_friction_N_m(level_N_m: float, speed_rad_per_s: float, omega_m_rad_per_s: float) -> float:
    """Return the film's friction at a speed."""
    if level_N_m == 0.0:
        return 0.0
    return -level_N_m * math.expm1(-abs(omega_m_rad_per_s) / speed_rad_per_s)
