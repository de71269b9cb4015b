"""An encoder disc that runs out of true."""

import math


def encoder_error_rad(sine_rad: float, cosine_rad: float, theta_m_rad: float) -> float:
    """Return the error of the angle."""
    if sine_rad == 0.0 and cosine_rad == 0.0:
        return 0.0
    return sine_rad * math.sin(theta_m_rad) + cosine_rad * math.cos(theta_m_rad)
