"""Jaw viscous friction: viscous friction at the jaw: its bearing, guides and seals."""

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "jaw_viscous_friction",
    "jaw",
    "viscous friction at the jaw: its bearing, guides and seals",
    "F_j += D_j ω_j",
    (Parameter("viscosity_N_m_s_per_rad", "N_m_s_per_rad", 0.0, 10.0, 0.0, 1e-5, "viscous friction of the jaw, D_j"),),
    "joint damping of every multibody program; Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, 2006",
    "fast motion of the jaw and a jaw sensor; a motor's viscous friction does not stretch the wire",
)
