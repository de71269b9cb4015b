"""Coulomb asymmetry: friction of the motor differs by direction."""

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "coulomb_asymmetry",
    "motor",
    "friction of the motor differs by direction",
    "F_m += a for ω_m > 0 where a > 0, −|a| for ω_m < 0 where a < 0 (both brake)",
    (Parameter("difference_N_m", "N_m", -1.0, 1.0, 0.0, 1e-4, "forward less backward friction, a"),),
    "Armstrong-Hélouvry, Control of Machines with Friction, 1991",
    "motion in both directions",
    dry_friction_of="motor",
)


def forward_friction_N_m(difference_N_m: float) -> float:
    """Return the additional friction at positive speeds of the motor."""
    return max(0.0, difference_N_m)


def backward_friction_N_m(difference_N_m: float) -> float:
    """Return the additional friction at negative speeds of the motor."""
    return max(0.0, -difference_N_m)
