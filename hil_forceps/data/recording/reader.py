"""Reads a recording, whole or cut off anywhere: what was written before the cut comes back, nothing else.

`read_recording` gives the messages as numpy tables and in their order in the file (`Replay` needs that order);
`Recording.to_run` makes the table that estimators offline, the diagnosis and the report take.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from firmware_protocol.messages import DriveState
from hil_forceps.data.recording.container import Found, collect, places
from hil_forceps.data.recording.format import (
    BENCH,
    FAULT_NAME,
    MESSAGE_HEAD,
    METADATA_NAME,
    RECOVERY_NAME,
    REFERENCE,
    RESULT_NAME,
    SAMPLE,
    TOPICS,
)
from hil_forceps.data.recording.writer import Outcome
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError

Table = NDArray[np.void]

MAX_FILE_BYTES = 4 << 30
NOTHING_LOST = "[]"  # JSON of what a recovery could not restore
MAX_NOTE_CHARACTERS = 200  # of what a file says of itself
MAX_REFERENCE_AGE_TICKS = 128  # half of what sequences repeat after
MAX_BENCH_OFFSET_NS = 100_000_000  # sequences repeat after 256 samples: a bench value belongs to a sample this near


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What a file holds. `order` lists channel numbers, message by message, as they stand in the file."""

    name: str
    metadata: Mapping[str, str]
    result: Mapping[str, str]  # empty when the run was cut off
    samples: Table
    references: Table
    bench: Table
    order: NDArray[np.uint8]
    notes: tuple[str, ...]
    fault: bytes | None = None  # the last second before a fault, as `fault.json` has it
    is_finished: bool = False  # the file ends as one does that was closed
    gaps: tuple[str, ...] = ()  # what is damaged or missing, those of the notes; empty: all that was recorded is here

    @property
    def zero_ns(self) -> int | None:
        """Drive stamp of the first OPERATIONAL sample, the zero of the experiment; None when it never began."""
        rows = np.flatnonzero(self.samples["state"] == DriveState.OPERATIONAL)
        return int(self.samples["stamp_ns"][rows[0]]) if rows.size else None

    def to_run(self) -> Run:
        """Return the operational part as a table, time from its zero.

        `theta_m_ref_rad` is the reference that the drive was following when it took the sample (it echoes the
        sequence). Bench columns are there where every row has its value. UserError when the drive never became
        operational.
        """
        rows = np.flatnonzero(self.samples["state"] == DriveState.OPERATIONAL)
        if rows.size < 2:
            raise UserError(f"{self.name}: contains no run: the drive never became operational")
        samples = self.samples[rows]
        if problem := _sample_problem(samples):
            raise UserError(f"{self.name}: {problem}; the recording is damaged: record again")
        columns = {
            "time_s": (samples["stamp_ns"] - samples["stamp_ns"][0]) * 1e-9,
            "theta_m_rad": samples["theta_m_rad"],
            "current_A": samples["current_A"],
        }
        notes = list(self.notes)
        reference = self._followed(samples)
        if np.all(np.isfinite(reference)):
            columns["theta_m_ref_rad"] = reference
        else:
            notes.append(f"{np.count_nonzero(~np.isfinite(reference))} samples follow a reference that isn't recorded")
        if len(self.bench):
            index = match_bench(samples, self.bench)
            known = np.isfinite(self.bench["theta_j_rad"]) & np.isfinite(self.bench["tau_w_N_m"])
            if np.all(index >= 0) and np.all(known[index]):
                columns["theta_j_rad"] = self.bench["theta_j_rad"][index]
                columns["tau_w_N_m"] = self.bench["tau_w_N_m"][index]
            else:
                without = np.count_nonzero((index < 0) | ~known[index])
                notes.append(f"{without} samples have no bench values; bench columns left out")
        return Run(self.name, {name: np.asarray(values, float) for name, values in columns.items()}, tuple(notes))

    def _followed(self, samples: Table) -> NDArray[np.float64]:
        """Return, for each sample, the reference last accepted: the latest sent before it with the echoed sequence.

        One from longer ago than half the sequence lasts is taken for another one of that number, which is missing.
        """
        sent = self.references[self.references["outcome"] == Outcome.SENT]
        result = np.full(len(samples), np.nan)
        oldest_ns = MAX_REFERENCE_AGE_TICKS * np.median(np.diff(sent["tick_ns"])) if len(sent) > 1 else np.inf
        for sequence in np.unique(samples["setpoint_sequence"]):
            own = sent[sent["setpoint_sequence"] == sequence]
            wanted = np.flatnonzero(samples["setpoint_sequence"] == sequence)
            if len(own):
                index = np.searchsorted(own["tick_ns"], samples["received_ns"][wanted], side="right") - 1
                known = index >= 0
                known[known] = samples["received_ns"][wanted[known]] - own["tick_ns"][index[known]] <= oldest_ns
                result[wanted[known]] = own["passed_rad"][index[known]]
        return result


def _sample_problem(samples: Table) -> str:
    """Say what a run can't have: only damage that a checksum didn't catch makes it."""
    late = np.flatnonzero(~(np.diff(samples["stamp_ns"].astype(np.float64)) > 0))
    if late.size:
        return f"sample {late[0] + 2} is stamped no later than the one before it"
    for name in ("theta_m_rad", "current_A"):
        bad = np.flatnonzero(~np.isfinite(samples[name]))
        if bad.size:
            return f"sample {bad[0] + 1}: {name} is not a finite number"
    return ""


def match_bench(samples: Table, bench: Table) -> NDArray[np.int64]:
    """Return for each sample the row of `bench` taken at the same instant, -1 where there is none."""
    result = np.full(len(samples), -1, dtype=np.int64)
    for sequence in np.unique(samples["sequence"]):
        wanted = np.flatnonzero(samples["sequence"] == sequence)
        own = np.flatnonzero(bench["sequence"] == sequence)
        if not own.size:
            continue
        times, received = bench["received_ns"][own], samples["received_ns"][wanted]
        after = np.clip(np.searchsorted(times, received), 0, own.size - 1)
        before = np.clip(after - 1, 0, own.size - 1)
        nearest = np.where(np.abs(times[before] - received) <= np.abs(times[after] - received), before, after)
        near = np.abs(times[nearest] - received) < MAX_BENCH_OFFSET_NS
        result[wanted[near]] = own[nearest[near]]
    return result


def read_recording(path: Path) -> Recording:
    """Read one file; UserError when it can't be opened or isn't a recording of the bench."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise UserError(f"{path}: larger than {MAX_FILE_BYTES >> 30} GiB; cut it (mcap filter)")
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: can't be read: {error.strerror}") from error
    return parse_recording(data, str(path))


def parse_recording(data: bytes, name: str) -> Recording:
    """Read a file's bytes; what a cut or damage makes unreadable is left out and said in the notes."""
    if not data.startswith(MCAP0_MAGIC):
        raise UserError(f"{name}: not an MCAP file; name a recording of `run` or `bench`")
    found = collect(data, name)
    if METADATA_NAME not in found.metadata:
        raise UserError(
            f"{name}: not a recording of `run` or `bench`, or cut off at its beginning (no {METADATA_NAME} metadata)"
        )
    return _assemble(found, name, is_finished=data.endswith(MCAP0_MAGIC) and len(data) > len(MCAP0_MAGIC))


class Tables(NamedTuple):
    """Messages as tables. `order` lists their channels, `missing` counts what their numbers show to be absent."""

    samples: Table
    references: Table
    bench: Table
    order: NDArray[np.uint8]
    missing: int


def tables_of(chunks: Iterable[bytes], *, first_counts: bool = True) -> Tables:
    """Return the messages of chunks as tables; `first_counts`: numbers begin at 0, so that what precedes is missing."""
    bodies: dict[int, list[bytes]] = {topic.channel: [] for topic in TOPICS}
    order: list[int] = []
    missing = 0
    expected: dict[int, int] = {topic.channel: 0 for topic in TOPICS} if first_counts else {}
    sizes, head_size = {topic.channel: topic.record.size for topic in TOPICS}, MESSAGE_HEAD.size
    for chunk in chunks:
        for channel, sequence, begin, end in places(chunk):
            if end - begin != sizes.get(channel):
                continue
            missing += max(sequence - expected.get(channel, sequence), 0)
            expected[channel] = sequence + 1
            bodies[channel].append(chunk[begin + head_size : end])
            order.append(channel)
    samples, references, bench = (
        np.frombuffer(b"".join(bodies[topic.channel]), dtype=topic.dtype) for topic in (SAMPLE, REFERENCE, BENCH)
    )
    return Tables(samples, references, bench, np.array(order, dtype=np.uint8), missing)


def _assemble(found: Found, name: str, *, is_finished: bool) -> Recording:
    tables = tables_of(found.chunks)
    said = list(_said(found, tables))
    return Recording(
        name=name,
        metadata=found.metadata[METADATA_NAME],
        result=found.metadata.get(RESULT_NAME, {}),
        samples=tables.samples,
        references=tables.references,
        bench=tables.bench,
        order=tables.order,
        notes=tuple(text for text, _ in said),
        fault=found.attachments.get(FAULT_NAME),
        is_finished=is_finished,
        gaps=tuple(text for text, is_gap in said if is_gap),
    )


def _said(found: Found, tables: Tables) -> Iterator[tuple[str, bool]]:
    """Yield what a reader should know, each with whether something is damaged or missing."""
    if found.damage:
        yield f"recording is {found.damage}", True
    elif RESULT_NAME not in found.metadata:
        yield "recording ended before the run did", True
    for remark in found.remarks:
        yield remark, True
    if RECOVERY_NAME in found.metadata:
        said = found.metadata[RECOVERY_NAME]
        summary = said.get("summary", "")
        yield (
            f"recording was recovered: {summary if summary.isprintable() else ''}"[:MAX_NOTE_CHARACTERS],
            said.get("lost") != NOTHING_LOST,
        )
    elif tables.missing:
        is_damaged = found.damage or found.remarks
        yield f"{tables.missing} messages {'are missing' if is_damaged else 'were dropped while recording'}", True
    if found.counted is not None and found.counted > len(tables.order) and not found.damage:
        yield f"{found.counted - len(tables.order)} messages that its summary counts are missing", True
