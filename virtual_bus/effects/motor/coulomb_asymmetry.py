"""Dry friction of the motor that differs by direction."""


def motor_friction_N_m(difference_N_m: float, side: float) -> float:
    """Return what one side has more."""
    return abs(difference_N_m) if difference_N_m * side > 0.0 else 0.0
