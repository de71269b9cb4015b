"""Encoder scale: scale error of the encoder."""

from hil_forceps.effects.entry import Effect, Parameter

# Plausible: the gain of a sound sensor is off by a tenth at most.
EFFECT = Effect(
    "encoder_scale",
    "sensor",
    "scale error of the encoder",
    "θ_enc = (1 + s) θ_m",
    (Parameter("relative_error", "", -0.5, 0.5, 0.0, 2e-3, "s", plausible=0.1),),
    "sensor calibration",
    "a jaw sensor and known radii",
)


def encoder_error_rad(relative_error: float, theta_m_rad: float) -> float:
    """Return the error of the angle that the encoder shows."""
    return relative_error * theta_m_rad
