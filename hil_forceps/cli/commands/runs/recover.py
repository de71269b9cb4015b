"""`hil-forceps recover`: what a damaged recording contains, and a valid recording written from it."""

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
RECOVERED = "recovered"  # folder for the result, in the folder of the recording


def recover(
    run: Path, *, out: Path | None = None, as_json: Annotated[bool, Parameter(name="--json", negative="")] = False
) -> int:
    """List what a recording contains and what is missing; write a valid recording from it for all other commands.

    Reads RUN/run.mcap and the bus log in the same folder, damaged or not, and changes neither. Samples that only the
    bus log contains are restored (only for drives with the project's own protocol). Exit code 0 if nothing is missing,
    1 if something is missing, 2 if the file is not a recording.

    Parameters
    ----------
    run
        Folder of a run, or its recording.
    out
        File to write; never overwritten. Default: RUN/recovered/run.mcap if the recording is damaged, else none.
    as_json
        Print the result as JSON.
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
    """Write a file; UserError if a file with other content exists, or if it can't be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            file.write(data)
    except FileExistsError as error:
        if path.is_file() and path.read_bytes() == data:  # by the same command before
            return
        told = "already exists with other content; remove it, or name another file with --out"
        raise UserError(f"{path}: {told}") from error
    except OSError as error:
        raise UserError(f"{path}: can't be written: {error.strerror}; name another file with --out") from error


def _lines(found: Recovery, written: Path | None) -> Iterator[str]:
    rows = ", ".join(f"{count} in {topic}" for topic, count in found.rows.items())
    yield f"{found.name}: {found.size} bytes, {'undamaged' if found.is_sound else 'damaged'}"
    yield f"readable: {rows}; {found.span_s[1]:.3f} s"
    if found.bus_log:
        yield f"bus log: {found.bus_log}"
    yield from (f"damage: bytes {each.begin} to {each.end - 1} can't be read" for each in found.damage)
    yield from (f"damage: {remark}" for remark in found.remarks)
    yield from (f"note: {note}" for note in found.notes)
    yield from (f"restored from the bus log: {_place(each)}" for each in found.restored)
    yield from (f"missing: {_place(each)}" for each in found.lost)
    if not found.has_end:
        yield "missing: the end of the run, after the last message in this recording"
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
