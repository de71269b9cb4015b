"""The raw bus on file, through python-can's own writers: what the host sent and received, as any CAN tool reads it.

Times count from the opening of the log, so a run in virtual time gives the same bytes every time. A frame costs a few
µs to write: frames are collected and written a batch at a time, by a thread in real time (when its queue is full, a
whole batch is dropped and counted). A disk that fails ends the log, never the run: `failure` says why.
"""

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import can
from can.io.generic import MessageWriter

from firmware_protocol.frames import Frame
from hil_forceps.bridge.ports import Clock, Link, SendResult
from hil_forceps.rig.errors import UserError
from hil_forceps.runs.background import Background

BATCH_FRAMES = 256
QUEUED_BATCHES = 64
CLOSE_TIMEOUT_S = 10.0
CHANNEL = "can0"  # what the formats want to call the bus; there is only one
NO_DATE = "Thu Jan  1 00:00:00.000 am 1970"


class _AscWriter(can.ASCWriter):
    """ASC without the hour of the day in its head, which would make no two logs alike."""

    def _format_header_datetime(self, dt: datetime) -> str:  # noqa: ARG002
        return NO_DATE


_WRITERS: Mapping[str, type[MessageWriter]] = {
    ".log": can.CanutilsLogWriter,
    ".asc": _AscWriter,
    ".blf": can.BLFWriter,
}


class LogReport(NamedTuple):
    """What became of a log."""

    frames: int
    dropped: int
    failure: str


class BusLog:
    """Takes frames with the host's time; never blocks and never raises for what the disk does."""

    def __init__(self, writer: MessageWriter, begin_ns: int, threaded: bool) -> None:
        self.failure = ""
        self._writer = writer
        self._begin_ns = begin_ns
        self._batch: list[tuple[int, Frame, bool]] = []
        self._frames = 0
        self._overflowed = 0
        self._unwritten = 0
        self._background = Background(self._write, threaded, QUEUED_BATCHES, "bus log")

    def add(self, time_ns: int, frame: Frame, is_received: bool) -> None:
        """Log one frame."""
        self._batch.append((time_ns, frame, is_received))
        if len(self._batch) >= BATCH_FRAMES:
            self._hand_over()

    def close(self) -> LogReport:
        """Write what is left; bounded in time."""
        self._hand_over()
        if not self._background.close(CLOSE_TIMEOUT_S):
            self.failure = self.failure or f"bus log: the disk did not take it within {CLOSE_TIMEOUT_S:g} s"
        else:
            try:
                self._writer.stop()
            except OSError as error:
                self._fail(error)
        return LogReport(self._frames, self._overflowed + self._unwritten, self.failure)

    def _hand_over(self) -> None:
        batch, self._batch = self._batch, []
        self._frames += len(batch)
        if batch and not self._background.put(batch):
            self._overflowed += len(batch)

    def _write(self, batch: Sequence[tuple[int, Frame, bool]]) -> None:
        if self.failure:
            self._unwritten += len(batch)
            return
        try:
            for time_ns, frame, is_received in batch:
                self._writer.on_message_received(self._message(time_ns, frame, is_received))
        except OSError as error:
            self._unwritten += len(batch)
            self._fail(error)

    def _message(self, time_ns: int, frame: Frame, is_received: bool) -> can.Message:
        return can.Message(
            timestamp=(time_ns - self._begin_ns) * 1e-9,
            arbitration_id=frame.arbitration_id,
            data=frame.data,
            is_extended_id=False,
            is_fd=frame.is_fd,
            bitrate_switch=frame.is_fd,
            is_rx=is_received,
            check=False,
        )

    def _fail(self, error: OSError) -> None:
        self.failure = self.failure or f"bus log stopped: {error.strerror or error}"


class LoggedLink:
    """A link that writes down what passes."""

    def __init__(self, link: Link, clock: Clock, log: BusLog) -> None:
        self._link = link
        self._clock = clock
        self._log = log

    @property
    def counters(self) -> Mapping[str, int]:
        """Those of the link inside."""
        return self._link.counters

    def send(self, frame: Frame) -> SendResult:
        """Hand over one frame; logged when it was taken."""
        result = self._link.send(frame)
        if result is SendResult.SENT:
            self._log.add(self._clock.now_ns(), frame, is_received=False)
        return result

    def receive(self) -> Sequence[tuple[int, Frame]]:
        """Return what has arrived, logged."""
        received = self._link.receive()
        for time_ns, frame in received:
            self._log.add(time_ns, frame, is_received=True)
        return received

    def is_up(self) -> bool:
        """Tell whether the bus is there."""
        return self._link.is_up()

    def close(self) -> None:
        """Release the link; the log stays open."""
        self._link.close()


def open_bus_log(path: Path, begin_ns: int, threaded: bool) -> BusLog:
    """Create a log in the format of the suffix; UserError when the suffix is unknown or the file can't be created."""
    kind = _WRITERS.get(path.suffix.lower())
    if kind is None:
        raise UserError(f"{path}: no bus log of this kind; use one of {', '.join(_WRITERS)}")
    try:
        writer = kind(str(path), channel=CHANNEL if kind is can.CanutilsLogWriter else 1)
    except OSError as error:
        raise UserError(f"{path}: can't log here: {error.strerror}; choose a directory that can be written") from error
    return BusLog(writer, begin_ns, threaded)
