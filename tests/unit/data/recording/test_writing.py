"""A recording on a disk that is full, slow or fails: it ends in order, and never raises."""

import errno
import io
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader

from hil_forceps.data.recording import writer as recording_writer
from hil_forceps.data.recording.reader import parse_recording, read_recording
from hil_forceps.data.recording.writer import Recorder, open_recorder
from hil_forceps.rig.errors import UserError
from tests.unit.data.recording.memory import METADATA, RESULT, Memory, fill, is_prefix, record


@pytest.mark.parametrize("threaded", [False, True])
def test_a_full_disk_ends_the_recording_and_never_raises(threaded: bool) -> None:
    whole, _ = record(3000)
    for room in (40_000, 60_001, len(whole) - 10):
        data, report = record(3000, threaded, room)
        assert "No space left" in report.failure
        assert len(data) <= room
        part = parse_recording(data, "part")
        assert is_prefix(part, parse_recording(whole, "whole"))
        assert len(part.order) == report.messages - report.dropped > 0
        assert part.notes, "the summary at least is not there"


def test_after_a_full_disk_other_tools_still_read_the_file_by_its_index() -> None:
    data, report = record(3000, room=60_001)
    summary = make_reader(io.BytesIO(data), validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == report.messages - report.dropped > 0


def test_dev_full_is_a_user_error_at_the_start() -> None:
    with pytest.raises(UserError, match=r"/dev/full: recording stopped: No space left.*choose another folder"):
        open_recorder(Path("/dev/full"), METADATA, threaded=False)


def test_a_place_that_can_not_be_written_is_a_user_error(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="No such file"):
        open_recorder(tmp_path / "missing" / "a.mcap", METADATA, threaded=False)


def test_a_disk_that_is_too_slow_loses_whole_chunks_and_says_how_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording_writer, "QUEUED_CHUNKS", 1)
    file = Memory()
    recorder = Recorder(file, METADATA, threaded=True)
    with blocked(recorder):
        fill(recorder, 3000)
    report = recorder.close(RESULT)
    assert report.dropped > 0
    assert report.failure == ""
    recording = parse_recording(file.kept, "memory")
    assert len(recording.order) == report.messages - report.dropped
    assert recording.notes == (f"{report.dropped} messages were dropped while recording",)


class blocked:  # noqa: N801 reads as a word
    """Hold the writing thread at its next chunk."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._go = threading.Event()
        self._write: Callable[..., None] = recorder._file.chunk

    def __enter__(self) -> None:
        def wait(chunk: object) -> None:
            self._go.wait(10)
            self._write(chunk)

        self._recorder._file.chunk = wait  # type: ignore[method-assign]

    def __exit__(self, *_: object) -> None:
        self._go.set()


@pytest.mark.parametrize("threaded", [False, True])
def test_in_real_time_each_chunk_is_sent_to_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threaded: bool
) -> None:
    synced: list[int] = []
    path = tmp_path / "run.mcap"
    monkeypatch.setattr(os, "fdatasync", lambda _: synced.append(path.stat().st_size))
    recorder = open_recorder(path, METADATA, threaded)
    fill(recorder, 1000)
    report = recorder.close(RESULT)
    assert sorted(synced) == synced
    assert (len(synced) > 3 and synced[-1] == report.file_bytes) if threaded else not synced


def test_a_disk_that_fails_to_synchronise_ends_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fdatasync", fails)
    recorder = open_recorder(tmp_path / "run.mcap", METADATA, threaded=True)
    fill(recorder, 1000)
    report = recorder.close(RESULT)
    assert report.failure == "recording stopped: Input/output error"
    assert len(read_recording(tmp_path / "run.mcap").order) >= report.messages - report.dropped


def test_closing_twice_is_a_mistake_of_the_caller() -> None:
    recorder = Recorder(Memory(), METADATA, threaded=False)
    recorder.close(RESULT)
    with pytest.raises(ValueError, match="closed"):
        recorder.close(RESULT)
