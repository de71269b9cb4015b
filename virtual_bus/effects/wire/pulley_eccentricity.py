"""A motor pulley that runs out of true."""

import math


def radius_m(sine: float, cosine: float, r_m: float, theta_p_rad: float) -> float:
    """Return by how much the radius is above its mean."""
    if sine == 0.0 and cosine == 0.0:
        return 0.0
    return r_m * (sine * math.sin(theta_p_rad) + cosine * math.cos(theta_p_rad))


def wound_m(sine: float, cosine: float, r_m: float, theta_p_rad: float) -> float:
    """Return the integral of that from angle 0 on."""
    if sine == 0.0 and cosine == 0.0:
        return 0.0
    return r_m * (cosine * math.sin(theta_p_rad) + sine * (1.0 - math.cos(theta_p_rad)))
