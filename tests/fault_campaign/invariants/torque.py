"""Torque ends in the published time behind the last fresh reference."""

from collections.abc import Iterator

from hil_forceps.drives.registry import torque_free_within_s
from tests.fault_campaign.excuses import transit_ns
from tests.fault_campaign.invariants.times import MS, newest
from tests.fault_campaign.run import Record


def torque_free_in_time(record: Record) -> Iterator[str]:
    """A drive without fresh references is without torque, or stands where it only brakes, in the published time.

    It counts twice: from what last reached the drive's watchdog, and from the last fresh reference that left, plus the
    longest way of a frame under these faults.
    """
    within_s = torque_free_within_s(record.rig)
    assert within_s is not None
    within_ns = round(within_s * 1e9)
    way_ns = transit_ns(record)
    left = [sent.bus_ns for sent in record.bus.sent if sent.is_fresh]
    for drive in record.drives:
        fed = drive.fed
        for before, moment in zip(drive.forceps.moments, drive.forceps.moments[1:], strict=False):
            at_ns = moment.at_ns
            if moment.reference_rad is None or _stands(record, fed, moment.reference_rad, before.reference_rad, at_ns):
                continue
            fed_ago_ns, left_ago_ns = at_ns - newest(fed, at_ns), at_ns - newest(left, at_ns) - way_ns
            if max(fed_ago_ns, left_ago_ns) > within_ns:
                yield (
                    f"torque {fed_ago_ns / MS:.1f} ms behind what last fed the watchdog, {left_ago_ns / MS:.1f} behind "
                    f"the last reference, {within_ns / MS:g} at most, at {at_ns / MS:.1f} ms"
                )
                break


def _stands(record: Record, fed: list[int], reference_rad: float, before_rad: float | None, at_ns: int) -> bool:
    """Whether a Dynamixel stands: its watchdog leaves torque on (docs/drives/dynamixel.md), as does its enabling."""
    if record.rig.drive_profile != "dynamixel":
        return False
    return reference_rad == before_rad or not newest(fed, at_ns)
