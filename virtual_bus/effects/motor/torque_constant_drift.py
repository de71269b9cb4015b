"""The torque constant changes as the motor warms."""

import math


def relative_torque_constant(relative_change: float, time_constant_s: float, time_s: float) -> float:
    """Return c (1 − exp(−t/T)); nothing has warmed before time 0."""
    if relative_change == 0.0 or time_s <= 0.0:
        return 0.0
    return -relative_change * math.expm1(-time_s / time_constant_s)
