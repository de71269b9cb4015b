"""What the jaw is coupled to at rest."""


def jaw_load_N_m(stiffness_N_m_per_rad: float, torque_N_m: float, theta_j_rad: float) -> float:
    """Return the torque of the spring."""
    return stiffness_N_m_per_rad * theta_j_rad + torque_N_m
