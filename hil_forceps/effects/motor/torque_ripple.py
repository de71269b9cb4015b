"""Torque ripple: torque periodic in the motor's angle, in proportion to the current."""

import math

from hil_forceps.effects.entry import Effect, Grid, Parameter

# Plausible: no sound motor has a ripple beyond a fifth.
EFFECT = Effect(
    "torque_ripple",
    "motor",
    "torque periodic in the motor's angle, in proportion to the current",
    "ripple = S sin(h θ_m) + C cos(h θ_m)",
    (
        Parameter("sine", "", -0.9, 0.9, 0.0, 0.02, "amplitude of the sine", plausible=0.2),
        Parameter("cosine", "", -0.9, 0.9, 0.0, 0.02, "amplitude of the cosine", plausible=0.2),
        Parameter(
            "harmonic",
            "",
            1.0,
            200.0,
            None,
            6.0,
            "periods in a turn of the motor pulley",
            search_grid=Grid("harmonics_ripple", (1.0,)),
        ),
    ),
    "Jahns, Soong, IEEE TIE 43(2), 1996",
    "motion over several periods under load",
    by_angle=True,
    changes="torque",
    recurs_with="angle and current",
)


def relative_torque(sine: float, cosine: float, harmonic: float, theta_m_rad: float) -> float:
    """Return the relative change of the motor's torque with its angle."""
    if sine == 0.0 and cosine == 0.0:
        return 0.0
    phase = harmonic * theta_m_rad
    return sine * math.sin(phase) + cosine * math.cos(phase)
