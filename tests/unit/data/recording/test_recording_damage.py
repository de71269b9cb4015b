"""A small recording cut at every byte, and with every byte changed: the same data, or the damage told; no other data.

Every byte takes tens of seconds and is for `make test-long`; a sample of them, always the same, is for every change.
"""

import errno
import io
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import pytest

from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.messages import DriveState
from hil_forceps.data.recording.mcap_file import Chunk
from hil_forceps.data.recording.reader import Recording, parse_recording
from hil_forceps.data.recording.salvage import all_messages, gaps, salvage
from hil_forceps.data.recording.writer import Outcome, Recorder, Reference
from hil_forceps.estimation.interface import Estimate, Sample
from hil_forceps.rig.errors import UserError

MS = 1_000_000
STEP_NS = 100 * MS  # so slow that a chunk holds few messages
METADATA = {"rig": "forceps:\n  motor: {µ: 1}\n", "settings": '{"algorithm": "kalman"}'}
RESULT = {"reason": "completed", "message": "completed"}
CHANGES: tuple[Callable[[int], int], ...] = (lambda b: b ^ 1, lambda b: b ^ 0x80, lambda b: b ^ 0xFF, lambda _: 0)

every = pytest.mark.parametrize("stride", [17, pytest.param(1, marks=pytest.mark.long)], ids=["some", "every"])


class Memory(io.BytesIO):
    """A file that can still be looked at when it is closed; writing fails at the write of this number."""

    def __init__(self, fails_at: int | None = None, takes: int = 0) -> None:
        super().__init__()
        self.kept = b""
        self.writes = 0
        self.full = False
        self._fails_at = fails_at
        self._takes = takes  # bytes that the failing write still takes

    def write(self, data: object) -> int:
        view = memoryview(data)  # type: ignore[arg-type]
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        if self.writes == self._fails_at:
            self.full = True
            if part := min(self._takes, len(view) - 1):
                return super().write(view[:part])
            raise OSError(errno.ENOSPC, "No space left on device")
        self.writes += 1
        return super().write(view)

    def close(self) -> None:
        self.kept = self.getvalue()
        super().close()


def fill(recorder: Recorder, ticks: int = 24) -> None:
    for k in range(ticks):
        now = k * STEP_NS
        state = DriveState.OPERATIONAL if k >= 3 else DriveState.ARMED
        raw = RawSample(k, now, 1000 + k, -5, state, 0, max(k - 1, 0), now + 350_000)
        recorder.sample(raw, Sample(now, 0.1 * k, -1.35e-5), Estimate(1e-3 * k, 2e-5))
        recorder.bench(RawBench(k, k, 9, now + 400_000))
        recorder.reference(
            Reference(now + 600_000, now, now, k, 1.5, 2e-5, 0.25 * k, 0.25 * k, 16, k), now, Outcome.SENT, k
        )


@cache
def sound() -> bytes:
    file = Memory()
    recorder = Recorder(file, METADATA, threaded=False)
    fill(recorder)
    assert not recorder.close(RESULT, {"fault.json": b'{"reason": "none"}'}).failure
    return file.kept


@cache
def chunk_ends() -> tuple[int, ...]:
    """Where each chunk is whole, told by the writer's own count of good bytes."""
    file = Memory()
    recorder = Recorder(file, METADATA, threaded=False)
    ends: list[int] = []
    write = recorder._file.chunk

    def noted(chunk: Chunk) -> None:
        write(chunk)
        ends.append(recorder._file.good_bytes)

    recorder._file.chunk = noted  # type: ignore[method-assign]
    fill(recorder)
    recorder.close(RESULT)
    return tuple(ends)


def tables(recording: Recording) -> tuple[Any, ...]:
    return recording.samples, recording.references, recording.bench


def messages(recording: Recording) -> tuple[bytes, ...]:
    return tuple(table.tobytes() for table in (*tables(recording), recording.order))


def is_prefix(part: Recording, whole: Recording) -> bool:
    return all(w.startswith(p) for p, w in zip(messages(part), messages(whole), strict=True))


def is_part(part: Recording, whole: Recording) -> bool:
    """Tell whether every message is one of the whole recording, in its order, and holes between them are told."""
    for mine, all_of_it in zip(tables(part), tables(whole), strict=True):
        rest = iter(all_of_it.tolist())
        if not all(row in rest for row in mine.tolist()):
            return False
    return is_prefix(part, whole) or any("messages are missing" in note for note in part.notes)


def read(data: bytes) -> Recording | None:
    """Read it; None where it is refused."""
    try:
        return parse_recording(data, "r.mcap")
    except UserError:
        return None


def changed(data: bytes, stride: int) -> Iterator[tuple[int, bytes]]:
    for place in range(0, len(data), stride):
        for change in CHANGES:
            if (byte := change(data[place])) != data[place]:
                yield place, data[:place] + bytes([byte]) + data[place + 1 :]


@every
def test_cut_anywhere_what_was_written_before_reads_back(stride: int) -> None:
    data, whole, ends = sound(), parse_recording(sound(), "whole"), chunk_ends()
    assert len(ends) >= 4
    chunk_rows = [len(parse_recording(data[:end], "x").order) for end in ends]
    refused = 0
    for size in range(0, len(data), stride):
        part = read(data[:size])
        if part is None:
            refused = size
            continue
        assert is_prefix(part, whole), size
        assert part.notes, f"cut at {size}, and not a word"
        assert part.metadata == METADATA
        there = sum(end <= size for end in ends)
        assert len(part.order) >= (chunk_rows[there - 1] if there else 0), f"cut at {size}: a whole chunk is lost"
    assert 0 < refused < ends[0], "only what is cut before its settings is refused"


@every
def test_a_changed_byte_is_found(stride: int) -> None:
    data, whole = sound(), parse_recording(sound(), "whole")
    assert whole.notes == ()
    for place, broken in changed(data, stride):
        part = read(broken)
        if part is None:
            continue
        assert part.notes, f"byte {place} is another, and not a word"
        assert is_part(part, whole), place
        assert part.metadata == METADATA, place


@every
def test_a_changed_byte_in_a_recording_that_was_cut_off_gives_no_other_data(stride: int) -> None:
    data = sound()[: chunk_ends()[1] + 40]
    whole = parse_recording(data, "whole")
    for place, broken in changed(data, stride):
        part = read(broken)
        if part is None:
            continue
        assert is_part(part, whole), place
        assert part.metadata == METADATA, place


@pytest.mark.parametrize("takes", [0, 1, 300])
def test_a_disk_that_is_full_at_any_write(takes: int) -> None:
    whole = parse_recording(sound(), "whole")
    counting = Memory()
    recorder = Recorder(counting, METADATA, threaded=False)
    fill(recorder)
    recorder.close(RESULT, {"fault.json": b"{}"})
    assert counting.writes >= 8
    for at in range(counting.writes):
        file = Memory(at, takes)
        recorder = Recorder(file, METADATA, threaded=False)
        fill(recorder)
        report = recorder.close(RESULT, {"fault.json": b"{}"})
        assert "No space left" in report.failure
        part = read(file.kept)
        if part is None:
            assert at < 2, "only without its settings"
            continue
        assert is_prefix(part, whole)
        assert len(part.order) == report.messages - report.dropped
        assert part.notes


@every
def test_salvage_loses_no_chunk_but_the_one_that_is_hit(stride: int) -> None:
    data, ends = sound(), chunk_ends()
    whole = salvage(data, "whole")
    assert whole.is_sound
    records = [{message.record for message in all_messages([chunk])} for chunk in whole.found.chunks]
    for place, broken in changed(data, stride):
        found = salvage(broken, "broken")
        assert not found.is_sound, place
        there = {message.record for message in all_messages(found.found.chunks)}
        assert there <= set().union(*records), f"byte {place}: messages that nobody wrote"
        lost = [number for number, chunk in enumerate(records) if not chunk <= there]
        assert len(lost) <= 1, f"byte {place}: chunks {lost} are lost"
        if lost:
            begin = ends[lost[0] - 1] if lost[0] else 0
            assert begin <= place < ends[lost[0]], f"byte {place} is not in chunk {lost[0]}, which is lost"
            assert any(damage.begin <= place < damage.end for damage in found.damage)
        assert found.found.metadata["hil_forceps"] == METADATA, place


@every
def test_salvage_of_a_cut_file_is_what_the_reader_gives(stride: int) -> None:
    data = sound()
    for size in range(0, len(data), stride):
        part = read(data[:size])
        if part is not None:
            count = sum(1 for _ in all_messages(salvage(data[:size], "part").found.chunks))
            assert count == len(part.order), size


def test_salvage_crosses_what_is_overwritten() -> None:
    """A block of zeros or of noise over a chunk's border: all other chunks, and where it lies."""
    data, ends = sound(), chunk_ends()
    for noise in (bytes(300), bytes(range(256)) + bytes(44)):
        broken = data[: ends[0] - 150] + noise + data[ends[0] + 150 :]
        found = salvage(broken, "broken")
        assert len(found.found.chunks) == len(ends) - 1, "the one that begins behind the border"
        (damage,) = found.damage
        assert damage.begin < ends[0] < damage.end <= ends[1]
        assert {gap.channel for gap in gaps(all_messages(found.found.chunks))} == {1, 2, 3}
