"""Recordings made in memory, of messages that are known."""

import errno
import io
import math

from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.messages import DriveState
from hil_forceps.data.recording.reader import Recording
from hil_forceps.data.recording.writer import Outcome, Recorder, RecordingReport, Reference
from hil_forceps.estimation.interface import Estimate, Sample

MS = 1_000_000
METADATA = {"algorithm": "kalman", "rig": "forceps:\n  motor: {µ: 1}\n"}
RESULT = {"reason": "completed"}


class Memory(io.BytesIO):
    """A file that can still be looked at when it is closed, and that may fill up."""

    def __init__(self, room: int | None = None) -> None:
        super().__init__()
        self.room = room
        self.kept = b""

    def write(self, data: object) -> int:
        view = memoryview(data)  # type: ignore[arg-type]
        if self.room is not None and self.tell() + len(view) > self.room:
            part = max(0, self.room - self.tell())
            super().write(view[:part])
            if part:
                return part
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(view)

    def close(self) -> None:
        self.kept = self.getvalue()
        super().close()


def fill(recorder: Recorder, ticks: int, first: int = 0) -> None:
    for k in range(first, first + ticks):
        now = k * MS
        state = DriveState.OPERATIONAL if k >= 3 else DriveState.ARMED
        raw = RawSample(k % 256, now, 1000 + k, -5, state, 0, max(k - 1, 0) % 256, now + 350_000)
        recorder.sample(raw, Sample(now, 0.1 * k, -1.35e-5), Estimate(1e-3 * math.sin(k), 2e-5))
        recorder.bench(RawBench(k % 256, k, 9, now + 400_000))
        passed = math.nan if k == 2 else 0.25 * k
        reference = Reference(now + 600_000, now, now, None if k == 2 else k, 1.5, 2e-5, 0.25 * k, passed, 16, k % 256)
        recorder.reference(reference, now + 610_000, Outcome.NONE if k == 2 else Outcome.SENT, k % 256)


def record(ticks: int, threaded: bool = False, room: int | None = None) -> tuple[bytes, RecordingReport]:
    file = Memory(room)
    recorder = Recorder(file, METADATA, threaded)
    fill(recorder, ticks)
    report = recorder.close(RESULT)
    return file.kept, report


def messages(recording: Recording) -> tuple[bytes, bytes, bytes, bytes]:
    tables = (recording.samples, recording.references, recording.bench, recording.order)
    return tuple(table.tobytes() for table in tables)  # type: ignore[return-value]


def is_prefix(part: Recording, whole: Recording) -> bool:
    return all(w.startswith(p) for p, w in zip(messages(part), messages(whole), strict=True))
