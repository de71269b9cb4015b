"""Friction that the tension of the wire makes."""


def motor_friction_N_m(mu: float, r_m: float, tension_N: float) -> float:
    """Return the dry friction under a tension."""
    return mu * r_m * abs(tension_N)
