"""Reads a recording, whole or cut off anywhere: what was written before the cut comes back, nothing else.

`read_recording` gives the messages as numpy tables and in their order in the file (`Replay` needs that order);
`Recording.to_run` makes the table that estimators offline, the diagnosis and the report take.
"""

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from mcap.records import Chunk as ChunkRecord
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from firmware_protocol.messages import DriveState
from hil_forceps.data.recording.format import (
    BENCH,
    COMPRESSION,
    MESSAGE_ENCODING,
    MESSAGE_HEAD,
    MESSAGE_START,
    METADATA_NAME,
    RECORD_HEAD,
    REFERENCE,
    RESULT_NAME,
    SAMPLE,
    TOPICS,
)
from hil_forceps.data.recording.writer import Outcome
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError

Table = NDArray[np.void]

LARGEST_RECORD = 1 << 28  # a length above this is damage, not data
MAX_FILE_BYTES = 4 << 30
MAX_UNPACKED_BYTES = 2 << 30  # of all chunks: five hours at 1 kHz
BENCH_MATCH_NS = 100_000_000  # sequences repeat after 256 samples: a bench value belongs to a sample this near


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
            raise UserError(f"{self.name}: holds no run: the drive never became operational")
        samples = self.samples[rows]
        if problem := _sample_problem(samples):
            raise UserError(f"{self.name}: {problem}; it is damaged: record again")
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
        """Return, for each sample, the reference last accepted: the latest sent before it with the echoed sequence."""
        sent = self.references[self.references["outcome"] == Outcome.SENT]
        result = np.full(len(samples), np.nan)
        for sequence in np.unique(samples["setpoint_sequence"]):
            own = sent[sent["setpoint_sequence"] == sequence]
            wanted = np.flatnonzero(samples["setpoint_sequence"] == sequence)
            if len(own):
                index = np.searchsorted(own["tick_ns"], samples["received_ns"][wanted], side="right") - 1
                result[wanted[index >= 0]] = own["passed_rad"][index[index >= 0]]
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
        near = np.abs(times[nearest] - received) < BENCH_MATCH_NS
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
        raise UserError(f"{name}: not an MCAP file; a recording of the bench is expected")
    found = _collect(data, name)
    if METADATA_NAME not in found.metadata:
        raise UserError(
            f"{name}: not a recording of the bench, or cut off before it began (no {METADATA_NAME} metadata)"
        )
    return _assemble(found, name)


class _Found(NamedTuple):
    metadata: dict[str, dict[str, str]]
    chunks: list[bytes]
    damage: str  # empty when the file is whole


def _collect(data: bytes, name: str) -> _Found:
    metadata: dict[str, dict[str, str]] = {}
    chunks: list[bytes] = []
    schemas: dict[int, str] = {}
    room = MAX_UNPACKED_BYTES
    end = len(MCAP0_MAGIC)
    for opcode, body, end in _records(data):
        try:
            if opcode == Opcode.METADATA:
                record = Metadata.read(_stream(body))
                metadata[record.name] = record.metadata
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(_stream(body))
                schemas[schema.id] = schema.data.decode()
            elif opcode == Opcode.CHANNEL:
                _check_channel(Channel.read(_stream(body)), schemas, name)
            elif opcode == Opcode.CHUNK:
                chunks.append(_unpacked(ChunkRecord.read(_stream(body)), room))
                room -= len(chunks[-1])
            elif opcode == Opcode.DATA_END:
                return _Found(metadata, chunks, "")
        except (McapError, ValueError, struct.error, zstandard.ZstdError) as error:
            place = f"after {len(chunks)} chunks, in the record that ends at byte {end}"
            return _Found(metadata, chunks, f"damaged {place}: {str(error) or type(error).__name__}")
    return _Found(metadata, chunks, f"cut off or damaged at byte {end} of {len(data)}: it has no end")


def _assemble(found: _Found, name: str) -> Recording:
    bodies: dict[int, list[bytes]] = {topic.channel: [] for topic in TOPICS}
    order: list[int] = []
    gaps = 0
    expected = {topic.channel: 0 for topic in TOPICS}
    sizes = {topic.channel: topic.dtype.itemsize for topic in TOPICS}
    for records in found.chunks:
        for channel, sequence, body in _messages(records):
            if len(body) != sizes.get(channel):
                continue
            gaps += max(sequence - expected[channel], 0)
            expected[channel] = sequence + 1
            bodies[channel].append(body)
            order.append(channel)
    tables = {topic.channel: np.frombuffer(b"".join(bodies[topic.channel]), dtype=topic.dtype) for topic in TOPICS}
    notes = []
    if found.damage:
        notes.append(f"recording is {found.damage}")
    elif RESULT_NAME not in found.metadata:
        notes.append("recording ended before the run did")
    if gaps:
        notes.append(f"{gaps} messages were dropped while recording")
    return Recording(
        name=name,
        metadata=found.metadata[METADATA_NAME],
        result=found.metadata.get(RESULT_NAME, {}),
        samples=tables[SAMPLE.channel],
        references=tables[REFERENCE.channel],
        bench=tables[BENCH.channel],
        order=np.array(order, dtype=np.uint8),
        notes=tuple(notes),
    )


def _records(data: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Yield (opcode, body, end) of every whole record, until the data ends or makes no sense."""
    offset = 0 if not data.startswith(MCAP0_MAGIC) else len(MCAP0_MAGIC)
    while offset + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, offset)
        offset += RECORD_HEAD.size
        if length > LARGEST_RECORD or offset + length > len(data):
            return
        body = data[offset : offset + length]
        offset += length
        yield opcode, body, offset


def _messages(records: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield (channel, sequence, body) of every whole message of a chunk, as `_records` does."""
    offset, end = 0, len(records)
    head, head_size = MESSAGE_START.unpack_from, MESSAGE_HEAD.size
    message = int(Opcode.MESSAGE)
    while offset + head_size <= end:
        opcode, length, channel, sequence = head(records, offset)
        after = offset + RECORD_HEAD.size + length
        if after > end:
            return
        if opcode == message:
            yield channel, sequence, records[offset + head_size : after]
        offset = after


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))


def _unpacked(chunk: ChunkRecord, room: int) -> bytes:
    """Return what a chunk holds; ValueError when it is more than `room`, or not what it says."""
    size = chunk.uncompressed_size
    if size > min(LARGEST_RECORD, room):
        raise ValueError(f"a chunk of {size} bytes, {MAX_UNPACKED_BYTES >> 20} MiB are read of all")
    if chunk.compression == COMPRESSION:
        data = _inflated(chunk.data, size)
    elif not chunk.compression:
        data = chunk.data
    else:
        raise ValueError(f"a chunk packed by {chunk.compression[:20]!r}; recordings of the bench use {COMPRESSION}")
    if len(data) != size:
        raise ValueError(f"a chunk of {len(data)} bytes where it says {size}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("the checksum of a chunk is wrong")
    return data


def _inflated(packed: bytes, size: int) -> bytes:
    """Unpack one frame; the size in its own head is not believed, for memory is asked for by it."""
    if zstandard.frame_content_size(packed) not in {-1, size}:
        raise ValueError("a chunk whose two sizes differ")
    data: bytes = zstandard.decompress(packed, max_output_size=size)
    return data


def _check_channel(channel: Channel, schemas: Mapping[int, str], name: str) -> None:
    for topic in TOPICS:
        if channel.topic != topic.topic:
            continue
        same = channel.id == topic.channel and channel.message_encoding == MESSAGE_ENCODING
        if not same or schemas.get(channel.schema_id) != topic.schema_text():
            raise UserError(f"{name}: {topic.topic} was recorded in another format; use the version that recorded it")
