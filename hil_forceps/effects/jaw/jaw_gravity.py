"""Jaw gravity: the jaw's weight."""

import math

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "jaw_gravity",
    "jaw",
    "the jaw's weight",
    "gravity = m g l cos(θ_j + φ) = G_c cos θ_j + G_s sin θ_j, a load on the jaw",
    (
        Parameter("sine_N_m", "N_m", -0.1, 0.1, 0.0, 1e-5, "amplitude of the sine"),
        Parameter("cosine_N_m", "N_m", -0.1, 0.1, 0.0, 1e-5, "amplitude of the cosine"),
    ),
    "rigid body under gravity",
    "the jaw over a wide range of angles; the forceps in another orientation",
    by_angle=True,
    changes="torque",
)


def jaw_load_N_m(sine_N_m: float, cosine_N_m: float, theta_j_rad: float) -> float:
    """Return the load on the jaw by its weight."""
    if cosine_N_m == 0.0 and sine_N_m == 0.0:
        return 0.0
    return cosine_N_m * math.cos(theta_j_rad) + sine_N_m * math.sin(theta_j_rad)
