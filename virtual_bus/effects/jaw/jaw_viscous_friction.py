"""Viscous friction at the jaw."""


def jaw_load_N_m(viscosity_N_m_s_per_rad: float, omega_j_rad_per_s: float) -> float:
    """Return the torque against the motion."""
    return viscosity_N_m_s_per_rad * omega_j_rad_per_s
