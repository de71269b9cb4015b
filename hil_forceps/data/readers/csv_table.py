"""Runs as text: the project's own CSV (`run.KNOWN_COLUMNS`, one sample a line, SI units), and others' tables."""

import csv
from pathlib import Path

from hil_forceps.data.readers.format import Format, Progress, Request
from hil_forceps.data.readers.tables.columns import OnColumns
from hil_forceps.data.readers.tables.mapping import ColumnMap, map_beside
from hil_forceps.data.readers.tables.text_table import read_text_table
from hil_forceps.data.run import KNOWN_COLUMNS, Run
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError


def read_csv(
    path: str | Path,
    progress: Progress | None = None,
    rig: Rig | None = None,
    mapping: ColumnMap | None = None,
    on_columns: OnColumns | None = None,
) -> Run:
    """Read one run; columns of other names are left out and named in its notes.

    docs/measured-data.md says what is taken. A row that repeats the one before it in every column of a run is dropped
    and noted; so are rows with empty cells, a last line without an end, and what follows zero bytes. Raises UserError
    with file, line and column for whatever can't be used: no file, not text, no header, a column that is missing or
    there twice, a cell that is not a finite number, a line too short or too long, time that does not increase or is
    hardly in seconds.
    """
    path = Path(path)
    kept, note = map_beside(path)
    try:
        run = read_text_table(path, progress, rig, {**kept, **(mapping or {})}, on_columns)
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}") from error
    return Run(run.name, run.columns, (*run.notes, note)) if note else run


def write_csv(run: Run, path: str | Path) -> None:
    """Write `run` so that `read_csv` gives the same numbers back, bit for bit; raises OSError as the disk does."""
    names = [name for name in KNOWN_COLUMNS if name in run.columns]
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        # tolist() makes Python floats, whose repr is the shortest text that reads back the same
        writer.writerows(zip(*(run.columns[name].tolist() for name in names), strict=True))


def _read(request: Request) -> list[Run]:
    return [read_csv(request.path, request.progress, request.rig, request.mapping, request.on_columns)]


FORMAT = Format("CSV", (".csv", ".tsv", ".lvm"), _read, is_table=True, may_be_packed=True)
