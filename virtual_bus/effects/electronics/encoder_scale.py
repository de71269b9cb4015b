"""An encoder with another scale."""


def encoder_error_rad(relative_error: float, theta_m_rad: float) -> float:
    """Return the error of the angle."""
    return relative_error * theta_m_rad
