"""Load dependent friction: friction that grows with the tension of the wire (pulleys, guides, sheath)."""

from hil_forceps.effects.entry import Effect, Parameter

# Plausible: steel cables on steel and in sheaths have μ of 0.05 to 0.3, dry ones up to 0.6.
EFFECT = Effect(
    "load_dependent_friction",
    "motor",
    "friction that grows with the tension of the wire (pulleys, guides, sheath)",
    "F_m += μ r_m |f| sgn ω_m",
    (Parameter("mu", "", 0.0, 2.0, 0.0, 0.02, "friction torque over tension times radius, μ", plausible=0.6),),
    "capstan law: L. Euler 1769; Kaneko, Yamashita, Tanie, ICAR 1991 (tendon-sheath)",
    "motion in both directions under different loads",
    changes="friction",
    dry_friction_of="motor",
)


def motor_friction_N_m(mu: float, r_m: float, tension_N: float) -> float:
    """Return the part of the motor's dry friction that the wire's tension causes."""
    return mu * r_m * abs(tension_N)


def motor_friction_at_rest_N_m(mu: float, r_m: float, tension_N: float) -> float:
    """Return the same at standstill."""
    return mu * r_m * abs(tension_N)
