"""Where the drive is led to: within the limits, and from where the motor is."""

import math
from bisect import bisect_right
from collections.abc import Iterator
from typing import Final

from firmware_protocol.scales import ANGLE_LSB_RAD
from hil_forceps.bench.assembly import MAX_GAP_PERIODS, MAX_STEP_PERIODS
from hil_forceps.control.gate import DEFAULT_MAX_GAP_S
from hil_forceps.control.gate.bounds import feedback_bounds
from tests.fault_campaign.drive import FaultyDrive, Moment
from tests.fault_campaign.excuses import (
    jump_rad,
    kick_rad,
    reference_slack_ns,
    seen_within_ns,
)
from tests.fault_campaign.invariants.times import MS, newest
from tests.fault_campaign.rigs import quantum_rad
from tests.fault_campaign.run import Record
from tests.fault_campaign.schedule import Kind

IMPLAUSIBLE_WITHIN_NS: Final = 20_000_000  # three samples, and braking from the highest speed (5 ms)


def limits_at_the_drive(record: Record) -> Iterator[str]:
    """No drive is ever led beyond the limits of position, or faster than that of speed."""
    for drive in record.drives:
        came = [arrival.at_ns for arrival in drive.arrivals]
        before, before_ns = math.nan, 0
        for moment in drive.forceps.moments:
            reference = _commanded(record, moment)
            if reference == before:
                continue
            if not math.isnan(reference) and _is_ours(record, came, moment):
                text = _beyond(record, came, moment.at_ns, before_ns, reference, before)
                if text:
                    yield f"{text} at {moment.at_ns / MS:.1f} ms"
                    break
            before, before_ns = reference, moment.at_ns


def _commanded(record: Record, moment: Moment) -> float:
    """Return what the drive was commanded; NaN without torque."""
    reference, limits = moment.reference_rad, record.rig.limits
    if reference is None:
        return math.nan
    if record.rig.drive_profile == "vesc":  # it goes the shorter way to an angle within one turn
        middle = 0.5 * (limits.position_min_rad + limits.position_max_rad)
        return middle + math.remainder(reference - middle, 2.0 * math.pi)
    return reference


def _is_ours(record: Record, came: list[int], moment: Moment) -> bool:
    """Whether a reference made the drive go elsewhere; a Dynamixel whose watchdog trips stands where it is."""
    newest_ns = newest(came, moment.at_ns)
    if record.rig.drive_profile == "dynamixel":
        return moment.at_ns - newest_ns <= 2 * record.config.period_ns
    return newest_ns > 0


def _beyond(record: Record, came: list[int], at_ns: int, before_ns: int, reference: float, before: float) -> str:
    """Return what is wrong with a reference that came behind another."""
    limits, quantum = record.rig.limits, quantum_rad(record.rig)
    if not limits.position_min_rad - quantum <= reference <= limits.position_max_rad + quantum:
        return f"led to {reference:.4f} rad"
    # A drive that interpolates is on its way for a period.
    spread_ns = record.config.period_ns if record.rig.drive_profile == "cia402" else 0
    last = bisect_right(came, before_ns - spread_ns)
    if math.isnan(before) or not last:
        return ""
    between_ns = newest(came, at_ns) - came[last - 1] + reference_slack_ns(record)
    most = limits.speed_max_rad_per_s * between_ns * 1e-9 + 2.0 * quantum + jump_rad(record, at_ns)
    return f"a step of {reference - before:.4f} rad, {most:.4f} at most," if abs(reference - before) > most else ""


def gate_limits_as_sent(record: Record) -> Iterator[str]:
    """What the gate passes in ticks one after the other keeps speed and acceleration, and it closes behind a gap."""
    limits, period_s = record.rig.limits, record.config.period_ns * 1e-9
    gap_s, step_s = max(DEFAULT_MAX_GAP_S, MAX_GAP_PERIODS * period_s), MAX_STEP_PERIODS * period_s
    before: tuple[int, float] | None = None
    speed_before, rounding_before = 0.0, 0.0
    for reference, _, _ in record.tap.references:
        if reference.reference_raw is None:
            continue
        now = (reference.tick_ns, reference.reference_raw * ANGLE_LSB_RAD)
        if before is None or reference.trajectory_ns < 0:  # the measured angle, which the drive's machine holds
            before, speed_before, rounding_before = now, 0.0, 0.0
            continue
        since_s = (now[0] - before[0]) * 1e-9
        dt_s = min(since_s, step_s)  # behind a late tick no more than that is caught up at once
        at = f"at {now[0] / MS:.1f} ms"
        if not 0.0 < since_s <= gap_s:
            yield f"a reference passed {1e3 * since_s:.1f} ms behind the one before, {at}"
            return
        speed, rounding = (now[1] - before[1]) / dt_s, ANGLE_LSB_RAD / dt_s
        if abs(speed) > limits.speed_max_rad_per_s + rounding:
            yield f"speed {speed:.2f} rad/s {at}"
            return
        most = limits.acceleration_max_rad_per_s2 * dt_s + rounding + rounding_before
        if abs(speed - speed_before) > most:
            yield f"speed changed by {speed - speed_before:.3f} rad/s, {most:.3f} at most, {at}"
            return
        before, speed_before, rounding_before = now, speed, rounding


def no_kick(record: Record) -> Iterator[str]:
    """Where a motor gets torque, it is led to where it is, or was when the sample was taken."""
    for drive in record.drives[:1]:
        for place, is_first in _beginnings(drive):
            moments = drive.forceps.moments
            moment = moments[place]
            assert moment.reference_rad is not None
            tolerance = kick_rad(record, not is_first) + 2.0 * quantum_rad(record.rig)
            since_ns = moment.at_ns - seen_within_ns(record)
            lately = (each.sensed_rad for each in reversed(moments[: place + 1]) if each.at_ns >= since_ns)
            if min(abs(moment.reference_rad - sensed) for sensed in lately) > tolerance:
                off = moment.reference_rad - moment.sensed_rad
                yield f"torque began {off:+.4f} rad away from the motor at {moment.at_ns / MS:.1f} ms"
                return


def _beginnings(drive: FaultyDrive) -> Iterator[tuple[int, bool]]:
    """Yield where the drive's torque begins, and whether it is for the first time."""
    moments, is_first = drive.forceps.moments, True
    for place in range(1, len(moments)):
        if moments[place].reference_rad is not None and moments[place - 1].reference_rad is None:
            yield place, is_first
            is_first = False


def implausible_feedback_stops(record: Record) -> Iterator[str]:
    """Behind a jump that no motor makes the reference stands still, or torque is gone, in time and for good."""
    bounds, period_ns = feedback_bounds(record.rig), record.config.period_ns
    furthest = bounds.jump_slack_rad + bounds.jump_speed_rad_per_s * 3.0 * period_ns * 1e-9
    for fault in record.schedule.of_kind(Kind.ENCODER_JUMP):
        if abs(fault.size) <= furthest or len(record.schedule.faults) > 1 or fault.duration_ns <= 3 * period_ns:
            continue  # and among other faults samples may be missing, between which it may turn further
        moments = record.drives[0].forceps.moments
        late = [m.reference_rad for m in moments if m.at_ns >= fault.begin_ns + IMPLAUSIBLE_WITHIN_NS]
        led = [m.reference_rad for m in moments if m.reference_rad is not None and m.at_ns <= fault.begin_ns]
        if len(led) > 1 and len(set(late) - {None}) > 1:
            yield f"the motor is still led on {IMPLAUSIBLE_WITHIN_NS / MS:g} ms behind a jump of {fault.size:g} rad"
            return
