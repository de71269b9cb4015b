"""Wire wound on itself."""

import math


def radius_m(pitch_m_per_turn: float, theta_p_rad: float) -> float:
    """Return by how much the radius has grown."""
    return pitch_m_per_turn * theta_p_rad / (2.0 * math.pi)


def wound_m(pitch_m_per_turn: float, theta_p_rad: float) -> float:
    """Return the integral of that from angle 0 on."""
    return pitch_m_per_turn * theta_p_rad**2 / (4.0 * math.pi)
