"""Jaw position friction: friction of the jaw depends on its angle."""

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "jaw_position_friction",
    "jaw",
    "friction of the jaw depends on its angle",
    "F_j level = max(0, τ_Fj + b θ_j + q θ_j²)",
    (
        Parameter("slope_N_m_per_rad", "N_m_per_rad", -0.1, 0.1, 0.0, 1e-5, "b"),
        Parameter("curvature_N_m_per_rad2", "N_m_per_rad2", -0.1, 0.1, 0.0, 1e-5, "q"),
    ),
    "Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, position-dependent friction",
    "motion of the jaw over its range, both directions",
    by_angle=True,
    changes="friction",
    dry_friction_of="jaw",
)


def jaw_friction_N_m(slope_N_m_per_rad: float, curvature_N_m_per_rad2: float, theta_j_rad: float) -> float:
    """Return the part of the jaw's dry friction that depends on its angle; may be negative."""
    return (slope_N_m_per_rad + curvature_N_m_per_rad2 * theta_j_rad) * theta_j_rad
