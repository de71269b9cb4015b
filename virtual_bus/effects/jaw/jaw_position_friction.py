"""Dry friction of the jaw that hangs on its angle."""


def jaw_friction_N_m(slope_N_m_per_rad: float, curvature_N_m_per_rad2: float, theta_j_rad: float) -> float:
    """Return what it is above its constant part."""
    return slope_N_m_per_rad * theta_j_rad + curvature_N_m_per_rad2 * theta_j_rad**2
