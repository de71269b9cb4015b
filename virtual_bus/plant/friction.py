"""Friction of the truth plant: torques that oppose a speed."""

import math

from virtual_bus.kernel import kernel

# 1/200 of the motor's speed on the paper's ramp (0.195 rad/s), where the smoothed friction is within 1.3e-5 of its
# full value; at the encoder's resolution of 16384 counts it is one count in 0.4 s, that is, standstill.
SMOOTHING_SPEED_RAD_PER_S = 1.0e-3


@kernel
def coulomb_torque(speed_rad_per_s: float, level_N_m: float, smoothing_rad_per_s: float) -> float:
    """Coulomb friction, smoothed through zero speed: level·ω/√(ω² + ω_s²), N m, of the sign of ω.

    Odd and bounded by the level, so its power is never negative: it can't create energy. Analytic, so that the
    integrator keeps its order; within 12 % of the level at 2 ω_s and 0.5 % at 10 ω_s. ω_s > 0.
    """
    return level_N_m * speed_rad_per_s / math.sqrt(speed_rad_per_s**2 + smoothing_rad_per_s**2)


def smoothing_speed(level_N_m: float, inertia_kg_m2: float, step_s: float) -> float:
    """Return the smoothing speed ω_s (rad/s) for `coulomb_torque` on this inertia with this integration step.

    At standstill smoothed friction acts as a damper with the pole level/(inertia·ω_s); an explicit integrator needs
    that pole times the step to stay near one, so strong friction on a light inertia is smoothed over more.
    """
    return max(SMOOTHING_SPEED_RAD_PER_S, level_N_m * step_s / inertia_kg_m2)
