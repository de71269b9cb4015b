"""Torque over the motor's angle, in proportion to the current."""

import math


def relative_torque(sine: float, cosine: float, harmonic: float, theta_m_rad: float) -> float:
    """Return S sin hθ + C cos hθ."""
    if sine == 0.0 and cosine == 0.0:
        return 0.0
    return sine * math.sin(harmonic * theta_m_rad) + cosine * math.cos(harmonic * theta_m_rad)
