"""Film friction: friction of a grease film, which builds up with speed and vanishes at standstill."""

import math

from hil_forceps.effects.entry import Effect, Grid, Parameter

EFFECT = Effect(
    "film_friction",
    "motor",
    "friction of the motor that a film of grease gives way to near standstill, where it flows",
    "F_m += L (1 − exp(−|ω_m|/ω_f)) sgn ω_m",
    (
        Parameter("level_N_m", "N_m", 0.0, 1.0, 0.0, 3e-5, "friction at speed, L"),
        Parameter(
            "speed_rad_per_s",
            "rad_per_s",
            1e-3,
            1e3,
            None,
            0.3,
            "speed over which it builds up, ω_f",
            search_grid=Grid("speeds_rad_per_s", (1.0,)),
            hidden=(0.1, 0.6),
        ),
    ),
    "yield stress of a grease, regularised: T. C. Papanastasiou, Journal of Rheology 31(5), 1987",
    "slow motion at several speeds, both directions",
    changes="friction",
    dry_friction_of="motor",
)


def motor_friction_N_m(level_N_m: float, speed_rad_per_s: float, omega_m_rad_per_s: float) -> float:
    """Return the film's friction at a speed; 0 at standstill."""
    if level_N_m == 0.0:
        return 0.0
    return level_N_m * (1.0 - math.exp(-abs(omega_m_rad_per_s) / speed_rad_per_s))
