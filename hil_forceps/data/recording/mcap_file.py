"""The MCAP container around chunks that are already packed: head, chunks with their indexes, summary.

The mcap library's own Writer packs message by message (3 µs each, three to a tick); its record classes serve here for
all the rest, so the container is as it defines it.
"""

import sys
import zlib
from array import array
from collections.abc import Mapping, Sequence
from typing import IO, NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
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
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.records import Chunk as ChunkRecord
from mcap.writer import MCAP0_MAGIC

from hil_forceps.data.recording.format import COMPRESSION, MESSAGE_ENCODING, RECORD_HEAD, SCHEMA_ENCODING, Topic

LIBRARY = "hil_forceps"


class Chunk(NamedTuple):
    """Whole message records, and for each channel where they lie: log time and offset by turns."""

    records: bytes
    indexes: Mapping[int, "array[int]"]

    @property
    def messages(self) -> int:
        """How many messages it holds."""
        return sum(len(index) for index in self.indexes.values()) // 2


class McapFile:
    """One file being written. Every method may raise OSError; `good_bytes` then tells how much of the file is whole."""

    def __init__(self, stream: IO[bytes], topics: Sequence[Topic]) -> None:
        self._stream = stream
        self._topics = topics
        self._compressor = zstandard.ZstdCompressor(level=1)
        self._chunk_indexes: list[ChunkIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._attachment_indexes: list[AttachmentIndex] = []
        self._crc = 0  # of the good bytes
        self._counts = {topic.channel: 0 for topic in topics}
        self._first_ns: int | None = None
        self._last_ns = 0
        self.good_bytes = 0

    def start(self) -> None:
        """Write the head: what the topics are."""
        described = [record for topic in self._topics for record in _description(topic)]
        self._write(MCAP0_MAGIC + packed([Header(profile="", library=LIBRARY), *described]))

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        data, start = packed([Metadata(name=name, metadata=dict(values))]), self.good_bytes
        self._write(data)
        self._metadata_indexes.append(MetadataIndex(offset=start, length=len(data), name=name))

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment with its checksum; it has no time of its own."""
        record = packed([Attachment(log_time=0, create_time=0, name=name, media_type=media_type, data=data)])
        start = self.good_bytes
        self._write(record)
        self._attachment_indexes.append(
            AttachmentIndex(
                offset=start,
                length=len(record),
                log_time=0,
                create_time=0,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def chunk(self, chunk: Chunk) -> None:
        """Write one chunk with the index of its messages."""
        times = np.concatenate([np.frombuffer(index, dtype=np.uint64)[::2] for index in chunk.indexes.values()])
        first_ns, last_ns = int(times.min()), int(times.max())
        compressed = self._compressor.compress(chunk.records)
        record = ChunkRecord(
            compression=COMPRESSION,
            data=compressed,
            message_start_time=first_ns,
            message_end_time=last_ns,
            uncompressed_crc=zlib.crc32(chunk.records),
            uncompressed_size=len(chunk.records),
        )
        data = packed([record])
        start, offsets, parts = self.good_bytes, {}, [data]
        position = start + len(data)
        for channel, index in chunk.indexes.items():
            if index:
                offsets[channel] = position
                parts.append(_message_index(channel, index))
                position += len(parts[-1])
        self._write(b"".join(parts))
        for channel, index in chunk.indexes.items():
            self._counts[channel] += len(index) // 2
        self._first_ns = first_ns if self._first_ns is None else min(self._first_ns, first_ns)
        self._last_ns = max(self._last_ns, last_ns)
        self._chunk_indexes.append(
            ChunkIndex(
                chunk_length=len(data),
                chunk_start_offset=start,
                compression=COMPRESSION,
                compressed_size=len(compressed),
                message_end_time=last_ns,
                message_index_length=position - start - len(data),
                message_index_offsets=offsets,
                message_start_time=first_ns,
                uncompressed_size=len(chunk.records),
            )
        )

    def finish(self) -> None:
        """Write the summary that lets a reader jump; without it a file is still readable from front to end."""
        data_end = packed([DataEnd(data_section_crc=self._crc)])
        described = [record for topic in self._topics for record in _description(topic)]
        statistics = Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._topics),
            channel_message_counts={channel: count for channel, count in self._counts.items() if count},
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self._counts.values()),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns or 0,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._topics),
        )
        summary = packed(
            [*described, statistics, *self._chunk_indexes, *self._metadata_indexes, *self._attachment_indexes]
        )
        start = self.good_bytes + len(data_end)
        # the CRC of the summary covers the footer up to the CRC itself
        crc = zlib.crc32(summary)
        crc = zlib.crc32(RECORD_HEAD.pack(Opcode.FOOTER, 20) + start.to_bytes(8, "little") + bytes(8), crc)
        footer = packed([Footer(summary_start=start, summary_offset_start=0, summary_crc=crc)])
        self._write(data_end + summary + footer + MCAP0_MAGIC)

    def cut_back(self) -> None:
        """Drop what a failed write left behind the last whole record; a stream that can't be cut is left as it is."""
        if self._stream.seekable():
            self._stream.seek(self.good_bytes)
            self._stream.truncate()

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            written = self._stream.write(view)  # an unbuffered file may take a part, or (full pipe) nothing
            if not written:
                raise BlockingIOError("the file takes no more data")
            view = view[written:]
        self.good_bytes += len(data)
        self._crc = zlib.crc32(data, self._crc)


def packed(records: Sequence[McapRecord]) -> bytes:
    """Return records as they stand in a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _description(topic: Topic) -> tuple[Schema, Channel]:
    schema = Schema(id=topic.channel, name=topic.schema, encoding=SCHEMA_ENCODING, data=topic.schema_text().encode())
    channel = Channel(
        id=topic.channel,
        topic=topic.topic,
        message_encoding=MESSAGE_ENCODING,
        schema_id=topic.channel,
        metadata={},
    )
    return schema, channel


def _message_index(channel: int, index: "array[int]") -> bytes:
    if sys.byteorder == "big":
        index = index[:]
        index.byteswap()
    entries = index.tobytes()
    head = RECORD_HEAD.pack(Opcode.MESSAGE_INDEX, 2 + 4 + len(entries))
    return head + channel.to_bytes(2, "little") + len(entries).to_bytes(4, "little") + entries
