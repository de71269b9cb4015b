"""What is recorded comes back, to us and to the mcap library."""

import io
import math

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader

from firmware_protocol.host.samples import RawSample
from firmware_protocol.scales import ANGLE_LSB_RAD
from hil_forceps.data.recording import writer as recording_writer
from hil_forceps.data.recording.format import BENCH, MESSAGE_HEAD, REFERENCE, SAMPLE, TOPICS
from hil_forceps.data.recording.reader import parse_recording, tables_of
from hil_forceps.data.recording.writer import Recorder, RecordingReport
from hil_forceps.estimation.interface import Estimate, Sample
from tests.reader_fuzz import sound_files
from tests.reader_fuzz.sound_files import HEAD, MAGIC
from tests.unit.data.recording.memory import METADATA, MS, RESULT, Memory, fill, messages, record


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


def test_what_a_recording_says_of_itself_is_read_from_the_copy_with_a_checksum() -> None:
    data = record(10)[0]
    part = parse_recording(data.replace(b"kalman", b"kalmam", 1), "x")
    assert part.metadata == METADATA
    assert "recording is damaged: its metadata were changed; the copy was read instead" in part.notes
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
