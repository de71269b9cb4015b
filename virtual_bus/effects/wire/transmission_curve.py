"""A lever of the jaw that hangs on its angle."""

import math


def lever_m(sine: float, cosine: float, r_j: float, theta_j_rad: float) -> float:
    """Return by how much the lever is above its mean."""
    if sine == 0.0 and cosine == 0.0:
        return 0.0
    return r_j * (sine * math.sin(theta_j_rad) + cosine * math.cos(theta_j_rad))


def taken_m(sine: float, cosine: float, r_j: float, theta_j_rad: float) -> float:
    """Return the integral of that from angle 0 on; 1 − cos without cancellation near it."""
    if sine == 0.0 and cosine == 0.0:
        return 0.0
    return r_j * (cosine * math.sin(theta_j_rad) + 2.0 * sine * math.sin(0.5 * theta_j_rad) ** 2)
