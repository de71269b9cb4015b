"""Recovery of a damaged recording from its readable parts and its bus log.

Lost references are not restored: the log does not contain the clock that the gate read.
"""

import json
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil_forceps.bench.recovery.restored_samples import samples_of_log, still_missing
from hil_forceps.data.recording.container import settings_bytes
from hil_forceps.data.recording.format import (
    FAULT_NAME,
    JSON_TYPE,
    METADATA_NAME,
    RECOVERY_NAME,
    RESULT_NAME,
    SAMPLE,
    SETTINGS_NAME,
    TOPICS,
)
from hil_forceps.data.recording.mcap_file import Chunk, McapFile
from hil_forceps.data.recording.reader import Recording, Tables, tables_of
from hil_forceps.data.recording.salvage import Damage, Gap, Message, Salvage, all_messages, gaps, salvage
from hil_forceps.data.recording.writer import CHUNK_BYTES, Outcome
from hil_forceps.rig.errors import UserError


class Lost(NamedTuple):
    """Missing messages by number and time in s since the first readable message; None at the beginning or the end."""

    topic: str
    first: int
    last: int
    from_s: float | None
    to_s: float | None


@dataclass(slots=True)
class Recovery:
    """What is readable, what is missing, and the content of a valid recording."""

    name: str
    size: int
    is_sound: bool
    damage: Sequence[Damage]
    remarks: Sequence[str]
    has_end: bool  # the end of the run is recorded
    rows: dict[str, int]
    span_s: tuple[float, float]
    began_ns: int
    lost: list[Lost] = field(default_factory=list)
    restored: list[Lost] = field(default_factory=list)  # restored from the bus log
    bus_log: str = ""  # its content in words; empty without a log
    notes: list[str] = field(default_factory=list)
    messages: list[Message] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)

    @property
    def is_whole(self) -> bool:
        """Whether nothing is missing, or everything was restored."""
        return not self.lost and self.has_end

    @property
    def summary(self) -> str:
        """What is missing, in a few words."""
        restored = sum(each.last - each.first + 1 for each in self.restored)
        told = [f"{restored} samples restored from the bus log"] if restored else []
        missing = sum(each.last - each.first + 1 for each in self.lost)
        if missing:
            told.append(f"{missing} messages are missing")
        if not self.has_end:
            told.append("its end is missing")
        return ", ".join(told) or "nothing is missing"


def recover(path: Path, bus_log: Path | None) -> Recovery:
    """Return the readable content; UserError if the file is not a recording. Nothing is written."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: can't be read: {error.strerror}") from error
    found = salvage(data, str(path))
    messages = list(all_messages(found.found.chunks))
    missing = gaps(messages)
    result = _begun(path, len(data), found, messages)
    result.messages, left = messages, missing
    if bus_log is not None:
        left = _with_log(result, bus_log, tables_of(found.found.chunks), missing)
    result.lost = [_lost(result, gap) for gap in left]
    result.metadata.setdefault(METADATA_NAME, {})
    result.metadata[RECOVERY_NAME] = {
        "summary": result.summary,
        "lost": json.dumps([each._asdict() for each in result.lost]),
        "restored": json.dumps([each._asdict() for each in result.restored]),
        "damage": json.dumps([each._asdict() for each in result.damage]),
    }
    return result


def sound_file(result: Recovery) -> bytes:
    """Return a valid recording of all readable messages, with checksums, summary and the recorded message numbers."""
    stream = BytesIO()
    file = McapFile(stream, TOPICS)
    file.start()
    file.metadata(METADATA_NAME, result.metadata[METADATA_NAME])
    file.attachment(SETTINGS_NAME, JSON_TYPE, settings_bytes(result.metadata[METADATA_NAME]))
    for chunk in _chunks(result.messages):
        file.chunk(chunk)
    if FAULT_NAME in result.attachments:
        file.attachment(FAULT_NAME, JSON_TYPE, result.attachments[FAULT_NAME])
    for name in (RECOVERY_NAME, RESULT_NAME):
        if name in result.metadata:
            file.metadata(name, result.metadata[name])
    file.finish()
    return stream.getvalue()


def _chunks(messages: Sequence[Message]) -> Iterator[Chunk]:
    records, indexes = bytearray(), _empty_indexes()
    for message in messages:
        if len(records) + len(message.record) > CHUNK_BYTES:
            yield Chunk(bytes(records), indexes)
            records, indexes = bytearray(), _empty_indexes()
        indexes[message.channel].extend((message.time_ns, len(records)))
        records += message.record
    if records:
        yield Chunk(bytes(records), indexes)


def _empty_indexes() -> Mapping[int, "array[int]"]:
    return {topic.channel: array("Q") for topic in TOPICS}


def _with_log(result: Recovery, path: Path, tables: Tables, missing: Sequence[Gap]) -> list[Gap]:
    """Add samples from the bus log; return the remaining gaps."""
    empty = tables.samples[:0]
    metadata = result.metadata.get(METADATA_NAME, {})
    recording = Recording(result.name, metadata, {}, tables.samples, empty, empty, tables.order, ())
    found = samples_of_log(path, recording, missing, has_end=result.has_end)
    result.bus_log = f"{path.name}: {found.holds}, {found.references} references sent" if found.holds else ""
    result.notes += found.notes
    lacking = found.references - int(np.count_nonzero(tables.references["outcome"] == Outcome.SENT))
    if found.holds and lacking > 0:
        result.notes.append(
            f"{path.name} has {lacking} sent references that the recording does not contain; they stay missing"
        )
    result.restored = [_lost(result, gap) for gap in found.gaps]
    result.messages = list(_merged(result.messages, found.messages))
    return still_missing(missing, found.gaps)


def _begun(path: Path, size: int, found: Salvage, messages: Sequence[Message]) -> Recovery:
    times = [message.time_ns for message in messages]
    began_ns, ended_ns = (min(times), max(times)) if times else (0, 0)
    what = found.found
    remarks = [f"recording is {what.damage}", *what.remarks] if what.damage else list(what.remarks)
    rows = {topic.topic: sum(message.channel == topic.channel for message in messages) for topic in TOPICS}
    return Recovery(
        name=path.name,
        size=size,
        is_sound=found.is_sound,
        damage=found.damage,
        remarks=remarks,
        has_end=RESULT_NAME in what.metadata,
        rows=rows,
        span_s=(0.0, (ended_ns - began_ns) / 1e9),
        began_ns=began_ns,
        metadata=dict(what.metadata),
        attachments=dict(what.attachments),
    )


def _merged(messages: Sequence[Message], restored: Sequence[Message]) -> Iterator[Message]:
    """Yield all messages in the order of the file, restored samples before the next recorded sample."""
    rest = sorted(restored, key=lambda message: message.number)
    at = 0
    for message in messages:
        while message.channel == SAMPLE.channel and at < len(rest) and rest[at].number < message.number:
            yield rest[at]
            at += 1
        yield message
    yield from rest[at:]


def _lost(result: Recovery, gap: Gap) -> Lost:
    topic = next(topic.topic for topic in TOPICS if topic.channel == gap.channel)
    times = [None if time is None else (time - result.began_ns) / 1e9 for time in (gap.after_ns, gap.before_ns)]
    return Lost(topic, gap.first, gap.last, *times)
