"""Stribeck friction: friction of the motor is higher at low speed."""

import math

from hil_forceps.effects.entry import Effect, Grid, Parameter

EFFECT = Effect(
    "stribeck_friction",
    "motor",
    "friction of the motor higher at low speed",
    "F_m += R exp(−(ω_m/ω_s)²) sgn ω_m",
    (
        Parameter("rise_N_m", "N_m", 0.0, 1.0, 0.0, 1e-4, "rise above Coulomb friction at standstill, T_s − T_c"),
        Parameter(
            "speed_rad_per_s",
            "rad_per_s",
            1e-3,
            1e3,
            None,
            0.3,
            "speed over which it falls, ω_s",
            search_grid=Grid("speeds_rad_per_s", (1.0,)),
            hidden=(0.1, 0.6),
        ),
    ),
    "R. Stribeck 1902; Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",
    "slow motion at several speeds, both directions",
    changes="friction",
    dry_friction_of="motor",
)


def motor_friction_N_m(rise_N_m: float, speed_rad_per_s: float, omega_m_rad_per_s: float) -> float:
    """Return the rise of the motor's dry friction at a speed."""
    if rise_N_m == 0.0:
        return 0.0
    share = omega_m_rad_per_s / speed_rad_per_s
    return rise_N_m * math.exp(-share * share)


def motor_friction_at_rest_N_m(rise_N_m: float) -> float:
    """Return the rise at standstill."""
    return rise_N_m
