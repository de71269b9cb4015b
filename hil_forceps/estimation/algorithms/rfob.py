"""The reaction force observer: the disturbance torque on an inertia, as applied torque less the torque of its motion.

In the pseudo-integral form the disturbance is g/(s+g) [u + g I ω] − g I ω, where u is all known torque on the inertia
I: no velocity is differentiated. The velocity is the encoder's backward difference. The low-pass is exact for inputs
that are held over the interval, whatever its length.
"""

import math

from hil_forceps.estimation.kernel import kernel, subroutine


@kernel
def sign(velocity: float) -> float:
    """Return −1, 0 or 1, and NaN for NaN."""
    if velocity > 0.0:
        return 1.0
    if velocity < 0.0:
        return -1.0
    return velocity * 0.0


@subroutine
def observe(
    low_pass_N_m: float,
    known_torque_N_m: float,
    velocity_rad_per_s: float,
    inertia_kg_m2: float,
    corner_rad_per_s: float,
    dt_s: float,
) -> tuple[float, float]:
    """Return the low-pass after `dt_s` and the disturbance torque [N m], positive against the motion."""
    momentum = corner_rad_per_s * inertia_kg_m2 * velocity_rad_per_s
    share = -math.expm1(-corner_rad_per_s * dt_s)
    after = low_pass_N_m + share * (known_torque_N_m + momentum - low_pass_N_m)
    return after, after - momentum
