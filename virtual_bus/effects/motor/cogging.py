"""Torque over the motor's angle, without current."""

import math


def motor_torque_N_m(sine_N_m: float, cosine_N_m: float, harmonic: float, theta_m_rad: float) -> float:
    """Return S sin hθ + C cos hθ."""
    if sine_N_m == 0.0 and cosine_N_m == 0.0:
        return 0.0
    return sine_N_m * math.sin(harmonic * theta_m_rad) + cosine_N_m * math.cos(harmonic * theta_m_rad)
