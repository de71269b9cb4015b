"""Viscous asymmetry: viscous friction of the motor differs by direction."""

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "viscous_asymmetry",
    "motor",
    "viscous friction of the motor differs by direction",
    "D += v for ω_m > 0 where v > 0, |v| for ω_m < 0 where v < 0 (both brake)",
    (Parameter("difference_N_m_s_per_rad", "N_m_s_per_rad", -10.0, 10.0, 0.0, 2e-5, "forward less backward, v"),),
    "Armstrong-Hélouvry, Control of Machines with Friction, 1991; Janot, Gautier, Brunot, EMPS, 2019",
    "motion at several speeds in both directions",
    changes="torque",
)


def motor_viscosity_N_m_s_per_rad(difference_N_m_s_per_rad: float) -> float:
    """Return by how much the mean of both directions exceeds D_m."""
    return 0.5 * abs(difference_N_m_s_per_rad)


def motor_drag_N_m(difference_N_m_s_per_rad: float, omega_m_rad_per_s: float) -> float:
    """Return the torque beyond the mean friction of both directions; its sign is the same in both."""
    return 0.5 * difference_N_m_s_per_rad * abs(omega_m_rad_per_s)
