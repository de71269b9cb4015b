"""What the feedback of a rig's motor can be at most: numbers for `feedback`, each from the rig and a bound of physics.

With i the greatest current, the motor's torque is K_t i. A wire that the motor has wound up and that lets go pulls with
as much again, and a swing of it without damping with twice that: three times K_t i in all, the margin below. Where the
rig doesn't say what limits the current, the checks that need it are off (infinite bounds).
"""

import math
from typing import Final, NamedTuple

from hil_forceps.rig import Rig
from hil_forceps.rig.plant import PlantParameters

MAX_TORQUE_RATIO: Final = 3.0  # over K_t i: the motor's, and a wire's that swings without damping
MIN_TRAVEL_COUNTS: Final = 8  # counts that are motion, not the drive's hunting over an edge (one or two)
MIN_TRAVEL_RAD: Final = 0.01  # the service's tolerance of a jaw that "is there"; where an encoder's counts are finer
# Of the greatest current: forceps whose friction or load takes that much can't be worked.
STRONG_CURRENT_SHARE: Final = 0.5
MIN_STILL_TIME_S: Final = 0.1  # as long as a drive's watchdog waits by default for a reference that is late
MAX_FREEZE_S: Final = 0.05  # half of that: a freeze ends before the drive itself or the service would call it silence
WIRE_LSB_RAD: Final = 2.0 * math.pi / (1 << 24)
TOLD_ITS_LIMIT: Final = frozenset({"odrive", "dynamixel", "moteus"})  # what `motor_driver.current_limit_A` is for


class FeedbackBounds(NamedTuple):
    """Bounds of what the motor's angle and current can do."""

    plant: PlantParameters
    jump_speed_rad_per_s: float
    jump_slack_rad: float  # at any interval: counts, and stamps that are off
    still_s: float
    still_travel_rad: float  # of the reference, while the current changes by `strong_A`
    still_travel_alone_rad: float  # of the reference, whatever the current does
    strong_A: float
    against_travel_rad: float
    tension_max_N: float
    current_max_A: float
    hold_s: float  # how long the reference is held before the gate latches


def feedback_bounds(rig: Rig) -> FeedbackBounds:
    """Return the bounds of a rig; UserError where values of its plant aren't known."""
    plant, limits, bench = rig.plant(), rig.limits, rig.bench
    current_A = greatest_current_A(rig)
    counts_rad = MIN_TRAVEL_COUNTS * max(rig.encoder.quantum_rad, WIRE_LSB_RAD)
    travel_rad = max(counts_rad, MIN_TRAVEL_RAD)
    range_rad = limits.position_max_rad - limits.position_min_rad
    speed = _greatest_speed(plant, current_A, range_rad)
    jump_speed = _greatest_speed(plant, MAX_TORQUE_RATIO * current_A, range_rad)
    # Stamps of arrival are off by what a path holds samples back, and older ones are not used.
    stamps_off_rad = 0.0 if rig.drive_profile == "native" else jump_speed * limits.max_sample_age_s
    return FeedbackBounds(
        plant,
        jump_speed,
        counts_rad + stamps_off_rad,
        MIN_STILL_TIME_S + 2.0 * (bench.latency_s + bench.latency_jitter_s),
        travel_rad,
        travel_rad + _full_torque_error(rig, current_A, 0.5 * range_rad),
        STRONG_CURRENT_SHARE * current_A,
        travel_rad + _way_against(plant, current_A, speed),
        math.inf if limits.tension_max_N is None else limits.tension_max_N,
        math.inf if limits.current_max_A is None else limits.current_max_A,
        _hold_s(rig),
    )


def greatest_current_A(rig: Rig) -> float:
    """Return what limits the motor's current; infinite where the rig doesn't say."""
    known = [] if rig.drive is None else [rig.drive.current_limit_A]
    if rig.motor_driver is not None and rig.motor_driver.profile in TOLD_ITS_LIMIT:
        known.append(rig.motor_driver.current_limit_A)
    return max(known, default=math.inf)


def _greatest_speed(plant: PlantParameters, current_A: float, range_rad: float) -> float:
    """Return the lesser of the speed where viscous friction takes all torque, and that after the whole range."""
    torque = plant.torque_constant_N_m_per_A * current_A
    over_range = math.sqrt(2.0 * torque * range_rad / plant.motor_inertia_kg_m2)
    damping = plant.motor_viscous_N_m_s_per_rad
    return min(over_range, torque / damping) if damping > 0.0 else over_range


def _full_torque_error(rig: Rig, current_A: float, at_most_rad: float) -> float:
    """Return how far from its reference a drive gives all its current, by its proportional gain alone."""
    gain = 0.0 if rig.drive is None else rig.drive.kp_A_per_rad
    return min(at_most_rad, current_A / gain) if gain > 0.0 else at_most_rad


def _hold_s(rig: Rig) -> float:
    if rig.motor_driver is None or rig.motor_driver.watchdog_s == 0.0:
        return MAX_FREEZE_S
    return min(MAX_FREEZE_S, 0.5 * rig.motor_driver.watchdog_s)


def _way_against(plant: PlantParameters, current_A: float, speed: float) -> float:
    """Return how far a motor may turn against half of its greatest current: out of full speed, and led by the wire."""
    torque = plant.torque_constant_N_m_per_A * current_A
    if math.isinf(torque):
        return math.inf
    ratio = plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m
    inertia = plant.motor_inertia_kg_m2 + ratio * ratio * plant.jaw_inertia_kg_m2
    braking = 0.5 * inertia * speed * speed / (STRONG_CURRENT_SHARE * torque)
    stiffness = plant.wire_stiffness_N_per_m * plant.motor_pulley_radius_m * plant.motor_pulley_radius_m
    return braking + 2.0 * torque / stiffness  # a swing about the wire's rest at full torque
