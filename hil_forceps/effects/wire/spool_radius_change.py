"""Spool radius change: the radius grows with the turns wound up."""

import math

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "spool_radius_change",
    "wire",
    "the radius grows with the turns wound up",
    "r(θ_m) = r_m + p θ_m/2π",
    (Parameter("pitch_m_per_turn", "m_per_turn", -5e-3, 5e-3, 0.0, 2e-5, "p"),),
    "wire wound on itself",
    "a jaw sensor, motion over a good part of a turn",
    by_angle=True,
    changes="wire",
)


def wound_m(pitch_m_per_turn: float, theta_p_rad: float) -> float:
    """Return the wire that the growth of the radius winds up from angle 0 on."""
    return pitch_m_per_turn * theta_p_rad * theta_p_rad / (4.0 * math.pi)


def radius_m(pitch_m_per_turn: float, theta_p_rad: float) -> float:
    """Return the growth of the radius."""
    return pitch_m_per_turn * theta_p_rad / (2.0 * math.pi)
