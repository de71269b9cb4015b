"""Cogging: torque periodic in the motor's angle, without current."""

import math

from hil_forceps.effects.entry import Effect, Grid, Parameter

EFFECT = Effect(
    "cogging",
    "motor",
    "torque periodic in the motor's angle, without current",
    "cogging = S sin(h θ_m) + C cos(h θ_m)",
    (
        Parameter("sine_N_m", "N_m", -1.0, 1.0, 0.0, 1e-4, "amplitude of the sine"),
        Parameter("cosine_N_m", "N_m", -1.0, 1.0, 0.0, 1e-4, "amplitude of the cosine"),
        Parameter(
            "harmonic",
            "",
            1.0,
            200.0,
            None,
            6.0,
            "periods in a turn of the motor pulley",
            search_grid=Grid("harmonics_cogging", (1.0,)),
        ),
    ),
    "Hanselman, Brushless Permanent Magnet Motor Design, 2003",
    "slow motion over several periods",
    by_angle=True,
    changes="torque",
    recurs_with="angle",
)


def motor_torque_N_m(sine_N_m: float, cosine_N_m: float, harmonic: float, theta_m_rad: float) -> float:
    """Return the cogging torque at an angle of the motor."""
    if sine_N_m == 0.0 and cosine_N_m == 0.0:
        return 0.0
    phase = harmonic * theta_m_rad
    return sine_N_m * math.sin(phase) + cosine_N_m * math.cos(phase)
