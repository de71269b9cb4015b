"""What a rig says of a mini cheetah drive: ranges of its fields, and the gains that go out with each reference."""

import math
from collections.abc import Iterator, Mapping
from typing import Final

from hil_forceps.rig.first_rig.answers import Answers
from hil_forceps.rig.first_rig.position_loop import LOOP_OMEGA_RAD_PER_S

GAIN_MARGIN: Final = 2.0  # 6 dB, the textbooks' least, between kp and the wire's stiffness at the pulley
RANGE_RATIO: Final = 1.25  # of a range that can be set over what is needed of it
KP_RANGE_RATIO, KD_RANGE_RATIO = 10.0, 50.0  # as configs/drives/mit.yaml has them
MARGIN: Final = "half of the wire's k r_m^2: above that the compensation oscillates"


def own_firmware(
    answers: Answers,
    plant: Mapping[str, float],
    inertia_kg_m2: float,
    current_limit_A: float,
    reach: tuple[float, float],
) -> Iterator[tuple[str, float | int | str, str]]:
    """Yield the keys of `motor_driver:` that a mini cheetah drive needs; all of the drive's own shaft."""
    kp, kd, why = _gains(answers, plant, inertia_kg_m2)
    if answers.motor.motor_driver:
        yield from ((key, fact.value, fact.source) for key, fact in answers.motor.motor_driver.items())
    else:
        yield from _ranges(answers, kp, kd, current_limit_A, reach)
    yield "kp_N_m_per_rad", kp, why
    yield "kd_N_m_s_per_rad", kd, "2 sqrt(kp I): critically damped, as a start"


def _gains(answers: Answers, plant: Mapping[str, float], inertia_kg_m2: float) -> tuple[float, float, str]:
    kp, why = inertia_kg_m2 * LOOP_OMEGA_RAD_PER_S**2, f"I w^2 with w = {LOOP_OMEGA_RAD_PER_S:g} rad/s, as a start"
    stiffness = plant.get("wire_stiffness_N_per_m")
    if stiffness is not None:
        kp, why = min((kp, why), (stiffness * answers.motor_pulley_radius_m**2 / GAIN_MARGIN, MARGIN))
    of_shaft = answers.gear**2
    return kp / of_shaft, 2.0 * math.sqrt(kp * inertia_kg_m2) / of_shaft, why


def _ranges(
    answers: Answers, kp: float, kd: float, current_limit_A: float, reach: tuple[float, float]
) -> Iterator[tuple[str, float | str, str]]:
    of_shaft = abs(answers.gear)
    position = RANGE_RATIO * of_shaft * max(map(abs, reach))
    torque = current_limit_A * answers.torque_constant_N_m_per_A / of_shaft
    yield "mit_variant", "bgkatz", "its firmware on a board of one's own"
    yield "position_range_rad", position, "a quarter more than `limits:` reach to; set P_MAX to it"
    yield "speed_range_rad_per_s", 100.0, "as configs/drives/mit.yaml; set V_MAX to it"
    yield "kp_range_N_m_per_rad", KP_RANGE_RATIO * kp, "ten times kp; set KP_MAX to it"
    yield "kd_range_N_m_s_per_rad", KD_RANGE_RATIO * kd, "fifty times kd; set KD_MAX to it"
    yield "torque_range_N_m", torque, "at the current limit; I_MAX KT GR of the drive has to be it"
