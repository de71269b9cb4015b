"""Viscous drift: viscous friction of the motor changes as it warms up."""

import math

from hil_forceps.effects.entry import Effect, Grid, Parameter

# Plausible: a lubricant is up to four times as viscous cold as warm.
EFFECT = Effect(
    "viscous_drift",
    "motor",
    "viscous friction of the motor changes as it warms up",
    "D(t) = D_m (1 + c (1 − exp(−t/T)))",
    (
        Parameter("relative_change", "", -0.95, 5.0, 0.0, 0.1, "final change over D_m, c", plausible=3.0),
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
    "viscosity of a lubricant over temperature: Simoni et al., IROS 2015",
    "the same motion early and late in a run",
    changes="torque",
)


def motor_viscosity_N_m_s_per_rad(relative_change: float, time_constant_s: float, D_m: float, time_s: float) -> float:
    """Return the change of the motor's viscous friction at a time."""
    if relative_change == 0.0:
        return 0.0
    return D_m * relative_change * (1.0 - math.exp(-time_s / time_constant_s))
