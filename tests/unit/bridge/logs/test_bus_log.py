"""The raw log: every frame, in formats that other tools read, the same bytes every time."""

import time
from pathlib import Path

import can
import pytest

from firmware_protocol.frames import Frame
from hil_forceps.bridge.logs.bus_log import (
    BATCH_ENTRIES,
    BusLog,
    CandumpWriter,
    LoggedLink,
    LogReport,
    open_bus_log,
)
from hil_forceps.bridge.ports import SendResult
from hil_forceps.data.readers.bus_logs.frames import read_frames
from hil_forceps.data.recording.writer import FLUSH_NS, RECENT_NS
from hil_forceps.rig.errors import UserError

BEGIN_NS = 5_000_000_000


def some_frame(k: int) -> Frame:
    """One in ten is FD; of the others some have an id of 29 bits, among them one whose number another has with 11."""
    if k % 10 == 9:
        return Frame(0x64, bytes(16), True)
    if k % 10 == 8:
        return Frame(0x64 if k % 20 == 8 else 0x1FFFFFFF - k, bytes(16), True, True)
    return Frame(0x44 + k % 3, bytes([k % 256, 0xAB]), is_extended=k % 10 == 7)


def write(path: Path, frames: int, threaded: bool = False) -> LogReport:
    log = open_bus_log(path, BEGIN_NS, threaded)
    for k in range(frames):
        log.add(k % 2 == 0, [(BEGIN_NS + k * 250_000, some_frame(k))])
    return log.close()


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_logs_read_back_with_python_can(tmp_path: Path, suffix: str) -> None:
    frames = BATCH_ENTRIES * 2 + 30
    report = write(tmp_path / f"bus{suffix}", frames)
    assert report == LogReport(frames, 0, "")
    messages = list(can.LogReader(str(tmp_path / f"bus{suffix}")))
    assert len(messages) == frames
    assert messages[3].timestamp - messages[0].timestamp == pytest.approx(7.5e-4, abs=1e-6)
    assert (messages[9].is_fd, len(messages[9].data)) == (True, 16)
    assert [
        Frame(message.arbitration_id, bytes(message.data), message.is_fd, message.is_extended_id)
        for message in messages
    ] == [some_frame(k) for k in range(frames)]
    assert [stamped.frame for stamped in read_frames(tmp_path / f"bus{suffix}")] == [
        some_frame(k) for k in range(frames)
    ]
    assert [message.is_rx for message in messages[:4]] == [True, False, True, False]


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_the_same_frames_give_the_same_bytes_at_any_hour(tmp_path: Path, suffix: str) -> None:
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    write(first, 700)
    time.sleep(0.005)
    write(second, 700, threaded=True)
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("suffix", [".log", ".asc"])
def test_what_waits_for_a_full_batch_does_not_wait_long(tmp_path: Path, suffix: str) -> None:
    """However rare frames are, the file lacks no more than those of the last `FLUSH_NS` and one of them."""
    path, step_ns = tmp_path / f"bus{suffix}", 120_000_000
    log = open_bus_log(path, BEGIN_NS, False)
    for k in range(40):
        log.add(True, [(BEGIN_NS + k * step_ns, some_frame(k))])
        assert len(list(read_frames(path))) >= k - FLUSH_NS // step_ns - 1 if k > 10 else True
    log.close()


def test_the_last_seconds_stay_at_hand(tmp_path: Path) -> None:
    log = open_bus_log(tmp_path / "bus.log", BEGIN_NS, False)
    for k in range(20_000):
        log.add(k % 2 == 0, [(BEGIN_NS + k * 500_000, some_frame(k))])
    log.close()
    lines = log.recent()
    times = [float(line[1:].partition(")")[0]) for line in lines]
    assert times[-1] == 19_999 * 5e-4
    assert times[0] <= times[-1] - RECENT_NS / 1e9
    assert len(times) <= RECENT_NS // 500_000 + 2 * BATCH_ENTRIES
    assert (tmp_path / "bus.log").read_text().endswith("\n".join(lines) + "\n")


def test_unknown_kinds_and_places_are_user_errors(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"use \.log, \.asc or \.blf"):
        open_bus_log(tmp_path / "bus.txt", 0, threaded=False)
    with pytest.raises(UserError, match="can't be written: No such file"):
        open_bus_log(tmp_path / "none" / "bus.log", 0, threaded=False)


@pytest.mark.parametrize("threaded", [False, True])
def test_a_full_disk_ends_the_log_and_never_raises(threaded: bool) -> None:
    log = BusLog(CandumpWriter(Path("/dev/full").open("w")), 0, threaded)  # noqa: SIM115 the log closes it
    for k in range(2000):
        log.add(True, [(k, Frame(1, b"12345678"))] * 2)
    report = log.close()
    assert "No space left" in report.failure
    assert report.frames == 4000
    assert report.dropped > 0


class Passing:
    """A link that takes every other frame."""

    def __init__(self) -> None:
        self.counters = {"a": 1}
        self.sends = 0
        self.closed = False

    def send(self, frame: Frame) -> SendResult:
        self.sends += bool(frame)
        return SendResult.SENT if self.sends % 2 else SendResult.QUEUE_FULL

    def receive(self) -> list[tuple[int, Frame]]:
        return [(BEGIN_NS + 1_000_000, Frame(0x84, b"in"))]

    def is_up(self) -> bool:
        return not self.closed

    def close(self) -> None:
        self.closed = True

    def now_ns(self) -> int:
        return BEGIN_NS + 2_000_000

    def sleep_until_ns(self, time_ns: int) -> None:
        raise AssertionError(time_ns)


def test_what_passes_a_logged_link_is_logged_and_what_was_dropped_is_not(tmp_path: Path) -> None:
    inner = Passing()
    log = open_bus_log(tmp_path / "bus.log", BEGIN_NS, threaded=False)
    link = LoggedLink(inner, inner, log)
    assert link.receive() == inner.receive()
    assert [link.send(Frame(0x44, b"out")) for _ in range(2)] == [SendResult.SENT, SendResult.QUEUE_FULL]
    assert link.counters == inner.counters
    assert link.is_up()
    link.close()
    assert not link.is_up()
    log.close()
    assert (tmp_path / "bus.log").read_text() == "(0.001000) can0 084#696E R\n(0.002000) can0 044#6F7574 T\n"


def test_our_candump_format_is_python_cans_to_the_byte(tmp_path: Path) -> None:
    write(tmp_path / "ours.log", 1000)
    theirs = can.CanutilsLogWriter(str(tmp_path / "theirs.log"), channel="can0")
    for k in range(1000):
        frame = some_frame(k)
        theirs.on_message_received(
            can.Message(
                timestamp=k * 250_000 * 1e-9,
                arbitration_id=frame.arbitration_id,
                data=frame.data,
                is_extended_id=frame.is_extended,
                is_fd=frame.is_fd,
                bitrate_switch=frame.is_fd,
                is_rx=k % 2 == 0,
            )
        )
    theirs.stop()
    assert (tmp_path / "ours.log").read_bytes() == (tmp_path / "theirs.log").read_bytes()


def test_time_in_a_log_never_goes_back(tmp_path: Path) -> None:
    log = open_bus_log(tmp_path / "bus.log", 0, threaded=False)
    log.add(False, [(2_000_000, Frame(1, b""))])
    log.add(True, [(1_000_000, Frame(2, b"")), (3_000_000, Frame(3, b""))])
    log.close()
    assert [line[:10] for line in (tmp_path / "bus.log").read_text().splitlines()] == ["(0.002000)"] * 2 + [
        "(0.003000)"
    ]
