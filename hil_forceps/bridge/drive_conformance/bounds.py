"""How much is much: bounds that follow from the forceps and from the drive's own resolution."""

import math
from typing import Final, NamedTuple

from firmware_protocol.scales import ANGLE_LSB_PER_REV
from hil_forceps.drives.profile import LOAD_N_M, MAX_QUANTUM_SHARE, Profile
from hil_forceps.rig import Rig
from hil_forceps.rig.sections import Limits, MotorDriver

MAX_STEP_RAD: Final = math.radians(1.0)  # of a reference, from where the motor rests
MIN_STEP_TIME_S: Final = 0.05  # for that way, at the suite's speed
MIN_ACCELERATION_TIME_S: Final = 0.005  # to that speed
MAX_EXCURSION_STEPS: Final = 2.0  # away from where torque was asked for, and torque is taken off at once
MAX_REST_RANGE_QUANTA: Final = 4.0


class Bounds(NamedTuple):
    """Angles of the motor pulley; currents of the motor."""

    quantum_rad: float  # step in which the angle comes
    still_rad: float  # what counts as not moved: a share of the stretch that the load makes, and the quantum twice
    rest_rad: float  # range of the angle that counts as at rest
    no_current_A: float  # what counts as none: the same share of what the load takes
    load_current_A: float
    friction_A: float  # at the suite's speed
    step_rad: float
    guard_rad: float


def bounds_of(rig: Rig, profile: Profile, settings: MotorDriver) -> Bounds:
    """Return the bounds of a rig; UserError where its plant isn't complete."""
    plant = rig.plant()
    counts = rig.encoder.counts_per_rev or ANGLE_LSB_PER_REV
    quantum_rev = 1.0 / counts / abs(settings.encoder_rev_per_pulley_rev)
    coarser = profile.quantum(rig, settings)
    if coarser is not None:
        quantum_rev = max(quantum_rev, coarser.pulley_rev)
    quantum_rad = 2.0 * math.pi * quantum_rev
    stretch_rad = LOAD_N_M / plant.jaw_pulley_radius_m / plant.wire_stiffness_N_per_m / plant.motor_pulley_radius_m
    share_rad = MAX_QUANTUM_SHARE * stretch_rad
    load_A = LOAD_N_M * plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m / plant.torque_constant_N_m_per_A
    friction_N_m = plant.motor_viscous_N_m_s_per_rad * MAX_STEP_RAD / MIN_STEP_TIME_S + plant.motor_coulomb_N_m
    return Bounds(
        quantum_rad=quantum_rad,
        still_rad=share_rad + 2.0 * quantum_rad,
        rest_rad=max(share_rad, MAX_REST_RANGE_QUANTA * quantum_rad),
        no_current_A=MAX_QUANTUM_SHARE * load_A,
        load_current_A=load_A,
        friction_A=friction_N_m / plant.torque_constant_N_m_per_A,
        step_rad=MAX_STEP_RAD,
        guard_rad=MAX_EXCURSION_STEPS * MAX_STEP_RAD,
    )


def narrowed(limits: Limits, home_rad: float) -> Limits:
    """Return the limits of the suite's own gate: one step around `home_rad`, slowly, and never beyond the rig's."""
    speed = min(limits.speed_max_rad_per_s, MAX_STEP_RAD / MIN_STEP_TIME_S)
    return limits.model_copy(
        update={
            "position_min_rad": max(limits.position_min_rad, home_rad - MAX_STEP_RAD),
            "position_max_rad": min(limits.position_max_rad, home_rad + MAX_STEP_RAD),
            "speed_max_rad_per_s": speed,
            "acceleration_max_rad_per_s2": min(limits.acceleration_max_rad_per_s2, speed / MIN_ACCELERATION_TIME_S),
        }
    )
