"""Torque constant drift: the torque constant changes as the motor warms."""

import math

from hil_forceps.effects.entry import Effect, Grid, Parameter

# Plausible: magnets lose 0.1 % of K_t per kelvin.
EFFECT = Effect(
    "torque_constant_drift",
    "motor",
    "the torque constant changes as the motor warms",
    "K_t(t) = K_t (1 + c (1 − exp(−t/T)))",
    (
        Parameter("relative_change", "", -0.9, 1.0, 0.0, -0.02, "final change over K_t, c", plausible=0.2),
        Parameter(
            "time_constant_s",
            "s",
            1e-2,
            1e4,
            None,
            6.0,
            "time constant",
            search_grid=Grid("duration_s", (0.15, 0.6, 3.0)),
            hidden=(2.0, 8.0),
        ),
    ),
    "temperature coefficient of magnets: Sebastian, IEEE TIA 31(2), 1995",
    "the same load early and late in a run",
)


def relative_torque_constant(relative_change: float, time_constant_s: float, time_s: float) -> float:
    """Return the relative change of K_t at a time."""
    if relative_change == 0.0:
        return 0.0
    return relative_change * (1.0 - math.exp(-time_s / time_constant_s))
