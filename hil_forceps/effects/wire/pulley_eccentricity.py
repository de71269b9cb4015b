"""Pulley eccentricity: the effective radius of the motor pulley varies round it."""

import math

from hil_forceps.effects.entry import Effect, Parameter

# Plausible: the radius of a sound pulley varies by a tenth at most.
EFFECT = Effect(
    "pulley_eccentricity",
    "wire",
    "the effective radius of the motor pulley varies round it",
    "r(θ_m) = r_m (1 + E_c cos θ_m + E_s sin θ_m)",
    (
        Parameter("sine", "", -0.5, 0.5, 0.0, 0.01, "amplitude of the sine", plausible=0.1),
        Parameter("cosine", "", -0.5, 0.5, 0.0, 0.01, "amplitude of the cosine", plausible=0.1),
    ),
    "mounting error of a pulley",
    "a jaw sensor, motion over a good part of a turn",
    by_angle=True,
    changes="wire",
)


def wound_m(sine: float, cosine: float, r_m: float, theta_p_rad: float) -> float:
    """Return the wire that the eccentricity winds up from angle 0 on: the integral of `radius_m`."""
    if cosine == 0.0 and sine == 0.0:
        return 0.0
    return r_m * (cosine * math.sin(theta_p_rad) + sine * (1.0 - math.cos(theta_p_rad)))


def radius_m(sine: float, cosine: float, r_m: float, theta_p_rad: float) -> float:
    """Return the deviation of the motor pulley's radius from its mean."""
    if cosine == 0.0 and sine == 0.0:
        return 0.0
    return r_m * (cosine * math.cos(theta_p_rad) + sine * math.sin(theta_p_rad))
