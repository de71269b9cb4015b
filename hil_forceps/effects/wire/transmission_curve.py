"""Transmission curve: the ratio depends on the jaw's angle: the wire pulls at a lever or an uneven pulley."""

import math

from hil_forceps.effects.entry import Effect, Parameter

# Plausible: a lever that turns by less than about 60 degrees to either side.
EFFECT = Effect(
    "transmission_curve",
    "jaw",
    "the ratio depends on the jaw's angle: the wire pulls at a lever or an uneven pulley",
    "r_j(θ_j) = r_j (1 + E_c cos θ_j + E_s sin θ_j)",
    (
        Parameter("sine", "", -0.5, 0.5, 0.0, 0.01, "amplitude of the sine", plausible=0.3),
        Parameter("cosine", "", -0.5, 0.5, 0.0, 0.01, "amplitude of the cosine", plausible=0.3),
    ),
    "lever arm l cos(θ − φ) of a wire at a lever; mounting error of a pulley",
    "a jaw sensor, motion over its range, several loads",
    by_angle=True,
    changes="wire",
)


def paid_m(sine: float, cosine: float, r_j: float, theta_j_rad: float) -> float:
    """Return the wire that the jaw takes beyond r_j θ_j from angle 0 on: the integral of `lever_m`."""
    if cosine == 0.0 and sine == 0.0:
        return 0.0
    return r_j * (cosine * math.sin(theta_j_rad) + sine * (1.0 - math.cos(theta_j_rad)))


def lever_m(sine: float, cosine: float, r_j: float, theta_j_rad: float) -> float:
    """Return the deviation from r_j of the lever at which the wire pulls the jaw."""
    if cosine == 0.0 and sine == 0.0:
        return 0.0
    return r_j * (cosine * math.cos(theta_j_rad) + sine * math.sin(theta_j_rad))
