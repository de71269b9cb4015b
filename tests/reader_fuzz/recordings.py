"""Recordings and `fault.json` for the fuzzers: damaged, and the checks of what comes out."""

import json
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from hil_forceps.bench.assembly import settings_of
from hil_forceps.bench.explanation.evidence import read_evidence
from hil_forceps.bench.explanation.story import story_of, text_of
from hil_forceps.bench.recovery.recording import recover, sound_file
from hil_forceps.data.recording.reader import parse_recording
from hil_forceps.rig.errors import UserError
from tests.reader_fuzz import sound_files
from tests.reader_fuzz.checks import PLACES, require, scratch, told_well
from tests.reader_fuzz.damage import Edit, edited, edits

RECORDS = sound_files.records(sound_files.recording(12))


def _recording(which: int, inside: list[Edit], outside: list[Edit]) -> bytes:
    at = which % len(RECORDS)
    damaged = [(opcode, edited(body, inside) if place == at else body) for place, (opcode, body) in enumerate(RECORDS)]
    return edited(sound_files.mcap(damaged), outside)


RECORDINGS = st.builds(_recording, PLACES, edits, st.just([]) | edits)


def check_recording(content: bytes) -> bool:
    """Read a recording as one, as a run, and the settings that it was made with."""
    try:
        recording = parse_recording(content, "r.mcap")
    except UserError as error:
        told_well(Path("r.mcap"), error)
        return False
    read = False
    for use in (recording.to_run, lambda: settings_of(recording)):
        try:
            use()
            read = True
        except UserError as error:
            told_well(Path("r.mcap"), error)
    return read


def check_salvage(content: bytes) -> bool:
    """What is salvaged makes a sound recording of the same messages."""
    path = scratch() / "damaged.mcap"
    path.write_bytes(content)
    try:
        found = recover(path, None)
    except UserError as error:
        told_well(path, error)
        return False
    again = parse_recording(sound_file(found), "r.mcap")
    require(len(again.order) == len(found.messages), f"{len(again.order)} of {len(found.messages)} messages")
    require(all(not note.startswith("recording is") for note in again.notes), f"notes {again.notes}")
    return True


FAULT = sound_files.fault()
STRANGE: tuple[Any, ...] = (None, True, -1, 1 << 70, 1e308, 0.5, "x", "\x1b[2J", [], [[]], {}, {"a": 1})


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Return every container with each of its keys."""
    keys = range(len(value)) if isinstance(value, list) else value if isinstance(value, dict) else ()
    return [place for key in keys for place in ((value, key), *_places(value[key]))]


def strange_fault(places: list[tuple[int, Any]]) -> bytes:
    """Put strange values in places of a `fault.json`."""
    content = json.loads(FAULT)
    for at, strange in places:
        found = _places(content)
        container, key = found[at % len(found)]
        container[key] = strange
    return json.dumps(content).encode()


def check_fault(content: bytes) -> bool:
    """The last second before a fault is told in lines, or refused."""
    path = scratch() / "fault.json"
    path.write_bytes(content)
    try:
        lines = list(text_of(story_of(read_evidence(path))))
    except UserError as error:
        told_well(path, error)
        return False
    require(all(line.isprintable() for line in lines), "a line that steers the terminal")
    return True
