"""What the service hands over: fresh, once, and never what waited."""

from bisect import bisect_right
from collections.abc import Iterator
from itertools import pairwise
from typing import Final

from hil_forceps.data.recording.writer import Outcome
from tests.fault_campaign.excuses import repeat_ns
from tests.fault_campaign.host import Sent
from tests.fault_campaign.invariants.times import MS, newest
from tests.fault_campaign.run import Record
from tests.fault_campaign.schedule import Kind

IN_FLIGHT: Final = 4  # references that may wait before the wire: what a loop sends until it misses its samples
_HANDED: Final = {int(Outcome.SENT), int(Outcome.QUEUE_FULL), int(Outcome.BUS_DOWN)}
# Where frames are held back or doubled on their way, or ticks come late, their pace at the drive says nothing.
_UNEVEN: Final = (
    Kind.DELAY, Kind.REORDER, Kind.DUPLICATE, Kind.STOPPED, Kind.LATE_TICK, Kind.STALLED_ESTIMATOR, Kind.CLOCK_STEP,
)  # fmt: skip


def no_stale_sample(record: Record) -> Iterator[str]:
    """No reference is handed over that comes from a sample older than the rig allows, nor two from one."""
    if record.was_killed or record.crash:
        return
    fresh = [sent for sent in record.bus.sent if sent.is_fresh]
    rows = [(reference, outcome) for reference, _, outcome in record.tap.references if outcome in _HANDED]
    if len(fresh) != len(rows):
        yield f"{len(fresh)} references were handed over, {len(rows)} are told"
        return
    oldest_ns = round(record.rig.limits.max_sample_age_s * 1e9)
    received = {raw.stamp_ns: raw.received_ns for raw in record.tap.samples}
    used: set[int] = set()
    for sent, (reference, outcome) in zip(fresh, rows, strict=True):
        at, stamp_ns = f"at {sent.bus_ns / MS:.1f} ms", reference.stamp_ns
        if stamp_ns in used or stamp_ns not in received:
            yield f"a reference from a sample that {'served before' if stamp_ns in used else 'is not recorded'}, {at}"
            return
        used.add(stamp_ns)
        if sent.is_taken != (outcome == Outcome.SENT):
            yield f"a reference is told as {Outcome(outcome).name}, and wasn't, {at}"
            return
        age_ns = sent.host_ns - received[stamp_ns]
        if age_ns > oldest_ns and not _is_unseen(record, sent, age_ns):
            yield f"a reference from a sample {age_ns / MS:.2f} ms old, {oldest_ns / MS:g} allowed, {at}"
            return


def _is_unseen(record: Record, sent: Sent, age_ns: int) -> bool:
    """Whether nothing on the host can see that age: its clock leapt in it, or it was stopped behind the reading."""
    since_ns = sent.bus_ns - age_ns
    if any(since_ns <= step.begin_ns <= sent.bus_ns for step in record.schedule.of_kind(Kind.CLOCK_STEP)):
        return True
    return any(begin_ns <= sent.bus_ns <= end_ns + MS for begin_ns, end_ns in record.clock.stops)


def no_queued_burst(record: Record) -> Iterator[str]:
    """A tick hands over one reference at most, and what a link refuses is not handed over later."""
    references = [sent for sent in record.bus.sent if sent.is_reference]
    for before, sent in pairwise(references):
        if before.tick == sent.tick:
            yield f"two references in one tick, at {sent.bus_ns / MS:.1f} ms"
            return
    allowed_ns = repeat_ns(record)
    left = [sent.bus_ns for sent in references if sent.is_fresh]
    for sent in references:
        if sent.is_fresh:
            continue
        # A mini cheetah drive's last reference is repeated while its sample is fresh.
        if record.rig.drive_profile != "mit" or sent.bus_ns - newest(left, sent.bus_ns) > allowed_ns:
            yield f"an old reference was handed over once more at {sent.bus_ns / MS:.1f} ms"
            return


def no_burst_at_the_drive(record: Record) -> Iterator[str]:
    """References reach the drive at the loop's pace, whatever waited before."""
    if record.schedule.of_kind(*_UNEVEN):
        return
    window_ns = 10 * record.config.period_ns
    for drive in record.drives:
        came = [arrival.at_ns for arrival in drive.arrivals]
        for place, at_ns in enumerate(came):
            inside = bisect_right(came, at_ns + window_ns) - place
            if inside > 10 + IN_FLIGHT:
                yield f"{inside} references within {window_ns / MS:g} ms from {at_ns / MS:.1f} ms"
                return
