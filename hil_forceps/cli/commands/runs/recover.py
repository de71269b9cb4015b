"""`hil-forceps recover`: what a damaged recording still holds, and a sound one made of it."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from hil_forceps.bench.recovery.recording import Lost, Recovery, sound_file
from hil_forceps.bench.recovery.recording import recover as recover_recording
from hil_forceps.cli.arguments.files import bus_log_of, recording_of
from hil_forceps.cli.kernels import telling_when_compiling
from hil_forceps.rig.errors import UserError

EXIT_MISSING = 1
RECOVERED = "recovered"  # folder of what is made, in that of the recording


def recover(
    run: Path, *, out: Path | None = None, as_json: Annotated[bool, Parameter(name="--json", negative="")] = False
) -> int:
    """Say what a recording holds and what is missing; write a sound one of it, which every other command reads.

    Reads RUN/run.mcap and the bus log beside it, damaged or not, and changes neither. Samples that only the bus log has
    are put back (drives of the project's own protocol). Exit code 0 when nothing is missing, 1 when something is, 2
    when it is no recording.

    Parameters
    ----------
    run
        Folder of a run, or its recording.
    out
        File to write; without it RUN/recovered/run.mcap, and nothing where the recording is sound. Never overwritten.
    as_json
        The same as JSON.
    """
    path = recording_of(run)
    target = out or path.parent / RECOVERED / path.name
    with telling_when_compiling():
        found = recover_recording(path, bus_log_of(path))
    is_wanted = out is not None or not found.is_sound
    if is_wanted:
        _write(target, sound_file(found))
    written = target if is_wanted else None
    sys.stdout.write(json.dumps(_as_json(found, written), indent=2) if as_json else "\n".join(_lines(found, written)))
    sys.stdout.write("\n")
    return 0 if found.is_whole else EXIT_MISSING


def _write(path: Path, data: bytes) -> None:
    """Write a file; UserError where there is another one of that name, or it can't be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            file.write(data)
    except FileExistsError as error:
        if path.is_file() and path.read_bytes() == data:  # by the same command before
            return
        told = "is there already with other content and is not written over; name another file with --out"
        raise UserError(f"{path}: {told}, or remove it first") from error
    except OSError as error:
        raise UserError(f"{path}: can't be written: {error.strerror}; name another file with --out") from error


def _lines(found: Recovery, written: Path | None) -> Iterator[str]:
    rows = ", ".join(f"{count} in {topic}" for topic, count in found.rows.items())
    yield f"{found.name}: {found.size} bytes, {'sound' if found.is_sound else 'damaged'}"
    yield f"there: {rows}; {found.span_s[1]:.3f} s"
    if found.bus_log:
        yield f"beside it: {found.bus_log}"
    yield from (f"damage: bytes {each.begin} to {each.end - 1} can't be read" for each in found.damage)
    yield from (f"damage: {remark}" for remark in found.remarks)
    yield from (f"note: {note}" for note in found.notes)
    yield from (f"restored from the bus log: {_place(each)}" for each in found.restored)
    yield from (f"missing: {_place(each)}" for each in found.lost)
    if not found.has_end:
        yield "missing: how the run ended, and what of it came after the last message here"
    elif found.is_whole:
        yield "missing: nothing"
    if written is not None:
        yield f"written: {written}"


def _place(lost: Lost) -> str:
    begin = "the beginning" if lost.from_s is None else f"{lost.from_s:.3f} s"
    end = "the end" if lost.to_s is None else f"{lost.to_s:.3f} s"
    return f"{lost.topic} {lost.first} to {lost.last} ({lost.last - lost.first + 1}), between {begin} and {end}"


def _as_json(found: Recovery, written: Path | None) -> dict[str, Any]:
    return {
        "recording": found.name,
        "bytes": found.size,
        "sound": found.is_sound,
        "whole": found.is_whole,
        "rows": found.rows,
        "span_s": list(found.span_s),
        "bus_log": found.bus_log,
        "damage": [each._asdict() for each in found.damage],
        "remarks": list(found.remarks),
        "notes": found.notes,
        "restored": [each._asdict() for each in found.restored],
        "lost": [each._asdict() for each in found.lost],
        "has_end": found.has_end,
        "written": None if written is None else str(written),
    }
