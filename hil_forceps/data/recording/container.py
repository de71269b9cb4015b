"""The records of a recording's file, whole or damaged: what can be taken from each, and what its checksums say.

`collect` goes from front to end and stops at the first record that breaks the file's structure or is a damaged chunk:
what it gives is a prefix of what was written. Damage elsewhere is told and read over. `chunk_at` reads one chunk
wherever it stands; a chunk's own checksum vouches for its messages.
"""

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema, Statistics
from mcap.records import Chunk as ChunkRecord
from mcap.writer import MCAP0_MAGIC

from hil_forceps.data.recording.format import (
    COMPRESSION,
    FORMAT_VERSION,
    MESSAGE_ENCODING,
    MESSAGE_HEAD,
    MESSAGE_START,
    METADATA_NAME,
    RECORD_HEAD,
    SETTINGS_NAME,
    TOPICS,
)
from hil_forceps.data.strict_json import parse_json
from hil_forceps.rig.errors import UserError

MAX_RECORD_BYTES = 1 << 28  # a length above this is damage, not data
MAX_UNPACKED_BYTES = 2 << 30  # of all chunks: five hours at 1 kHz
# What a record that makes no sense raises; OverflowError for lengths beyond all memory.
DAMAGE = (McapError, ValueError, TypeError, OverflowError, struct.error, zstandard.ZstdError)
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, where the summary begins, no offsets, checksum of the summary
_CHUNK_BEGIN = struct.pack("<I", len(COMPRESSION)) + COMPRESSION.encode()
_CHUNK_BEGIN_AT = RECORD_HEAD.size + 8 + 8 + 8 + 4  # behind two times, the unpacked size and its checksum


@dataclass(slots=True)
class Found:
    """What a file holds. `damage` says where reading ended, or what is wrong with all of it; empty when all is well."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)  # those whose checksum is right
    chunks: list[bytes] = field(default_factory=list)
    damage: str = ""
    remarks: list[str] = field(default_factory=list)  # damage that was read over, a sentence each
    has_end: bool = False
    end: int = 0  # as far as it was read
    foreign: str = ""  # a topic whose description isn't the one known here
    counted: int | None = None  # messages, by the summary


class Placed(NamedTuple):
    """A chunk's messages, and where in the file it ends."""

    records: bytes
    end: int


def collect(data: bytes, name: str) -> Found:
    """Return what the bytes hold, from their beginning to the first damage; UserError where the format isn't known."""
    found = Found(end=len(MCAP0_MAGIC))
    schemas: dict[int, str] = {}
    room = MAX_UNPACKED_BYTES
    for opcode, start, end in records(data):
        found.end = end
        body = data[start:end]
        try:
            if opcode == Opcode.CHUNK:
                found.chunks.append(unpacked(ChunkRecord.read(stream(body)), room))
                room -= len(found.chunks[-1])
            elif opcode == Opcode.DATA_END:
                found.has_end = True
                _check_end(data, start - RECORD_HEAD.size, end, found)
                break
            else:
                _take(opcode, body, found, schemas)
        except DAMAGE as error:
            place = f"after {len(found.chunks)} chunks, in the record that ends at byte {end}"
            told = f"damaged {place}: {str(error) or type(error).__name__}"
            if opcode == Opcode.CHUNK:
                found.damage = told
                break
            found.remarks.append(f"recording is {told}")
    if not found.has_end and not found.damage:
        found.damage = f"cut off or damaged at byte {found.end} of {len(data)}: it has no end"
    check_settings(found, name)
    if found.foreign:
        _check_foreign(found, name)
    return found


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and end of the body of every whole record, until the data ends or makes no sense."""
    offset = 0 if not data.startswith(MCAP0_MAGIC) else len(MCAP0_MAGIC)
    while offset + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, offset)
        offset += RECORD_HEAD.size
        if length > MAX_RECORD_BYTES or offset + length > len(data):
            return
        yield opcode, offset, offset + length
        offset += length


def records_from(data: bytes, offset: int) -> Iterator[tuple[int, int, int]]:
    """Yield records as `records` does, from a place within the data on."""
    for opcode, start, end in records(data[offset:]):
        yield opcode, start + offset, end + offset


def places(chunk: bytes) -> Iterator[tuple[int, int, int, int]]:
    """Yield channel, sequence, begin of the record and end of every whole message of a chunk, as `records` does."""
    offset, end = 0, len(chunk)
    head, head_size = MESSAGE_START.unpack_from, MESSAGE_HEAD.size
    message = int(Opcode.MESSAGE)
    while offset + head_size <= end:
        opcode, length, channel, sequence = head(chunk, offset)
        after = offset + RECORD_HEAD.size + length
        if after > end:
            return
        if opcode == message:
            yield channel, sequence, offset, after
        offset = after


def next_chunk(data: bytes, at: int, stop: int) -> int | None:
    """Return where within [at, stop) a chunk may begin, by how it says that it is packed; None where none does."""
    place = data.find(_CHUNK_BEGIN, at + _CHUNK_BEGIN_AT, stop + _CHUNK_BEGIN_AT + len(_CHUNK_BEGIN) - 1)
    return None if place < 0 else place - _CHUNK_BEGIN_AT


def chunk_at(data: bytes, at: int, room: int) -> Placed | None:
    """Return the chunk that begins there; None where none does whose checksum is right."""
    if at + RECORD_HEAD.size > len(data):
        return None
    opcode, length = RECORD_HEAD.unpack_from(data, at)
    start = at + RECORD_HEAD.size
    if opcode != Opcode.CHUNK or length > MAX_RECORD_BYTES or start + length > len(data):
        return None
    try:
        chunk = ChunkRecord.read(stream(data[start : start + length]))
        return Placed(unpacked(chunk, room), start + length) if chunk.uncompressed_crc else None
    except DAMAGE:
        return None


def unpacked(chunk: ChunkRecord, room: int) -> bytes:
    """Return what a chunk holds; ValueError when it is more than `room`, or not what it says."""
    size = chunk.uncompressed_size
    if size > min(MAX_RECORD_BYTES, room):
        raise ValueError(f"a chunk of {size} bytes, {MAX_UNPACKED_BYTES >> 20} MiB are read of all")
    if chunk.compression == COMPRESSION:
        data = _inflated(chunk.data, size)
    elif not chunk.compression:
        data = chunk.data
    else:
        raise ValueError(f"a chunk packed by {chunk.compression[:20]!r}; recordings of the bench use {COMPRESSION}")
    if len(data) != size:
        raise ValueError(f"a chunk of {len(data)} bytes where it says {size}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("the checksum of a chunk is wrong")
    return data


def attachment_of(body: bytes) -> Attachment:
    """Return an attachment; ValueError where its checksum is wrong."""
    if zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
        raise ValueError("the checksum of an attachment is wrong")
    attachment: Attachment = Attachment.read(stream(body))
    return attachment


def settings_bytes(metadata: Mapping[str, str]) -> bytes:
    """Return the attachment that says once more what the metadata do."""
    return json.dumps({"format": FORMAT_VERSION, "metadata": dict(metadata)}).encode()


def _take(opcode: int, body: bytes, found: Found, schemas: dict[int, str]) -> None:
    if opcode == Opcode.METADATA:
        record = Metadata.read(stream(body))
        found.metadata[record.name] = record.metadata
    elif opcode == Opcode.ATTACHMENT:
        attachment = attachment_of(body)
        found.attachments[attachment.name] = bytes(attachment.data)
    elif opcode == Opcode.SCHEMA:
        schema = Schema.read(stream(body))
        schemas[schema.id] = schema.data.decode()
    elif opcode == Opcode.CHANNEL:
        found.foreign = found.foreign or _foreign(Channel.read(stream(body)), schemas)


def _foreign(channel: Channel, schemas: Mapping[int, str]) -> str:
    """Return the topic of a channel that isn't described as here; empty where it is, or is nobody's here."""
    for topic in TOPICS:
        if channel.topic != topic.topic:
            continue
        same = channel.id == topic.channel and channel.message_encoding == MESSAGE_ENCODING
        if not same or schemas.get(channel.schema_id) != topic.schema_text():
            return topic.topic
    return ""


def _check_foreign(found: Found, name: str) -> None:
    """UserError for another format; where the file itself vouches for this one, its description is damaged."""
    if SETTINGS_NAME not in found.attachments:
        raise UserError(f"{name}: {found.foreign} has another format; use the version of hil-forceps that recorded it")
    found.remarks.append(f"recording is damaged: the description of {found.foreign} was changed")


def check_settings(found: Found, name: str) -> None:
    """Take the metadata from the copy that has a checksum; say so where the record differs.

    UserError for another version of the format.
    """
    copy = found.attachments.get(SETTINGS_NAME)
    if copy is None:
        return
    try:
        content: Any = parse_json(copy.decode())
        version, said = content["format"], _texts(content["metadata"])
    except (KeyError, *DAMAGE) as error:
        found.remarks.append(f"the description in the recording is not valid: {error}")
        return
    if version != FORMAT_VERSION:
        raise UserError(
            f"{name}: has another format ({str(version)[:20]!r}); use the version of hil-forceps that recorded it"
        )
    if found.metadata.get(METADATA_NAME, said) != said:
        found.remarks.append("recording is damaged: its metadata were changed; the copy was read instead")
    found.metadata[METADATA_NAME] = said


def _texts(values: Any) -> dict[str, str]:
    if not isinstance(values, dict) or not all(isinstance(value, str) for value in values.values()):
        raise TypeError("metadata that are no texts")
    return values


def _check_end(data: bytes, data_end: int, end: int, found: Found) -> None:
    """Hold the bytes against the checksums over the data section and the summary; older recordings lack the first."""
    crc = int.from_bytes(data[end - 4 : end], "little")
    if end - data_end != RECORD_HEAD.size + 4:
        found.remarks.append(f"recording is damaged: the record at byte {data_end} has no checksum")
    elif crc and zlib.crc32(memoryview(data)[:data_end]) != crc:
        found.remarks.append(f"recording is damaged: the checksum of its first {data_end} bytes is wrong")
    after = end
    for opcode, start, stop in records_from(data, end):
        after = stop
        if opcode == Opcode.STATISTICS:
            try:
                found.counted = int(Statistics.read(stream(data[start:stop])).message_count)
            except DAMAGE:
                found.counted = None
        if opcode == Opcode.FOOTER:
            break
    if problem := _summary_problem(data, end, after):
        found.counted = None
        found.remarks.append(f"recording is damaged after its data, at byte {end} or later: {problem}")


def _summary_problem(data: bytes, begin: int, end: int) -> str:
    """Say what is wrong from the summary's begin to the file's end; `end`: of the footer."""
    at = end - _FOOTER.size
    if at < begin or data[at] != Opcode.FOOTER:
        return "it is cut off or has no footer"
    _, length, _, _, crc = _FOOTER.unpack_from(data, at)
    if length != _FOOTER.size - RECORD_HEAD.size:
        return "its footer has another length"
    if crc and zlib.crc32(memoryview(data)[begin : end - 4]) != crc:
        return "the checksum of its summary is wrong"
    if data[end:] != MCAP0_MAGIC:
        return "its end is not valid"
    return ""


def _inflated(packed: bytes, size: int) -> bytes:
    """Unpack one frame; the size in its own head is not believed, for memory is asked for by it."""
    if zstandard.frame_content_size(packed) not in {-1, size}:
        raise ValueError("a chunk whose two sizes differ")
    data: bytes = zstandard.decompress(packed, max_output_size=size)
    return data


def stream(body: bytes) -> ReadDataStream:
    """Return what the record classes of mcap read from."""
    return ReadDataStream(BytesIO(body))
