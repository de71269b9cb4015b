"""Which column of a file is which of a run: `theta_m_rad=pos:deg`, or a YAML of such entries."""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from hil_forceps.data.run import KNOWN_COLUMNS
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.yaml_loader import MAX_FILE_BYTES, load_document, render

BESIDE = "columns.yaml"  # is taken for every table in its folder
LEFT_OUT = "none"


class Source(NamedTuple):
    """Where a column of a run comes from."""

    text: str  # COLUMN or COLUMN:UNIT; `none`: from nowhere, although the file has one of that name
    told_by: str  # an option, or a file with its line


ColumnMap = Mapping[str, Source]


def read_map(texts: Sequence[str]) -> dict[str, Source]:
    """Read what `--map` says: entries and names of YAML files, later ones before earlier; UserError otherwise."""
    found: dict[str, Source] = {}
    for text in texts:
        if "=" in text:
            name, _, source = text.partition("=")
            found |= {name.strip(): _source(name.strip(), source, f"--map {text}")}
        elif text.lower().endswith((".yaml", ".yml")):
            found |= load_map(Path(text))
        else:
            raise UserError(f"--map {text}: write NAME=COLUMN[:UNIT], as theta_m_rad=pos:deg, or name a .yaml file")
    return found


def load_map(path: Path) -> dict[str, Source]:
    """Read a YAML with an entry `theta_m_rad: pos:deg` for each column; UserError with the line otherwise."""
    try:
        with path.open("rb") as file:
            text = file.read(MAX_FILE_BYTES + 1).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: {getattr(error, 'strerror', None) or error}; give a YAML in UTF-8") from error
    if len(text) > MAX_FILE_BYTES:
        raise UserError(f"{path}: larger than {MAX_FILE_BYTES >> 10} KiB, so not a column map")
    document = load_document(text, str(path))
    if document.problems:
        raise UserError(render(str(path), document.problems))
    if not isinstance(document.data, dict) or not document.data:
        raise UserError(f"{path}:1: not a column map; write an entry for each column, as theta_m_rad: pos:deg")
    found = {}
    for name, value in document.data.items():
        place = f"{path}:{document.key_marks[(name,)].line}"
        if not isinstance(value, str):
            raise UserError(
                f"{place}: {name}: {value!r} is not a column; write COLUMN or COLUMN:UNIT, in quotes if necessary"
            )
        found[name] = _source(name, value, place)
    return found


def map_beside(path: Path) -> tuple[dict[str, Source], str]:
    """Return the mapping kept beside a file and a note on it; both empty where there is none."""
    kept = path.parent / BESIDE
    if not kept.is_file():
        return {}, ""
    return load_map(kept), f"columns were named by {kept}"


def entry(name: str, column: str, unit: str) -> str:
    """Write the option that maps a column, as a shell takes it."""
    return f"--map {shlex.quote(f'{name}={column}' + (f':{unit}' if unit else ''))}"


def yaml_of(used: Iterable[tuple[str, str, str]], proposed: Iterable[tuple[str, str, str]], source: str) -> str:
    """Write (name, column, unit) as a YAML that `--map` takes; what is proposed is a comment."""
    lines = [
        f"# Columns of {source!r}. Give it with --map, or keep it beside the data as {BESIDE}.",
        "# Each line: column of a run: column of the file:unit. Without a unit, the one that the file says.",
    ]
    lines += [_line(*each) for each in used]
    guessed = [f"# {_line(*each)}" for each in proposed]
    if guessed:
        lines += ["# Guesses by the names alone: correct them, then take the # away.", *guessed]
    return "\n".join(lines) + "\n"


def _line(name: str, column: str, unit: str) -> str:
    value = f"{column}:{unit}" if unit else column
    return f"{name}: '{value.replace(chr(39), chr(39) * 2)}'"


def _source(name: str, text: str, told_by: str) -> Source:
    if name not in KNOWN_COLUMNS:
        raise UserError(f"{told_by}: {name[:40]!r} is not a column of a run; use one of {', '.join(KNOWN_COLUMNS)}")
    if not text.strip():
        raise UserError(f"{told_by}: the column is missing; write NAME=COLUMN[:UNIT]")
    return Source(text.strip(), told_by)
