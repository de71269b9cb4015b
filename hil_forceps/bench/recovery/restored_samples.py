"""Samples that a bus log contains and a recording lacks.

The log of the project's own protocol has every sample as it was measured, to the last bit; only its arrival is rounded
to the log's microsecond. Estimates are computed again from the samples, as long as no earlier sample is missing.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from firmware_protocol.host.samples import RawSample
from firmware_protocol.scales import ANGLE_LSB_RAD, ANGLE_MODULUS, CURRENT_LSB_A
from hil_forceps.bench.assembly import make_pipeline, settings_of
from hil_forceps.bridge.pipeline import Pipeline
from hil_forceps.bridge.replay import RecordedReference
from hil_forceps.bridge.statistics import STAMP_PERIOD_NS
from hil_forceps.data.readers.bus_logs.run import HeardDrive, heard_drives
from hil_forceps.data.recording.format import CDR_HEAD, MESSAGE_OPCODE, SAMPLE
from hil_forceps.data.recording.reader import Recording, Table
from hil_forceps.data.recording.salvage import Gap, Message
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

_RAW = ["sequence", "stamp_ns", "theta_m_raw", "current_raw", "state", "fault", "setpoint_sequence", "received_ns"]


class FromLog(NamedTuple):
    """Data from a log. `holds` is empty if none could be used; `notes` say why."""

    gaps: list[Gap]  # that it fills, or the ends of gaps
    messages: list[Message]
    holds: str = ""
    references: int = 0  # sent, by the log
    notes: tuple[str, ...] = ()


def samples_of_log(path: Path, recording: Recording, missing: Sequence[Gap], *, has_end: bool) -> FromLog:
    """Return the samples that a recording lacks, and the remaining gaps; `has_end`: the recording has its end."""
    nothing = FromLog([], [])
    samples = recording.samples
    try:
        rig, settings = settings_of(recording)
        if rig.drive_profile != "native":
            told = f"samples of a drive with the profile {rig.drive_profile} can't be restored from it"
            return nothing._replace(notes=(f"{path.name}: {told}; hil-forceps decode shows its frames",))
        drives, remarks = heard_drives(path, rig.bench.node_id)
    except UserError as error:
        return nothing._replace(notes=(f"{path.name} was not used: {error}",))
    notes = tuple(f"{path.name}: {remark}" for remark in remarks)
    aligned = _aligned(drives, samples)
    if aligned is None:
        return nothing._replace(
            notes=(*notes, f"{path.name} was not used: it has no sample in common with the recording")
        )
    heard, references = aligned
    wanted = list(_wanted(heard, samples, missing, has_end))
    filled = [gap for gap, _ in wanted]
    is_complete = not any(gap.channel == SAMPLE.channel for gap in still_missing(missing, filled))
    pipeline = make_pipeline(rig, settings, RecordedReference()) if wanted and is_complete else None
    return FromLog(filled, _packed(wanted, samples, pipeline, rig), f"{len(heard)} samples", references, notes)


def still_missing(missing: Sequence[Gap], filled: Sequence[Gap]) -> list[Gap]:
    """Return the gaps without the samples that fill their ends."""
    left = []
    for gap in missing:
        found = next((each for each in filled if (each.channel, each.last) == (gap.channel, gap.last)), None)
        if found is None:
            left.append(gap)
        elif found.first > gap.first:
            left.append(gap._replace(last=found.first - 1))
    return left


def _aligned(drives: Sequence[HeardDrive], samples: Table) -> tuple[list[RawSample], int] | None:
    """Return the log's samples with the recording's stamps, angles and times; None if they have no sample in common.

    Both unwrap from their first sample, so that they differ by whole ranges; the log's time begins with its first
    sample.
    """
    if not len(samples):
        return (drives[0].samples, drives[0].references) if len(drives) == 1 else None
    first = RawSample(*samples[_RAW][0].tolist())
    for heard, references in drives:
        for each in heard:
            shift = first.stamp_ns - each.stamp_ns
            turn = first.theta_m - each.theta_m
            same = (each.sequence, each.current, each.state) == (first.sequence, first.current, first.state)
            if same and shift % STAMP_PERIOD_NS == 0 and turn % ANGLE_MODULUS == 0:
                begin_ns = first.received_ns - each.received_ns
                return [_shifted(one, shift, turn, begin_ns) for one in heard], references
    return None


def _shifted(raw: RawSample, stamp_ns: int, theta_m: int, received_ns: int) -> RawSample:
    return raw._replace(
        stamp_ns=raw.stamp_ns + stamp_ns, theta_m=raw.theta_m + theta_m, received_ns=raw.received_ns + received_ns
    )


def _wanted(
    heard: Sequence[RawSample], samples: Table, missing: Sequence[Gap], has_end: bool
) -> Iterator[tuple[Gap, list[RawSample]]]:
    """Yield the log's samples for each gap in the recording, at most as many as the sequence numbers allow."""
    recorded = samples["received_ns"]
    for gap in missing:
        if gap.channel != SAMPLE.channel:
            continue
        behind = samples[recorded == gap.before_ns]["stamp_ns"].min()
        ahead = -1 if gap.after_ns is None else samples[recorded == gap.after_ns]["stamp_ns"].max()
        inside = [raw for raw in heard if ahead < raw.stamp_ns < behind][-gap.missing :]
        if inside:
            yield gap._replace(first=gap.last - len(inside) + 1), inside
    if not has_end:
        last_ns = samples["stamp_ns"].max() if len(samples) else -1
        number = len(samples) + sum(gap.missing for gap in missing if gap.channel == SAMPLE.channel)
        inside = [raw for raw in heard if raw.stamp_ns > last_ns]
        if inside:
            after_ns = int(recorded[-1]) if len(samples) else None
            yield Gap(SAMPLE.channel, number, number + len(inside) - 1, after_ns, None), inside


def _packed(
    wanted: Sequence[tuple[Gap, list[RawSample]]], samples: Table, pipeline: Pipeline | None, rig: Rig
) -> list[Message]:
    """Return the samples as messages; `pipeline` computes their estimates, None if a sample before them is missing."""
    numbers = {raw.stamp_ns: gap.first + place for gap, raws in wanted for place, raw in enumerate(raws)}
    restored = [raw for _, raws in wanted for raw in raws]
    recorded = [RawSample(*row) for row in samples[_RAW].tolist()] if pipeline is not None else []
    torque_lsb_N_m = rig.plant().torque_constant_N_m_per_A * CURRENT_LSB_A
    found = []
    for raw in sorted([*recorded, *restored], key=lambda raw: raw.stamp_ns):
        estimate: tuple[float, float] = (math.nan, math.nan)
        if pipeline is not None and pipeline.feed(raw):
            estimate = pipeline.estimate
        if raw.stamp_ns in numbers:
            found.append(_message(raw, numbers[raw.stamp_ns], torque_lsb_N_m, estimate))
    return found


def _message(raw: RawSample, number: int, torque_lsb_N_m: float, estimate: tuple[float, float]) -> Message:
    sequence, stamp_ns, theta_m, current, state, fault, setpoint_sequence, received_ns = raw
    record = SAMPLE.record.pack(
        MESSAGE_OPCODE, SAMPLE.length, SAMPLE.channel, number, received_ns, received_ns, CDR_HEAD,
        stamp_ns, received_ns, theta_m, theta_m * ANGLE_LSB_RAD, current * CURRENT_LSB_A, current * torque_lsb_N_m,
        *estimate, current, sequence, setpoint_sequence, state, fault,
    )  # fmt: skip
    return Message(SAMPLE.channel, number, received_ns, record)
