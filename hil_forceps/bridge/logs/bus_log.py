"""The raw bus on file: what the host sent and received, as any CAN tool reads it.

`.asc` and `.blf` go through python-can's own writers. `.log`, which the bench writes at every run, is candump's
format as python-can's writer makes it, to the byte, at a fraction of its time (`candump_lines`).

Times count from the opening of the log, so a run in virtual time gives the same bytes every time. Frames are
collected and written a batch at a time, by a thread in real time (when its queue is full, a whole batch is dropped
and counted). A batch is full, or ends with the first frame that comes `FLUSH_NS` after it began; then it goes to the
system at once (a BLF waits until its container of 128 KiB is full), so that a killed process loses no more than that.
A disk that fails ends the log, never the run: `failure` says why.
"""

from collections import deque
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import IO, Final, NamedTuple, Protocol

import can

from firmware_protocol.frames import Frame
from hil_forceps.bridge.logs.candump_lines import Arrivals, Batch, CandumpLines
from hil_forceps.bridge.ports import Clock, Link, SendResult
from hil_forceps.data.recording.background import Background
from hil_forceps.data.recording.writer import FLUSH_NS, RECENT_NS
from hil_forceps.drives.line_use import LineUse
from hil_forceps.rig.errors import UserError

BATCH_ENTRIES: Final = 256
QUEUED_BATCHES: Final = 64
RECENT_BATCHES: Final = 128  # kept at hand, of those within `RECENT_NS`
CLOSE_TIMEOUT_S: Final = 10.0
BLF_CHANNEL: Final = 1
NO_DATE: Final = "Thu Jan  1 00:00:00.000 am 1970"
_SENT: Final = SendResult.SENT  # members of an Enum cost as much as a call when asked for by their class


class LogReport(NamedTuple):
    """What became of a log."""

    frames: int
    dropped: int
    failure: str


class LogWriter(Protocol):
    """A format. All raise OSError when the disk does."""

    def write(self, batch: Batch, begin_ns: int, lines: str) -> None:
        """Write a batch of frames, times counting from `begin_ns`; `lines`: the same as candump has them."""

    def flush(self) -> None:
        """Hand over to the system what was written."""

    def close(self) -> None:
        """Finish the file."""


class CandumpWriter:
    """`candump -L`."""

    def __init__(self, file: IO[str]) -> None:
        self._file = file

    def write(self, batch: Batch, begin_ns: int, lines: str) -> None:  # noqa: ARG002
        """Write the lines."""
        self._file.write(lines)

    def flush(self) -> None:
        """Hand over what the file's buffer holds."""
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class _AscWriter(can.ASCWriter):
    """ASC without the hour of the day in its head, which would make no two logs alike."""

    def _format_header_datetime(self, dt: datetime) -> str:  # noqa: ARG002
        return NO_DATE


class PythonCanWriter:
    """A log through a writer of python-can."""

    def __init__(self, writer: can.ASCWriter | can.BLFWriter) -> None:
        self._writer = writer

    def write(self, batch: Batch, begin_ns: int, lines: str) -> None:  # noqa: ARG002
        """Write frames one by one."""
        for is_received, frames in batch:
            for time_ns, frame in frames:
                self._writer.on_message_received(
                    can.Message(
                        timestamp=(time_ns - begin_ns) * 1e-9,
                        arbitration_id=frame.arbitration_id,
                        data=frame.data,
                        is_extended_id=frame.is_extended,
                        is_fd=frame.is_fd,
                        bitrate_switch=frame.is_fd,
                        is_rx=is_received,
                        check=False,
                    )
                )

    def flush(self) -> None:
        """Hand over what the file's buffer holds."""
        self._writer.file.flush()

    def close(self) -> None:
        """Write the tail and close the file."""
        self._writer.stop()


class BusLog:
    """Takes frames with the host's time; never blocks and never raises for what the disk does."""

    def __init__(self, writer: LogWriter, begin_ns: int, threaded: bool, use: LineUse | None = None) -> None:
        """`use`: adds up what is logged."""
        self.failure = ""
        self._use = use
        self._writer = writer
        self.begin_ns = begin_ns
        self._batch: Batch = []
        self._due_ns = begin_ns + FLUSH_NS
        self._lines = CandumpLines()
        self._recent: deque[tuple[int, str]] = deque(maxlen=RECENT_BATCHES)  # end and lines of each; the thread's own
        self._overflowed = 0  # the tick's own count; what could not be written is counted by the thread
        self._handed_over = 0
        self._unwritten = 0
        self._background = Background(self._write, threaded, QUEUED_BATCHES, "bus log")

    def add(self, is_received: bool, frames: Arrivals) -> None:
        """Log frames; the sequence must not change any more."""
        batch = self._batch
        batch.append((is_received, frames))
        if len(batch) >= BATCH_ENTRIES:
            self._hand_over()
        elif is_received and frames and frames[0][0] >= self._due_ns:
            self._due_ns = frames[0][0] + FLUSH_NS
            self._hand_over()

    def recent(self) -> list[str]:
        """Return the lines of candump for the last `RECENT_NS` before the closing, and some before them."""
        return [line for _, lines in list(self._recent) for line in lines.splitlines()]

    def close(self) -> LogReport:
        """Write what is left; bounded in time."""
        self._hand_over(CLOSE_TIMEOUT_S)
        if not self._background.close(CLOSE_TIMEOUT_S):
            self.failure = self.failure or f"bus log: the disk did not take it within {CLOSE_TIMEOUT_S:g} s"
        else:
            try:
                self._writer.close()
            except OSError as error:
                self._fail(error)
        return LogReport(self._handed_over, self._overflowed + self._unwritten, self.failure)

    def _hand_over(self, timeout_s: float = 0.0) -> None:
        batch, self._batch = self._batch, []
        count = _count(batch)
        self._handed_over += count
        if batch and not self._background.put(batch, timeout_s):
            self._overflowed += count

    def _keep(self, end_ns: int, lines: str) -> None:
        self._recent.append((end_ns, lines))
        while self._recent[0][0] < end_ns - RECENT_NS:
            self._recent.popleft()

    def _write(self, batch: Batch) -> None:
        lines = self._lines.of(batch, self.begin_ns)
        end_ns = next((frames[-1][0] for _, frames in reversed(batch) if frames), self.begin_ns)
        self._keep(end_ns - self.begin_ns, lines)
        if self._use is not None:
            for _, frames in batch:
                for _, frame in frames:
                    self._use.add(len(frame.data), frame.is_fd, frame.is_extended)
        if self.failure:
            self._unwritten += _count(batch)
            return
        try:
            self._writer.write(batch, self.begin_ns, lines)
            self._writer.flush()
        except OSError as error:
            self._unwritten += _count(batch)
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.failure = self.failure or f"bus log stopped: {error.strerror or error}"


def _count(batch: Batch) -> int:
    return sum([len(frames) for _, frames in batch])


class LoggedLink:
    """A link that writes down what passes."""

    def __init__(self, link: Link, clock: Clock, log: BusLog) -> None:
        self._link, self._send, self._receive = link, link.send, link.receive
        self._now_ns, self._add = clock.now_ns, log.add
        self.is_up = link.is_up

    @property
    def counters(self) -> Mapping[str, int]:
        """Those of the link inside."""
        return self._link.counters

    def send(self, frame: Frame) -> SendResult:
        """Hand over one frame; logged when it was taken."""
        result = self._send(frame)
        if result is _SENT:
            self._add(False, ((self._now_ns(), frame),))
        return result

    def receive(self) -> Arrivals:
        """Return what has arrived, logged."""
        received = self._receive()
        if received:
            self._add(True, received)
        return received

    def close(self) -> None:
        """Release the link; the log stays open."""
        self._link.close()


def open_bus_log(path: Path, begin_ns: int, threaded: bool, use: LineUse | None = None) -> BusLog:
    """Create a log in the format of the suffix; UserError when the suffix is unknown or the file can't be created."""
    try:
        return BusLog(_writer(path), begin_ns, threaded, use)
    except OSError as error:
        raise UserError(f"{path}: can't be written: {error.strerror}; choose another folder") from error


def _writer(path: Path) -> LogWriter:
    match path.suffix.lower():
        case ".log":
            return CandumpWriter(path.open("w", encoding="ascii", newline="\n"))
        case ".asc":
            return PythonCanWriter(_AscWriter(str(path)))
        case ".blf":
            return PythonCanWriter(can.BLFWriter(str(path), channel=BLF_CHANNEL))
    raise UserError(f"{path}: unknown format of bus log; use .log, .asc or .blf")
