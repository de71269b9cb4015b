"""What is known when a first rig is written."""

import math
from dataclasses import dataclass

from hil_forceps.rig.errors import UserError
from hil_forceps.rig.presets import DrivePreset, Fact, MotorPreset, MotorValues


@dataclass(frozen=True, slots=True)
class Answers:
    """Motor, drive, encoder and pulleys, and what else was given. None: not known."""

    motor: MotorPreset
    profile: str
    drive: DrivePreset
    motor_pulley_radius_m: float
    jaw_pulley_radius_m: float
    encoder_counts: Fact
    current_limit_A: Fact
    gear: float = 1.0  # turns of the motor for one of the pulley; negative: the other way round
    node_id: int | None = None
    wire_stiffness_N_per_m: float | None = None
    jaw_inertia_kg_m2: float | None = None
    jaw_coulomb_N_m: float | None = None
    tension_max_N: float | None = None
    jaw_min_rad: float = 0.0
    jaw_max_rad: float = math.pi / 2
    assume: bool = False  # the paper's values, or the middle of the bounds, for what nobody knows yet

    @property
    def radii(self) -> float:
        """Return r_m / r_j."""
        return self.motor_pulley_radius_m / self.jaw_pulley_radius_m

    @property
    def torque_constant_N_m_per_A(self) -> float:
        """Return the torque on the pulley per ampere."""
        return float(self.motor.values.torque_constant_N_m_per_A.value) * abs(self.gear)


def own_motor(torque_constant_N_m_per_A: float, inertia_kg_m2: float | None) -> MotorPreset:
    """Return a motor that no preset has."""
    inertia = None if inertia_kg_m2 is None else Fact(value=inertia_kg_m2, source="given with --motor-inertia")
    constant = Fact(value=torque_constant_N_m_per_A, source="given with --torque-constant")
    values = MotorValues(torque_constant_N_m_per_A=constant, inertia_kg_m2=inertia)
    return MotorPreset(title="a motor that no preset has", source="the options of `hil-forceps init`", values=values)


def check_pair(motor_name: str, motor: MotorPreset, profile: str) -> None:
    """UserError where an actuator with a drive inside is given another."""
    if motor.drive is not None and motor.drive != profile:
        raise UserError(
            f"--drive {profile}: {motor.title} contains a drive with the profile {motor.drive}; use --drive "
            f"{motor.drive}, or a motor other than {motor_name}"
        )
