"""The position loop of the drive, as a start for the simulated one; and the step of the simulated plant."""

import math
from collections.abc import Iterator, Mapping
from typing import Final

from hil_forceps.rig.first_rig.answers import Answers

# Of the loop: a fifth of the paper's wire (1990 rad/s), which is stiff for it then, and that of its examples' loop.
LOOP_OMEGA_RAD_PER_S: Final = 400.0
INTEGRAL_SHARE: Final = 0.1  # of that rate, for the integral part: it moves no pole of the loop by much
FILTER_RATIO: Final = 10.0  # of the derivative's corner over that rate, likewise
STEPS_S: Final = (5e-5, 2.5e-5, 2e-5, 1e-5, 5e-6, 2.5e-6, 2e-6, 1e-6)  # that divide 0.1 ms, coarsest first


def inertia_at_pulley(plant: Mapping[str, float], radii: float) -> float | None:
    """Return the inertia that the motor moves, with the jaw's where it is known; None without the motor's own."""
    own = plant.get("motor_inertia_kg_m2")
    return None if own is None else own + radii**2 * plant.get("jaw_inertia_kg_m2", 0.0)


def loop_entries(
    answers: Answers, inertia_kg_m2: float, current_limit_A: float, limit_source: str
) -> Iterator[tuple[str, float, str]]:
    """Yield the keys of `drive:`: poles at LOOP_OMEGA_RAD_PER_S, critically damped, of the inertia alone."""
    whose = "what your firmware has" if answers.profile == "native" else "only the simulated drive has these gains"
    kp = inertia_kg_m2 * LOOP_OMEGA_RAD_PER_S**2 / answers.torque_constant_N_m_per_A
    sample = answers.drive.drive["sample_time_s"]
    yield "sample_time_s", float(sample.value), sample.source
    yield "kp_A_per_rad", kp, f"I w^2 / K_t with w = {LOOP_OMEGA_RAD_PER_S:g} rad/s, as a start; {whose}"
    yield "ki_A_per_rad_s", INTEGRAL_SHARE * kp * LOOP_OMEGA_RAD_PER_S, "kp w / 10, as a start"
    yield "kd_A_s_per_rad", 2.0 * kp / LOOP_OMEGA_RAD_PER_S, "2 kp / w: critically damped, as a start"
    yield "derivative_cutoff_Hz", FILTER_RATIO * LOOP_OMEGA_RAD_PER_S / (2.0 * math.pi), "ten times w"
    yield "current_limit_A", current_limit_A, limit_source


def plant_step_s(plant: Mapping[str, float]) -> float | None:
    """Return the coarsest step that is half of the fastest rate's time at most; None where that isn't known."""
    try:
        motor = plant["motor_pulley_radius_m"] ** 2 / plant["motor_inertia_kg_m2"]
        jaw = plant["jaw_pulley_radius_m"] ** 2 / plant["jaw_inertia_kg_m2"]
        wire = math.sqrt(plant["wire_stiffness_N_per_m"] * (motor + jaw))
        friction = plant["motor_viscous_N_m_s_per_rad"] / plant["motor_inertia_kg_m2"]
    except KeyError:
        return None
    rate = max(wire, friction)
    return next((step for step in STEPS_S if step * rate <= 0.5), STEPS_S[-1])
