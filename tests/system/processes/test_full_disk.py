"""A disk that fills under a run: a clear line, the drive disabled, and what was recorded readable."""

import json
import os
import resource
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.messages import DriveState
from hil_forceps.data.recording.reader import read_recording

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

ROOM_BYTES = 200_000  # less than a second of recording and bus log

DriveFixture = Callable[..., Any]
RunFixture = Callable[..., Any]
AlwaysFull = Callable[[Path], None]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own with little room; skipped where mounting is not permitted."""
    folder = tmp_path / "small"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={ROOM_BYTES}", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("mounting a small tmpfs is not permitted here")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def check_prefix(recording_path: Path) -> None:
    recording = read_recording(recording_path)
    assert len(recording.samples) > 100
    assert (recording.samples["state"] == DriveState.OPERATIONAL).any()
    assert len(recording.notes) == 1
    assert recording.notes[0].startswith("recording ")


def test_recording_and_log_on_a_full_disk(
    drive: DriveFixture, run: RunFixture, pty_wire: Any, small_disk: Path, start: Any
) -> None:
    other = drive(pty_wire)
    ended = run(pty_wire, small_disk).end()
    told = other.end(signal.SIGTERM).told
    assert ended.code == 2
    assert "Traceback" not in ended.err
    assert "hil-forceps: recording stopped: No space left on device\n" in ended.err
    assert (told["drive"]["state"], told["drive"]["faults"]) == ("DISABLED", 0)
    check_prefix(small_disk / "run.mcap")
    replayed = start("replay", small_disk / "run.mcap").end()
    assert replayed.code == 1
    assert "incomplete: " in replayed.out
    assert "all identical" in replayed.out


def test_limit_on_the_size_of_files(drive: DriveFixture, run: RunFixture, pty_wire: Any, tmp_path: Path) -> None:
    """The same without a mount: a file may not grow."""
    other = drive(pty_wire)
    service = run(pty_wire, tmp_path / "out")
    resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, (ROOM_BYTES // 2, ROOM_BYTES // 2))
    ended = service.end()
    told = other.end(signal.SIGTERM).told
    assert ended.code == 2
    assert "Traceback" not in ended.err
    assert "hil-forceps: recording stopped: File too large\n" in ended.err
    assert (told["drive"]["state"], told["drive"]["faults"]) == ("DISABLED", 0)
    check_prefix(tmp_path / "out" / "run.mcap")
    result = json.loads((tmp_path / "out" / "run.json").read_text())
    assert (result["reason"], result["drive_disabled"]) == ("recording_failed", True)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_bus_log_alone_does_not_end_a_run(
    drive: DriveFixture, run: RunFixture, pty_wire: Any, tmp_path: Path, always_full: AlwaysFull
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    always_full(out / "bus.log")
    other = drive(pty_wire)
    ended = run(pty_wire, out, "--duration", "2").end()
    told = other.end(signal.SIGTERM).told
    assert ended.code == 2
    assert ended.err == "hil-forceps: bus log stopped: No space left on device\n"
    assert told["drive"]["state"] == "DISABLED"
    result = json.loads((out / "run.json").read_text())
    assert result["reason"] == "completed"
    assert result["bus_log"]["dropped"] > 0
    recording = read_recording(out / "run.mcap")
    assert recording.notes == ()
    assert len(recording.samples) == result["counters"]["host"]["samples"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_recording_that_can_not_begin_never_starts_the_motor(
    drive: DriveFixture, run: RunFixture, pty_wire: Any, tmp_path: Path, always_full: AlwaysFull
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    always_full(out / "run.mcap")
    other = drive(pty_wire)
    ended = run(pty_wire, out).end()
    told = other.end(signal.SIGTERM).told
    assert ended.code == 2
    assert ended.err.startswith(f"hil-forceps: {out}/run.mcap: recording stopped: No space left on device")
    assert ended.err.count("\n") == 1
    assert told["received"] == {}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_summary_that_can_not_be_written_is_told(
    drive: DriveFixture, run: RunFixture, pty_wire: Any, tmp_path: Path, always_full: AlwaysFull
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    always_full(out / "run.json")
    other = drive(pty_wire)
    ended = run(pty_wire, out, "--duration", "0.2").end()
    other.end(signal.SIGTERM)
    assert ended.code == 2
    assert "run.json: can't be written: No space left on device" in ended.err
    assert "Traceback" not in ended.err
