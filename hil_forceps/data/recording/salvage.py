"""All that can still be read of a recording, damaged or not: what stands behind the damage, too.

Where a record makes no sense the search goes on for the next one that does. Only chunks and attachments whose own
checksum is right are taken, so nothing is taken for data that isn't.
"""

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC

from hil_forceps.data.recording.container import (
    DAMAGE,
    MAX_RECORD_BYTES,
    MAX_UNPACKED_BYTES,
    Found,
    attachment_of,
    check_settings,
    chunk_at,
    collect,
    next_chunk,
    places,
    stream,
)
from hil_forceps.data.recording.format import (
    FAULT_NAME,
    MESSAGE_HEAD,
    METADATA_NAME,
    RECORD_HEAD,
    RESULT_NAME,
    SETTINGS_NAME,
    TOPICS,
    Topic,
)
from hil_forceps.data.recording.mcap_file import packed
from hil_forceps.rig.errors import UserError

_NAMES = {Opcode.METADATA: (METADATA_NAME, RESULT_NAME), Opcode.ATTACHMENT: (SETTINGS_NAME, FAULT_NAME)}
_NAME_AT = {Opcode.METADATA: RECORD_HEAD.size, Opcode.ATTACHMENT: RECORD_HEAD.size + 8 + 8}
_RECORDS: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.STATISTICS: Statistics,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.DATA_END: DataEnd,
}
_TIME_AT = MESSAGE_HEAD.size - 8 - 8 - 4  # of the log time, within a message record


class Damage(NamedTuple):
    """Bytes of the file that say nothing, up to `end`."""

    begin: int
    end: int


class Message(NamedTuple):
    """One message record, as it stands in a chunk."""

    channel: int
    number: int
    time_ns: int  # host's clock
    record: bytes


class Gap(NamedTuple):
    """Messages that are missing: their numbers, and the times of those before and behind (None at the ends)."""

    channel: int
    first: int
    last: int
    after_ns: int | None
    before_ns: int | None

    @property
    def missing(self) -> int:
        """How many are missing."""
        return self.last - self.first + 1


@dataclass(slots=True)
class Salvage:
    """What is there. `found` is what the reader makes of it, with what stands behind the damage added."""

    found: Found
    damage: list[Damage] = field(default_factory=list)

    @property
    def is_sound(self) -> bool:
        """Whether the file is as it was written, and was closed as it should."""
        return not (self.damage or self.found.damage or self.found.remarks)


def salvage(data: bytes, name: str) -> Salvage:
    """Return all that can be read; UserError where that is nothing, or of another format."""
    result = Salvage(collect(data, name) if data.startswith(MCAP0_MAGIC) else Found(damage="without a head"))
    found = result.found
    if not result.is_sound:
        found.chunks, room, at = [], MAX_UNPACKED_BYTES, 0
        while at < len(data):
            if data.startswith(MCAP0_MAGIC, at):
                at += len(MCAP0_MAGIC)
                continue
            placed = chunk_at(data, at, room)
            if placed is not None:
                found.chunks.append(placed.records)
                room -= len(placed.records)
                at = placed.end
                continue
            end = _other_record(data, at, found)
            if end is None:
                end = _next_record(data, at + 1, room, len(data))
                result.damage.append(Damage(at, end))
            at = end
        check_settings(found, name)
    if METADATA_NAME not in found.metadata and not found.chunks:
        raise UserError(f"{name}: not a recording of `run` or `bench`, or nothing of it is readable")
    return result


def all_messages(chunks: Iterable[bytes]) -> Iterator[Message]:
    """Yield the messages of the known topics, in the order of the file."""
    sizes = {topic.channel: topic.record.size for topic in TOPICS}
    for chunk in chunks:
        for channel, number, begin, end in places(chunk):
            if sizes.get(channel) == end - begin:
                record = chunk[begin:end]
                yield Message(channel, number, int.from_bytes(record[_TIME_AT : _TIME_AT + 8], "little"), record)


def gaps(found: Iterable[Message]) -> list[Gap]:
    """Return what the numbers show to be missing between the messages, and before the first."""
    last: dict[int, Message] = {}
    result = []
    for message in found:
        before = last.get(message.channel)
        expected = 0 if before is None else before.number + 1
        if message.number > expected:
            after_ns = None if before is None else before.time_ns
            result.append(Gap(message.channel, expected, message.number - 1, after_ns, message.time_ns))
        last[message.channel] = message
    return result


def topic_of(channel: int) -> Topic:
    """Return the topic of a channel; StopIteration for one that isn't known."""
    return next(topic for topic in TOPICS if topic.channel == channel)


def _other_record(data: bytes, at: int, found: Found) -> int | None:
    """Take a record that is no chunk; return where it ends, None where it makes no sense."""
    if at + RECORD_HEAD.size > len(data):
        return None
    opcode, length = RECORD_HEAD.unpack_from(data, at)
    end: int = at + RECORD_HEAD.size + length
    record = _parsed(opcode, data[at:end]) if length <= MAX_RECORD_BYTES and end <= len(data) else None
    if isinstance(record, Attachment):
        found.attachments.setdefault(record.name, bytes(record.data))
    elif record is None or _next_record(data, at + 1, MAX_RECORD_BYTES, end) < end:
        return None  # in the second case its length is damaged: another record begins within
    elif isinstance(record, Metadata):
        found.metadata.setdefault(record.name, record.metadata)
    return end


def _parsed(opcode: int, whole: bytes) -> McapRecord | None:
    """Return a record; None for one of no kind that is known, or that isn't what its lengths say."""
    body = whole[RECORD_HEAD.size :]
    try:
        if opcode == Opcode.ATTACHMENT:
            return attachment_of(body)
        record: McapRecord = _RECORDS[opcode].read(stream(body))
    except (KeyError, *DAMAGE):
        return None
    return record if packed([record]) == whole else None


def _next_record(data: bytes, at: int, room: int, stop: int) -> int:
    """Return where in [at, stop) a record begins that vouches for itself, or has a name that is known; else `stop`."""
    found = [stop]
    if (chunk := _next_chunk(data, at, stop, room)) is not None:
        found.append(chunk)
    for opcode, names in _NAMES.items():
        for name in names:
            text, before = struct.pack("<I", len(name)) + name.encode(), _NAME_AT[opcode]
            place = data.find(text, at + before, stop)
            while place >= 0 and data[place - before] != opcode:
                place = data.find(text, place + 1, stop)
            if place >= 0:
                found.append(place - before)
    return min(found)


def _next_chunk(data: bytes, at: int, stop: int, room: int) -> int | None:
    """Return where the next chunk within [at, stop) begins whose checksum is right."""
    place = next_chunk(data, at, stop)
    while place is not None and chunk_at(data, place, room) is None:
        place = next_chunk(data, place + 1, stop)
    return place
