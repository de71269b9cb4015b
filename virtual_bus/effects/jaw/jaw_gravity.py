"""The weight of the jaw."""

import math


def jaw_load_N_m(sine_N_m: float, cosine_N_m: float, theta_j_rad: float) -> float:
    """Return the torque of the weight."""
    if sine_N_m == 0.0 and cosine_N_m == 0.0:
        return 0.0
    return sine_N_m * math.sin(theta_j_rad) + cosine_N_m * math.cos(theta_j_rad)
