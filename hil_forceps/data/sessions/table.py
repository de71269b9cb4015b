"""sessions.csv: what folders and names don't say of sessions, a line for one session or for several by a pattern."""

import csv
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

from hil_forceps.data.sessions.dates import parsed
from hil_forceps.rig.errors import UserError

COLUMNS = ("session", "instrument", "date", "rig")
MAX_FILE_BYTES = 16 << 20


class Row(NamedTuple):
    """One line."""

    line: int
    pattern: str  # path below the folder, with or without suffix; * and ? as a shell has them
    instrument: str
    date: str
    rig: str  # path below the folder

    def matches(self, path: str) -> bool:
        """Tell whether a log is meant, by its path below the folder."""
        stem = path.rpartition(".")[0]
        return any(fnmatchcase(each, self.pattern) for each in (path, stem, path.rpartition("/")[0]))


def read_table(path: Path) -> list[Row]:
    """Return the lines of a table, none where there is no file; UserError, a line for each problem."""
    if not path.is_file():
        return []
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise UserError(f"{path}: larger than {MAX_FILE_BYTES >> 20} MiB, so not a table of sessions")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: can't be read: {getattr(error, 'strerror', None) or 'no UTF-8'}") from error
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    try:
        cells = [(number, next(csv.reader([line]))) for number, line in lines]
    except (csv.Error, StopIteration) as error:
        raise UserError(f"{path}: not valid CSV: {error}") from error
    if not cells:
        return []
    header = [cell.strip() for cell in cells[0][1]]
    if "session" not in header or (unknown := [name for name in header if name not in COLUMNS]):
        wrong = "the column session is missing" if "session" not in header else f"column {unknown[0]!r} is unknown"
        raise UserError(f"{path}:{cells[0][0]}: {wrong}; the columns are {', '.join(COLUMNS)}")
    problems: list[str] = []
    rows = [row for number, each in cells[1:] if (row := _row(path, number, header, each, problems)) is not None]
    if problems:
        raise UserError(problems)
    return rows


def _row(path: Path, number: int, header: list[str], cells: list[str], problems: list[str]) -> Row | None:
    if len(cells) != len(header):
        problems.append(f"{path}:{number}: {len(cells)} cells, but {len(header)} columns; correct the line")
        return None
    told = dict(zip(header, (cell.strip() for cell in cells), strict=True))
    row = Row(number, *(told.get(name, "") for name in COLUMNS))
    if not row.pattern:
        problems.append(f"{path}:{number}: session is empty; enter the path of a log")
    if row.date:
        try:
            parsed(row.date, f"{path}:{number}: date {row.date!r}")
        except UserError as error:
            problems += error.problems
    if row.rig and not (path.parent / row.rig).is_file():
        problems.append(f"{path}:{number}: rig {row.rig}: no such file")
    return row
