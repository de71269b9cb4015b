"""The numbers of a forceps with its motor, as kernels take them: plain SI floats."""

from typing import NamedTuple


class PlantParameters(NamedTuple):
    """Table I of the paper; symbols in `docs/` glossary. All SI."""

    motor_pulley_radius_m: float  # r_m
    jaw_pulley_radius_m: float  # r_j
    motor_inertia_kg_m2: float  # I_m
    jaw_inertia_kg_m2: float  # I_j
    motor_viscous_N_m_s_per_rad: float  # D_m
    motor_coulomb_N_m: float  # τ_Fm
    jaw_coulomb_N_m: float  # τ_Fj
    wire_stiffness_N_per_m: float  # k
    torque_constant_N_m_per_A: float  # K_t
