"""Viscous friction of the motor that differs by direction."""


def motor_drag_N_m(difference_N_m_s_per_rad: float, omega_m_rad_per_s: float) -> float:
    """Return what brakes one direction more, as a torque against positive motion."""
    if difference_N_m_s_per_rad * omega_m_rad_per_s > 0.0:
        return abs(difference_N_m_s_per_rad) * omega_m_rad_per_s
    return 0.0
