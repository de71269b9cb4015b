"""Encoder eccentricity: angle error of the encoder once per turn."""

import math

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "encoder_eccentricity",
    "sensor",
    "angle error of the encoder once per turn",
    "θ_enc = θ_m + A_s sin θ_m + A_c cos θ_m",
    (
        Parameter("sine_rad", "rad", -0.5, 0.5, 0.0, 2e-3, "amplitude of the sine"),
        Parameter("cosine_rad", "rad", -0.5, 0.5, 0.0, 2e-3, "amplitude of the cosine"),
    ),
    "mounting error of an encoder disc",
    "several turns of the motor, or a jaw sensor",
    by_angle=True,
)


def encoder_error_rad(sine_rad: float, cosine_rad: float, theta_m_rad: float) -> float:
    """Return the error of the angle that the encoder shows."""
    if sine_rad == 0.0 and cosine_rad == 0.0:
        return 0.0
    return sine_rad * math.sin(theta_m_rad) + cosine_rad * math.cos(theta_m_rad)
