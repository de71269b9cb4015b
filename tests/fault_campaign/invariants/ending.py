"""How a run ends: by itself, for a reason that its faults give, with true words on the drive."""

from collections.abc import Iterator
from typing import Final

from hil_forceps.bridge.results import AS_MEANT, ServiceResult, StopReason
from hil_forceps.data.recording.writer import RecordingReport
from tests.fault_campaign.drive import Moment
from tests.fault_campaign.excuses import reasons_of
from tests.fault_campaign.invariants.times import MS
from tests.fault_campaign.rigs import RUN_NS
from tests.fault_campaign.run import Record
from tests.fault_campaign.schedule import Kind

QUIET_FROM: Final = 0.3  # share of a run, from which on nothing happened that could hold up its end
VESC_QUIET_A: Final = 0.02  # two of its steps: it tells the mean between two answers


def right_end(record: Record) -> Iterator[str]:
    """See this file."""
    if record.crash:
        yield f"crashed: {record.crash}"
    if record.result is None or record.report is None:
        return
    yield from _code(record, record.result, record.report)
    yield from _reason(record, record.result)
    yield from _words_on_the_drive(record, record.result)


def _code(record: Record, result: ServiceResult, report: RecordingReport) -> Iterator[str]:
    """The exit code is 0 where all is well, 2 elsewhere."""
    is_good = result.reason in AS_MEANT and result.drive_disabled and not report.failure and not report.dropped
    if record.exit_code != (0 if is_good else 2):
        yield f"exit code {record.exit_code} after {result.reason.name}, drive_disabled {result.drive_disabled}"
    is_full = record.disk.room is not None and len(record.disk.content) >= record.disk.room
    if is_full and record.exit_code == 0:
        yield "exit code 0 where the disk was full"
    if not record.schedule.faults and record.exit_code != 0:
        yield f"exit code {record.exit_code} without a fault: {result.message}"


def _reason(record: Record, result: ServiceResult) -> Iterator[str]:
    """The reason is one that these faults can give; completed is completed."""
    if result.reason not in reasons_of(record.schedule):
        yield f"ended as {result.reason.name} ({result.message}), which none of its faults explains"
    schedule = record.schedule
    # Of two drives one may be what is talked to. Most stamps are the host's time; and where that is set back the host
    # is silent for so long, in which a mini cheetah drive may be reset that doesn't say so.
    if result.reason is not StopReason.COMPLETED or schedule.of_kind(Kind.SAME_ID, Kind.CLOCK_STEP):
        return
    stopped_ns = sum(round(fault.size * 1e9) for fault in schedule.of_kind(Kind.STOPPED))
    driven = [moment.at_ns for moment in record.drives[0].forceps.moments if moment.reference_rad is not None]
    if not driven or driven[-1] - driven[0] < RUN_NS - 20 * MS - stopped_ns:
        yield "completed before its time"


def _words_on_the_drive(record: Record, result: ServiceResult) -> Iterator[str]:
    """That the drive is disabled is true; and it is said where nothing disturbed it."""
    faults = record.schedule.faults
    is_quiet = all(fault.end_ns < QUIET_FROM * record.ended_ns for fault in faults)
    if is_quiet and result.reason is StopReason.COMPLETED and not result.drive_disabled:
        yield f"the drive did not confirm that it is disabled, and nothing disturbed it: {result.message}"
    if not result.drive_disabled or record.schedule.of_kind(Kind.SAME_ID):  # of two, one may be what is talked to
        return
    pulls = [moment.at_ns for moment in record.drives[0].forceps.moments if _pulls(record, moment)]
    if pulls and pulls[-1] >= record.ended_ns:
        yield (
            f"says that the drive is disabled; it has torque at {pulls[-1] / MS:.1f} ms, the run ended at "
            f"{record.ended_ns / MS:.1f}"
        )


def _pulls(record: Record, moment: Moment) -> bool:
    """Whether the motor has torque; a VESC's that measures none says the same (docs/drives/vesc.md)."""
    if moment.reference_rad is None:
        return False
    return record.rig.drive_profile != "vesc" or abs(moment.current_A) >= VESC_QUIET_A
