"""What is recorded comes back, to us and to the mcap library, whatever happens to the disk or the process."""

import errno
import io
import math
import os
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader

from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_RAD
from hil_forceps.data.recording import writer as recording_writer
from hil_forceps.data.recording.format import BENCH, FORMAT_VERSION, MESSAGE_HEAD, REFERENCE, SAMPLE, TOPICS
from hil_forceps.data.recording.reader import Recording, parse_recording, read_recording, tables_of
from hil_forceps.data.recording.writer import Outcome, Recorder, RecordingReport, Reference, open_recorder
from hil_forceps.estimation.interface import Estimate, Sample
from hil_forceps.rig.errors import UserError
from tests.reader_fuzz import sound_files
from tests.reader_fuzz.sound_files import HEAD, MAGIC

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


def test_everything_comes_back_bit_by_bit() -> None:
    data, report = record(1000)
    assert report == RecordingReport(3000, 0, len(data), "")
    recording = parse_recording(data, "memory")
    assert (dict(recording.metadata), dict(recording.result), recording.notes) == (METADATA, RESULT, ())
    assert recording.order.tolist() == [SAMPLE.channel, BENCH.channel, REFERENCE.channel] * 1000
    assert recording.samples["theta_m_raw"].tolist() == list(range(1000, 2000))
    assert recording.samples["tau_w_estimate_N_m"].tolist() == [1e-3 * math.sin(k) for k in range(1000)]
    assert recording.samples["current_raw"][4] == -5
    assert recording.references["sent_ns"][7] == 7_610_000
    assert math.isnan(recording.references["passed_rad"][2])
    assert recording.bench["theta_j_rad"][999] == 999 * ANGLE_LSB_RAD
    assert recording.zero_ns == 3 * MS


def test_the_same_messages_give_the_same_bytes_with_a_thread_or_without() -> None:
    assert record(2000)[0] == record(2000)[0] == record(2000, threaded=True)[0]


def test_the_mcap_library_reads_it_by_index_in_order_and_with_intact_checksums() -> None:
    data, _ = record(1000)
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 3000
    assert {channel.topic for channel in summary.channels.values()} == {topic.topic for topic in TOPICS}
    assert [metadata.name for metadata in reader.iter_metadata()] == ["hil_forceps", "hil_forceps_result"]
    found = list(reader.iter_messages(topics=[SAMPLE.topic]))
    assert len(found) == 1000
    schema, channel, message = found[100]
    assert schema is not None
    assert (schema.encoding, channel.message_encoding, message.sequence) == ("ros2msg", "cdr", 100)
    assert message.data[:4] == b"\x00\x01\x00\x00"
    times = [message.log_time for _, _, message in reader.iter_messages()]
    assert times == sorted(times)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.topic)
def test_messages_are_valid_cdr_under_their_schema(topic: object) -> None:
    """CDR aligns each number to its own size, counted from behind the four bytes of the head."""
    assert topic in TOPICS
    known = next(each for each in TOPICS if each == topic)
    sizes = {"int64": 8, "float64": 8, "int32": 4, "uint8": 1}
    offset = 0
    for line, field in zip(known.schema_text().splitlines(), known.fields, strict=True):
        kind, name, *_ = line.split()
        assert (kind, name) == (field.type, field.name.lower())
        assert offset % sizes[kind] == 0
        offset += sizes[kind]
    assert offset == known.dtype.itemsize == known.record.size - MESSAGE_HEAD.size


def is_prefix(part: Recording, whole: Recording) -> bool:
    return all(w.startswith(p) for p, w in zip(messages(part), messages(whole), strict=True))


def test_a_file_cut_off_anywhere_gives_a_prefix() -> None:
    data, _ = record(1200)
    whole = parse_recording(data, "whole")
    seen = set()
    for size in [*range(0, 2_500, 7), *range(2_500, len(data), 997), *range(len(data) - 3_000, len(data), 13)]:
        try:
            part = parse_recording(data[:size], "part")
        except UserError:
            assert size < 2_500, "once the head is written there is always something to read"
            continue
        assert is_prefix(part, whole), size
        assert len(part.notes) == 1 or len(part.order) == len(whole.order)
        seen.add(len(part.order))
    assert len(seen) > 3, "chunks come back one by one"


def test_damage_is_noticed_and_what_stands_before_it_comes_back() -> None:
    data, _ = record(2000)
    whole = parse_recording(data, "whole")
    lost = 0
    for place in range(3_000, len(data) - 4_000, 4_999):
        broken = bytearray(data)
        broken[place] ^= 0x40
        part = parse_recording(bytes(broken), "part")
        assert is_prefix(part, whole) or part.notes
        lost += len(part.order) < len(whole.order)
    assert lost > 3


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
    with pytest.raises(UserError, match=r"/dev/full: recording stopped: No space left.*choose another place"):
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


def test_foreign_files_are_refused_in_words(tmp_path: Path) -> None:
    foreign = tmp_path / "a.mcap"
    with pytest.raises(UserError, match="can't be read: No such file"):
        read_recording(foreign)
    foreign.write_bytes(b"time_s,theta_m_rad\n")
    with pytest.raises(UserError, match="not an MCAP file"):
        read_recording(foreign)
    data, _ = record(10)
    with pytest.raises(UserError, match="not a recording of the bench"):
        parse_recording(data.replace(b"hil_forceps", b"hil_fffceps"), "x")


def test_another_format_is_refused_and_a_damaged_description_of_this_one_is_not() -> None:
    data = record(10)[0]
    other = data.replace(b"int64 stamp_ns", b"int64 ztamp_ns")
    part = parse_recording(other, "x")
    assert "recording is damaged: the description of /sample isn't what was written" in part.notes
    assert is_prefix(parse_recording(data, "whole"), part)
    without_copy = [each for each in sound_files.records(other) if each[0] != Opcode.ATTACHMENT]
    with pytest.raises(UserError, match="/sample was recorded in another format"):
        parse_recording(sound_files.mcap(without_copy), "x")
    later = sound_files.attachment("hil_forceps.json", b'{"format": %d, "metadata": {}}' % (FORMAT_VERSION + 1))
    found = [each for each in sound_files.records(data) if each[0] != Opcode.ATTACHMENT]
    with pytest.raises(UserError, match=r"was recorded in another format \('2'\)"):
        parse_recording(sound_files.mcap([later, *found]), "x")


def test_what_a_recording_says_of_itself_is_read_from_the_copy_with_a_checksum() -> None:
    data = record(10)[0]
    part = parse_recording(data.replace(b"kalman", b"kalmam", 1), "x")
    assert part.metadata == METADATA
    assert "recording is damaged: its metadata aren't what was written, the copy of them is read" in part.notes
    at = data.rindex(b'"kalman"')
    part = parse_recording(data[:at] + data[at:].replace(b"kalman", b"kalmam", 1), "x")
    assert part.metadata == METADATA
    assert any("the checksum of an attachment is wrong" in note for note in part.notes)


def test_recordings_without_these_checksums_are_read_as_before() -> None:
    """Those of earlier versions: no copy of the metadata, no checksum over the data section."""
    whole = parse_recording(record(1000)[0], "whole")
    found = [each for each in sound_files.records(record(1000)[0]) if each[0] != Opcode.ATTACHMENT]
    old = [(opcode, bytes(4) if opcode == Opcode.DATA_END else body) for opcode, body in found]
    summary = next(place for place, (opcode, _) in enumerate(old) if opcode == Opcode.DATA_END) + 1
    data = sound_files.mcap(old[:summary])
    footer = HEAD.pack(Opcode.FOOTER, 20) + bytes(20)
    part = parse_recording(data + footer + MAGIC, "old")
    assert part.notes == ()
    assert messages(part) == messages(whole)
    assert part.metadata == METADATA


def test_a_chunk_starts_anew_where_messages_are_rare() -> None:
    """However slow a run is, no message waits longer than `FLUSH_NS` for the next one to take it to the file."""
    file = Memory()
    recorder = Recorder(file, METADATA, threaded=False)
    for k in range(40):
        now = k * 100 * MS
        recorder.sample(RawSample(k, now, k, 0, 0, 0, 0, now), Sample(now, 0.0, 0.0), Estimate(0.0, 0.0))
        read = parse_recording(file.getvalue(), "x").samples
        assert now - (read["received_ns"][-1] if len(read) else 0) <= recording_writer.FLUSH_NS + 100 * MS
    recorder.close({})


def test_the_last_seconds_stay_at_hand_in_bounded_memory() -> None:
    recorder = Recorder(Memory(), METADATA, threaded=False)
    for k in range(20):
        fill(recorder, 1000, first=1000 * k)
        kept = tables_of(recorder.recent(), first_counts=False)
        newest = 1000 * (k + 1) - 1
        assert kept.samples["stamp_ns"][-1] == newest * MS
        assert kept.samples["stamp_ns"][0] <= max(newest * MS - recording_writer.RECENT_NS, 0)
        assert kept.missing == 0
        assert len(recorder.recent()) <= 2 + recording_writer.RECENT_NS // (200 * MS)
    fill(recorder, 3)
    recorder.close({})


def test_a_run_begins_at_its_zero_with_the_reference_that_the_drive_followed() -> None:
    data, _ = record(600)
    run = parse_recording(data, "memory").to_run()
    assert len(run) == 597
    assert run.columns["time_s"][:3] == pytest.approx([0.0, 1e-3, 2e-3], abs=1e-12)
    # the drive's echo in sample k names the reference of tick k-1, and that of tick 2 was never sent
    assert "theta_m_ref_rad" not in run.columns
    assert any("isn't recorded" in note for note in run.notes)
    assert run.columns["theta_j_rad"][0] == 3 * ANGLE_LSB_RAD
    file = Memory()
    recorder = Recorder(file, METADATA, threaded=False)
    fill(recorder, 600, first=3)
    recorder.close(RESULT)
    recording = parse_recording(file.kept, "memory")
    later = replace(recording, samples=recording.samples[1:], bench=recording.bench[1:])
    run = later.to_run()
    assert run.columns["theta_m_ref_rad"].tolist() == [0.25 * k for k in range(3, 602)]


def test_a_run_that_never_began_is_a_user_error() -> None:
    data, _ = record(3)
    with pytest.raises(UserError, match="never became operational"):
        parse_recording(data, "memory").to_run()


def test_bench_values_are_matched_by_sequence_nearby_in_time() -> None:
    data, _ = record(900)
    recording = parse_recording(data, "memory")
    gone = replace(recording, bench=np.delete(recording.bench, slice(300, 560)))
    run = gone.to_run()
    assert "theta_j_rad" not in run.columns
    assert any("260 samples have no bench values" in note for note in run.notes)


def repacked(change: Callable[[bytes], bytes], at: int = 0) -> bytes:
    """Return a recording whose chunk number `at` was changed, with the right checksum."""
    found = sound_files.records(record(3000)[0])
    chunks = [place for place, (opcode, _) in enumerate(found) if opcode == sound_files.CHUNK_OPCODE]
    found[chunks[at]] = (sound_files.CHUNK_OPCODE, change(found[chunks[at]][1]))
    return sound_files.mcap(found)


def test_a_chunk_that_says_any_size_asks_for_no_memory() -> None:
    data = bytearray(repacked(bytes))
    at = data.index(zstandard.FRAME_HEADER)
    place = data.rindex((4).to_bytes(4, "little") + b"zstd", 0, at) - 12  # uncompressed size: eight bytes, then the CRC
    for size, told in ((1 << 60, "a chunk of 1152921504606846976 bytes"), (77, "a chunk whose two sizes differ")):
        data[place : place + 8] = size.to_bytes(8, "little")
        recording = parse_recording(bytes(data), "x")
        assert len(recording.samples) == 0
        assert "damaged after 0 chunks, in the record that ends at byte " in recording.notes[0]
        assert told in recording.notes[0]


def test_a_wrong_checksum_ends_the_reading_where_it_is() -> None:
    data, _ = record(3000)
    whole = parse_recording(data, "whole")
    at = data.rindex(zstandard.FRAME_HEADER)
    place = data.rindex((4).to_bytes(4, "little") + b"zstd", 0, at) - 4
    part = parse_recording(data[:place] + b"\1\2\3\4" + data[place + 4 :], "part")
    assert "the checksum of a chunk is wrong" in part.notes[0]
    assert 0 < len(part.samples) < len(whole.samples)
    assert is_prefix(part, whole)


def test_other_ways_to_pack_are_no_guess() -> None:
    data = repacked(bytes).replace((4).to_bytes(4, "little") + b"zstd", (4).to_bytes(4, "little") + b"lz4\0")
    assert "a chunk packed by 'lz4\\x00'" in parse_recording(data, "x").notes[0]


def test_samples_that_only_damage_makes_are_no_run() -> None:
    def stand_still(chunk: bytes) -> bytes:
        at = 10 * sum(topic.record.size for topic in TOPICS) + MESSAGE_HEAD.size
        return chunk[:at] + bytes(8) + chunk[at + 8 :]

    with pytest.raises(UserError, match="x: sample 8 is stamped no later than the one before it; it is damaged"):
        parse_recording(repacked(stand_still), "x").to_run()
