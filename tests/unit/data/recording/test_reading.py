"""A recording that was cut, damaged or made by others: a prefix, or refused in words; and the run that is in it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode

from firmware_protocol.scales import ANGLE_LSB_RAD
from hil_forceps.data.recording.format import FORMAT_VERSION, MESSAGE_HEAD, TOPICS
from hil_forceps.data.recording.reader import parse_recording, read_recording
from hil_forceps.data.recording.writer import Recorder
from hil_forceps.rig.errors import UserError
from tests.reader_fuzz import sound_files
from tests.unit.data.recording.memory import METADATA, RESULT, Memory, fill, is_prefix, record


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


def test_foreign_files_are_refused_in_words(tmp_path: Path) -> None:
    foreign = tmp_path / "a.mcap"
    with pytest.raises(UserError, match="can't be read: No such file"):
        read_recording(foreign)
    foreign.write_bytes(b"time_s,theta_m_rad\n")
    with pytest.raises(UserError, match="not an MCAP file"):
        read_recording(foreign)
    data, _ = record(10)
    with pytest.raises(UserError, match="not a recording of `run` or `bench`"):
        parse_recording(data.replace(b"hil_forceps", b"hil_fffceps"), "x")


def test_another_format_is_refused_and_a_damaged_description_of_this_one_is_not() -> None:
    data = record(10)[0]
    other = data.replace(b"int64 stamp_ns", b"int64 ztamp_ns")
    part = parse_recording(other, "x")
    assert "recording is damaged: the description of /sample was changed" in part.notes
    assert is_prefix(parse_recording(data, "whole"), part)
    without_copy = [each for each in sound_files.records(other) if each[0] != Opcode.ATTACHMENT]
    with pytest.raises(UserError, match="/sample has another format"):
        parse_recording(sound_files.mcap(without_copy), "x")
    later = sound_files.attachment("hil_forceps.json", b'{"format": %d, "metadata": {}}' % (FORMAT_VERSION + 1))
    found = [each for each in sound_files.records(data) if each[0] != Opcode.ATTACHMENT]
    with pytest.raises(UserError, match=r"has another format \('2'\)"):
        parse_recording(sound_files.mcap([later, *found]), "x")


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

    with pytest.raises(
        UserError, match="x: sample 8 is stamped no later than the one before it; the recording is damaged"
    ):
        parse_recording(repacked(stand_still), "x").to_run()
