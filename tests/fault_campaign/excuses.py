"""What a fault makes unavoidable: how far it loosens a bound, and as what it may end a run."""

import math
from typing import Final

from hil_forceps.bench.assembly import MAX_STEP_PERIODS
from hil_forceps.bridge.pipeline import DEFAULT_APPROACH
from hil_forceps.bridge.results import StopReason
from tests.fault_campaign.bus import DELAYED
from tests.fault_campaign.host import STARTED_NS
from tests.fault_campaign.run import Record
from tests.fault_campaign.schedule import Kind, Schedule

# A jump that the motor could have made, or one frozen for less than the gate waits, leads the motor astray inside the
# drive, and nobody can tell.
_IMPLAUSIBLE: Final = (Kind.ENCODER_JUMP, Kind.ENCODER_FREEZE)
ENABLED_NS: Final = 10_000_000  # from the first reference of the trajectory on, until it has reached the drive
RECOVERY_NS: Final = 25_000_000  # 128 x 11 bits, one behind each frame that a host alone on the bus repeats
QUEUED_NS: Final = 5_000_000  # 32 failed transmissions, or a queue full of a flood's frames, before one gets through

_LATE: Final = frozenset(Kind) - {
    Kind.DUPLICATE, Kind.RESET, Kind.CURRENT_STUCK, Kind.FULL_DISK, Kind.KILLED, *_IMPLAUSIBLE,
}  # fmt: skip

R = StopReason
_LOST: Final = {R.NO_DRIVE, R.DRIVE_LOST, R.DRIVE_FAULT, R.DRIVE_STOPPED, R.REFERENCE_DENIED, R.ENABLE_FAILED}
_BAD_FEEDBACK: Final = {R.FEEDBACK_IMPLAUSIBLE}
_SET_UP: Final = {R.VERSION_REFUSED}  # a machine refuses a drive whose answers don't come, or don't fit
REASONS: Final[dict[Kind, set[StopReason]]] = {
    Kind.DROP: _LOST | _SET_UP,
    Kind.DUPLICATE: _LOST | _SET_UP,
    Kind.REORDER: _LOST | _SET_UP,
    Kind.DELAY: _LOST | _SET_UP,
    Kind.CORRUPT_PAYLOAD: _LOST | _SET_UP | _BAD_FEEDBACK,
    Kind.CORRUPT_WIRE: _LOST | _SET_UP | {R.BUS_DOWN},
    Kind.FLOOD: _LOST | _SET_UP,
    Kind.SAME_ID: _LOST | _SET_UP | _BAD_FEEDBACK | {R.BUS_DOWN},
    Kind.BUS_OFF: _LOST | _SET_UP | {R.BUS_DOWN},
    Kind.BUS_GONE: _LOST | _SET_UP | {R.BUS_DOWN},
    Kind.ERROR_PASSIVE: _LOST | _SET_UP | {R.BUS_DOWN},
    Kind.RESET: _LOST | _SET_UP,
    Kind.BROWN_OUT: _LOST | _SET_UP,
    Kind.ENCODER_JUMP: _LOST | _SET_UP | _BAD_FEEDBACK,
    Kind.ENCODER_FREEZE: _LOST | _BAD_FEEDBACK,
    Kind.CURRENT_STUCK: _LOST | _SET_UP | _BAD_FEEDBACK,
    Kind.FULL_QUEUE: _LOST | _SET_UP,
    Kind.FULL_DISK: {R.RECORDING_FAILED},
    Kind.LATE_TICK: _LOST,
    Kind.STALLED_ESTIMATOR: _LOST | _SET_UP,
    Kind.STOPPED: _LOST | _SET_UP,
    Kind.KILLED: set(),
    Kind.CLOCK_STEP: _LOST | _SET_UP,
}


def reasons_of(schedule: Schedule) -> set[StopReason]:
    """Return as what a run may end under these faults."""
    return {R.COMPLETED}.union(*(REASONS[fault.kind] for fault in schedule.faults))


def transit_ns(record: Record) -> int:
    """Return the longest way of a frame from the service to the drive, or back."""
    bench, schedule = record.rig.bench, record.schedule
    way_ns = round((bench.latency_s + bench.latency_jitter_s) * 1e9) + 2 * record.config.period_ns
    way_ns += sum(DELAYED * round(fault.size * 1e9) for fault in schedule.of_kind(Kind.DELAY))
    # While these last, frames wait before the wire; the controller sends them when it can.
    way_ns += sum(
        fault.duration_ns + RECOVERY_NS
        for fault in schedule.of_kind(Kind.FLOOD, Kind.CORRUPT_WIRE, Kind.ERROR_PASSIVE, Kind.BUS_OFF, Kind.REORDER)
    )
    return way_ns


def seen_within_ns(record: Record) -> int:
    """Return how long ago a drive may have measured the angle that it gets back as its first reference."""
    stops_ns = sum(round(fault.size * 1e9) for fault in record.schedule.of_kind(Kind.STOPPED, Kind.LATE_TICK))
    stalls_ns = sum(
        fault.duration_ns + round(fault.size * 1e9) for fault in record.schedule.of_kind(Kind.STALLED_ESTIMATOR)
    )
    age_ns = round(record.rig.limits.max_sample_age_s * 1e9)
    return age_ns + 2 * transit_ns(record) + stops_ns + stalls_ns + 5 * record.config.period_ns


def reference_slack_ns(record: Record) -> int:
    """Return by how much references may come closer together than they were computed."""
    bench, schedule = record.rig.bench, record.schedule
    slack_ns = round(bench.latency_jitter_s * 1e9) + 2 * record.config.period_ns
    slack_ns += sum(DELAYED * round(fault.size * 1e9) for fault in schedule.of_kind(Kind.DELAY))
    if record.rig.drive_profile == "mit":  # a reference is repeated for so long where its answer is missing
        slack_ns += round(record.rig.limits.max_sample_age_s * 1e9)
    if schedule.of_kind(Kind.ERROR_PASSIVE, Kind.CORRUPT_WIRE, Kind.FLOOD, Kind.REORDER):
        slack_ns += QUEUED_NS
    if record.rig.drive_profile == "dynamixel" and schedule.of_kind(Kind.REORDER):
        slack_ns += 2 * QUEUED_NS  # what is held back waits for the next question, behind a missing answer
    return slack_ns


def jump_rad(record: Record, at_ns: int) -> float:
    """Return by how much the angle that a drive's machine holds while it enables may differ from that of its end."""
    follows = [row[0].tick_ns - STARTED_NS for row in record.tap.references if row[0].trajectory_ns >= 0]
    if not follows or at_ns > follows[0] + ENABLED_NS:
        return 0.0
    return sum(abs(fault.size) for fault in record.schedule.of_kind(Kind.ENCODER_JUMP))


def repeat_ns(record: Record) -> int:
    """Return how long behind its first time a mini cheetah drive's reference may be repeated: while it is fresh."""
    back_s = sum(-fault.size for fault in record.schedule.of_kind(Kind.CLOCK_STEP) if fault.size < 0.0)
    return round((record.rig.limits.max_sample_age_s + back_s) * 1e9) + record.config.period_ns


def kick_rad(record: Record, has_led_before: bool) -> float:
    """Return how far from the motor its first reference may be.

    A mini cheetah drive whose answers are missing is let go for some ticks and led on: not to where it is, but to where
    it would be. It lags by kd v / kp and by what the motion makes of a sample's age, and of a late tick.
    """
    settings, limits, schedule = record.rig.motor_driver, record.rig.limits, record.schedule
    if has_led_before and schedule.of_kind(*_IMPLAUSIBLE):
        return math.inf
    if has_led_before and any(fault.size < 0.0 for fault in schedule.of_kind(Kind.CLOCK_STEP)):
        return math.inf  # the host doesn't know of the silence in which the drive let go
    if has_led_before and record.rig.drive_profile == "vesc" and schedule.of_kind(Kind.BUS_OFF, Kind.ERROR_PASSIVE):
        # What waited in a controller that was alone on the bus undoes its timeout, and is let go at the next answer.
        return DEFAULT_APPROACH.tolerance_rad + limits.speed_max_rad_per_s * transit_ns(record) * 1e-9
    if settings is None or settings.profile != "mit" or not has_led_before:
        return DEFAULT_APPROACH.tolerance_rad
    assert settings.kd_N_m_s_per_rad is not None
    assert settings.kp_N_m_per_rad is not None
    lag_s = settings.kd_N_m_s_per_rad / settings.kp_N_m_per_rad + limits.max_sample_age_s
    if schedule.of_kind(*_LATE):
        lag_s += MAX_STEP_PERIODS * record.rig.bench.host_period_s
    return DEFAULT_APPROACH.tolerance_rad + limits.speed_max_rad_per_s * lag_s
