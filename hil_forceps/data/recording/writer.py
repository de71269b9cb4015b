"""Writes a recording: the tick packs its messages into memory, whole chunks go to the file, by a thread in real time.

Every chunk is written whole and handed to the system at once, in real time to the disk itself. A chunk ends when it is
full (`CHUNK_BYTES`, a quarter of a second at 1 kHz) or with the first message that comes `FLUSH_NS` after it began: so
long is what a killed process loses at most, and what lies on a disk that the power leaves is older by no more than the
disk's own writing. `hil_forceps.data.recording.reader` reads what is there.
Where the disk is full, or gone, the recording ends at the last whole chunk, `failure` says why, and what comes later is
dropped: writing never raises into the motor loop. Where the disk is too slow for the thread's bounded queue, whole
chunks are dropped and counted. The same messages give the same bytes, with a thread or without.
"""

import os
import stat
from array import array
from collections import deque
from collections.abc import Mapping
from enum import IntEnum
from pathlib import Path
from typing import IO, Final, NamedTuple

from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.scales import ANGLE_LSB_RAD, BENCH_TORQUE_LSB_N_M, CURRENT_LSB_A
from hil_forceps.data.recording.background import Background
from hil_forceps.data.recording.container import settings_bytes
from hil_forceps.data.recording.format import (
    BENCH,
    CDR_HEAD,
    JSON_TYPE,
    MESSAGE_OPCODE,
    METADATA_NAME,
    REFERENCE,
    RESULT_NAME,
    SAMPLE,
    SETTINGS_NAME,
    TOPICS,
)
from hil_forceps.data.recording.mcap_file import Chunk, McapFile
from hil_forceps.estimation.interface import Estimate, Sample
from hil_forceps.rig.errors import UserError

CHUNK_BYTES: Final = 1 << 16
FLUSH_NS: Final = 500_000_000  # by the messages' own times
RECENT_NS: Final = 2_000_000_000  # the second before a fault, and what follows until the drive is disabled
RECENT_CHUNKS: Final = 128  # of these at most: 8 MiB
QUEUED_CHUNKS: Final = 64  # a disk may stall this long: some 15 s at 1 kHz
CLOSE_TIMEOUT_S: Final = 10.0

_LARGEST: Final = max(topic.record.size for topic in TOPICS)
# Looked up once, for every message.
_SAMPLE_PACK: Final = SAMPLE.record.pack_into
_SAMPLE_SIZE: Final = SAMPLE.record.size
_SAMPLE_LENGTH: Final = SAMPLE.length
_REFERENCE_PACK: Final = REFERENCE.record.pack_into
_REFERENCE_SIZE: Final = REFERENCE.record.size
_REFERENCE_LENGTH: Final = REFERENCE.length
_BENCH_PACK: Final = BENCH.record.pack_into
_BENCH_SIZE: Final = BENCH.record.size
_BENCH_LENGTH: Final = BENCH.length


class Reference(NamedTuple):
    """What one tick made of the newest sample; `reference_raw` is None when nothing may leave."""

    tick_ns: int  # host's clock
    stamp_ns: int  # drive's clock: the sample it was computed from
    trajectory_ns: int  # since the zero of the experiment; negative before it
    reference_raw: int | None  # wire unit, unwrapped
    theta_j_ref_rad: float
    elongation_used_m: float
    requested_rad: float
    passed_rad: float  # NaN when the gate passed nothing
    verdict: int
    sample_sequence: int


class Outcome(IntEnum):
    """What became of a reference after the pipeline."""

    NONE = 0  # there was none to send
    SENT = 1
    QUEUE_FULL = 2
    BUS_DOWN = 3
    NOT_ALLOWED = 4  # the drive is not in a state to take references


class RecordingReport(NamedTuple):
    """What became of a recording."""

    messages: int  # handed in
    dropped: int  # of these not in the file: queue full, or after a failure
    file_bytes: int  # 0 when unknown
    failure: str  # empty when all went well


class Recorder:
    """Takes samples, ticks and bench values; never blocks and never raises for what the disk does.

    `threaded` moves compressing and writing off the caller's thread, for real time; without it they happen in the
    call.
    """

    def __init__(self, stream: IO[bytes], metadata: Mapping[str, str], threaded: bool) -> None:
        """Start on an unbuffered binary stream that is then the recorder's own to close."""
        self.failure = ""
        self._stream = stream
        self._file = McapFile(stream, TOPICS)
        self._buffer = bytearray(CHUNK_BYTES)
        self._limit = CHUNK_BYTES - _LARGEST
        self._offset = 0
        self._indexes: list[list[int]] = [[] for _ in TOPICS]  # of each topic: log time and offset by turns
        self._counts = [0, 0, 0]
        self._overflowed = 0  # the tick's own count; what the thread could not write is counted by the thread
        self._unwritten = 0
        self._closed = False
        self._began_ns = 0  # of the chunk in the making
        self._due_ns = -1  # a message later than this begins another chunk
        self._recent: deque[tuple[int, bytes]] = deque(maxlen=RECENT_CHUNKS)  # begin and messages of each
        self._synced = _file_number(stream) if threaded else None
        self._guarded_head(metadata)
        self._background = Background(self._write, threaded, QUEUED_CHUNKS, "recording")

    def sample(self, raw: RawSample, sample: Sample, estimate: Estimate) -> None:
        """Record one sample, raw and in SI, with what the estimator made of it."""
        sequence, stamp_ns, theta_m, current, state, fault, setpoint_sequence, received_ns = raw
        offset, count = self._offset, self._counts[0]
        if offset > self._limit or received_ns > self._due_ns:
            offset = self._begin_chunk(received_ns)
        _SAMPLE_PACK(
            self._buffer, offset, MESSAGE_OPCODE, _SAMPLE_LENGTH, 1, count, received_ns, received_ns, CDR_HEAD,
            stamp_ns, received_ns, theta_m, sample[1], current * CURRENT_LSB_A, sample[2], *estimate,
            current, sequence, setpoint_sequence, state, fault,
        )  # fmt: skip
        self._indexes[0] += (received_ns, offset)
        self._counts[0] = count + 1
        self._offset = offset + _SAMPLE_SIZE

    def reference(self, reference: Reference, sent_ns: int, outcome: int, setpoint_sequence: int) -> None:
        """Record one tick, whatever came of it."""
        tick_ns, stamp_ns, trajectory_ns, raw, theta_j_ref, elongation, requested, passed, verdict, sample = reference
        offset, count = self._offset, self._counts[1]
        if offset > self._limit or tick_ns > self._due_ns:
            offset = self._begin_chunk(tick_ns)
        _REFERENCE_PACK(
            self._buffer, offset, MESSAGE_OPCODE, _REFERENCE_LENGTH, 2, count, tick_ns, tick_ns, CDR_HEAD,
            tick_ns, sent_ns, stamp_ns, trajectory_ns, raw or 0, theta_j_ref, elongation, requested, passed,
            verdict, outcome, sample, setpoint_sequence,
        )  # fmt: skip
        self._indexes[1] += (tick_ns, offset)
        self._counts[1] = count + 1
        self._offset = offset + _REFERENCE_SIZE

    def bench(self, raw: RawBench) -> None:
        """Record one pair of bench values, raw and in SI."""
        sequence, theta_j, tau_w, received_ns = raw
        offset, count = self._offset, self._counts[2]
        if offset > self._limit:  # they come with samples, which look at the time
            offset = self._begin_chunk(received_ns)
        _BENCH_PACK(
            self._buffer, offset, MESSAGE_OPCODE, _BENCH_LENGTH, 3, count, received_ns, received_ns, CDR_HEAD,
            received_ns, theta_j * ANGLE_LSB_RAD, tau_w * BENCH_TORQUE_LSB_N_M, theta_j, tau_w, sequence,
        )  # fmt: skip
        self._indexes[2] += (received_ns, offset)
        self._counts[2] = count + 1
        self._offset = offset + _BENCH_SIZE

    def recent(self) -> list[bytes]:
        """Return the messages of the last `RECENT_NS` and some before them, chunk by chunk."""
        return [records for _, records in self._recent] + [bytes(self._buffer[: self._offset])]

    def close(self, result: Mapping[str, str], attachments: Mapping[str, bytes] | None = None) -> RecordingReport:
        """Write what is left, attachments (JSON), how the run ended, and the summary; bounded in time; once."""
        if self._closed:
            raise ValueError("the recording is closed already")
        self._closed = True
        self._hand_over(CLOSE_TIMEOUT_S)
        if not self._background.close(CLOSE_TIMEOUT_S):  # the thread still holds the file: leave it alone
            failure = self.failure or f"the disk did not take the recording within {CLOSE_TIMEOUT_S:g} s"
            return RecordingReport(sum(self._counts), self._overflowed + self._unwritten, 0, failure)
        if not self.failure:
            self._guarded_tail(result, attachments or {})
        self._stream.close()
        dropped = self._overflowed + self._unwritten
        return RecordingReport(sum(self._counts), dropped, self._file.good_bytes, self.failure)

    def _begin_chunk(self, now_ns: int) -> int:
        """Hand over the chunk in the making; return where the next message goes."""
        self._hand_over()
        self._began_ns = now_ns
        self._due_ns = now_ns + FLUSH_NS
        return 0

    def _keep(self, records: bytes) -> None:
        recent = self._recent
        recent.append((self._began_ns, records))
        while len(recent) > 1 and recent[1][0] <= self._began_ns - RECENT_NS:
            recent.popleft()

    def _hand_over(self, timeout_s: float = 0.0) -> None:
        if not self._offset:
            return
        with memoryview(self._buffer) as view:
            records = bytes(view[: self._offset])
        indexes = {topic.channel: array("Q", index) for topic, index in zip(TOPICS, self._indexes, strict=True)}
        chunk = Chunk(records, indexes)
        self._keep(records)
        self._offset = 0
        for index in self._indexes:
            index.clear()
        if not self._background.put(chunk, timeout_s):
            self._overflowed += chunk.messages

    def _write(self, chunk: Chunk) -> None:
        if self.failure:
            self._unwritten += chunk.messages
            return
        try:
            self._file.chunk(chunk)
            self._sync()
        except OSError as error:
            self._unwritten += chunk.messages
            self._fail(error)

    def _guarded_head(self, metadata: Mapping[str, str]) -> None:
        try:
            self._file.start()
            self._file.metadata(METADATA_NAME, metadata)
            self._file.attachment(SETTINGS_NAME, JSON_TYPE, settings_bytes(metadata))
        except OSError as error:
            self._fail(error)

    def _guarded_tail(self, result: Mapping[str, str], attachments: Mapping[str, bytes]) -> None:
        try:
            for name, data in attachments.items():
                self._file.attachment(name, JSON_TYPE, data)
            self._file.metadata(RESULT_NAME, result)
            self._file.finish()
            self._sync()
        except OSError as error:
            self._fail(error)

    def _sync(self) -> None:
        """Wait until the disk has it; in real time only, and never in the tick."""
        if self._synced is not None:
            os.fdatasync(self._synced)

    def _fail(self, error: OSError) -> None:
        self.failure = f"recording stopped: {error.strerror or error}"
        try:
            self._file.cut_back()
            self._file.finish()  # cutting freed a little room: enough, mostly, for other tools to open the file too
        except OSError:
            return


def _file_number(stream: IO[bytes]) -> int | None:
    """Return the number of a stream that is a file on a disk, None of any other."""
    try:
        number = stream.fileno()
    except OSError:
        return None
    return number if stat.S_ISREG(os.fstat(number).st_mode) else None


def open_recorder(path: Path, metadata: Mapping[str, str], threaded: bool) -> Recorder:
    """Create the file and start recording; UserError when it can't be created."""
    try:
        stream = path.open("wb", buffering=0)
    except OSError as error:
        raise UserError(f"{path}: can't be written: {error.strerror}; choose another folder") from error
    recorder = Recorder(stream, metadata, threaded)
    if recorder.failure:
        stream.close()
        raise UserError(f"{path}: {recorder.failure}; choose another folder")
    return recorder
