"""Every sample is in the file, or counted, as the public reader tells."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Final

from hil_forceps.data.recording.writer import CHUNK_BYTES
from tests.fault_campaign.run import Record
from tests.fault_campaign.schedule import Kind

SMALLEST_MESSAGE_BYTES: Final = 50  # of a recording: what a chunk can hold at most
# Between whose samples numbers are missing that nobody could count.
_NUMBERS_BREAK: Final = (
    Kind.RESET, Kind.BROWN_OUT, Kind.SAME_ID, Kind.STOPPED, Kind.CLOCK_STEP, Kind.CORRUPT_PAYLOAD,
)  # fmt: skip


def every_sample_is_recorded(record: Record) -> Iterator[str]:
    """Each sample that the drive's machine hands out is in the file, or counted as not increasing or dropped."""
    tap = record.tap
    if not record.crash and not record.was_killed:
        seen = len(tap.samples) + record.counters["pipeline"]["not_increasing"]
        if seen != record.machine_samples:
            yield f"the drive's machine handed out {record.machine_samples} samples, {seen} are recorded or counted"
    stamps = [raw.stamp_ns for raw in tap.samples]
    if any(later <= earlier for earlier, later in pairwise(stamps)):
        yield "stamps of recorded samples don't increase"
    recording = record.recording()
    in_file = [int(stamp) for stamp in recording.samples["stamp_ns"]]
    if in_file != stamps[: len(in_file)]:
        yield "the file's samples are not those that were recorded"
    rows = len(recording.samples) + len(recording.references) + len(recording.bench)
    handed = len(tap.samples) + len(tap.references) + tap.bench_readings
    if record.report is None:
        if handed - rows > CHUNK_BYTES // SMALLEST_MESSAGE_BYTES:
            yield f"{handed - rows} messages were lost with the process, more than a chunk holds"
        return
    if record.report.messages != handed or rows + record.report.dropped != handed:
        yield f"{handed} messages were handed in, {rows} are in the file, {record.report.dropped} counted as dropped"
    if record.report.dropped and not record.report.failure:
        yield "messages were dropped without a word"


def lost_samples_are_counted(record: Record) -> Iterator[str]:
    """What a native drive has numbered and the host never had is counted."""
    if record.rig.drive_profile != "native" or record.schedule.of_kind(*_NUMBERS_BREAK):
        return
    lost = sum((later.sequence - earlier.sequence - 1) & 0xFF for earlier, later in pairwise(record.tap.samples))
    counted = record.counters["machine"]["lost_feedback"] + record.counters["pipeline"]["not_increasing"]
    if lost > counted:
        yield f"{lost} samples are missing between those recorded, {counted} are counted"
