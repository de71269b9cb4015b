"""Excel workbooks (.xlsx, .xlsm) through openpyxl: each sheet with a table in it is one."""

import importlib
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from hil_forceps.data.readers.containers.content import Array, ContentError, Table
from hil_forceps.data.readers.tables.blocks import MAX_FOOTER_LINES
from hil_forceps.data.readers.tables.cells import finite_number, is_empty
from hil_forceps.data.readers.tables.row_layout import find_rows

_MAX_UNPACKED_BYTES = 1 << 30
_MAX_SHEETS = 100
_MAX_ROWS = 1 << 20  # of a sheet, in Excel
_MAX_CELLS = 256  # of a row, that are looked at
_HEAD_ROWS = 200
_ERRORS = frozenset(("#N/A", "#DIV/0!", "#VALUE!", "#NUM!", "#NULL!", "#REF!", "#NAME?"))


def tables(path: Path) -> list[Table]:
    """Return a table for each sheet that has one."""
    with zipfile.ZipFile(path) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > _MAX_UNPACKED_BYTES:
        raise ContentError(f"more than {_MAX_UNPACKED_BYTES >> 20} MiB when unpacked; save it as CSV")
    openpyxl: Any = importlib.import_module("openpyxl")
    book = openpyxl.load_workbook(path.open("rb"), read_only=True, data_only=True, keep_links=False)
    found = [table for sheet in book.worksheets[:_MAX_SHEETS] if (table := _table(sheet)) is not None]
    if not found:
        raise ContentError("none of its sheets contains a table; put the names of the columns above the numbers")
    return found


def _rows(sheet: Any) -> Iterator[tuple[Any, ...]]:
    sheet.reset_dimensions()  # what the file says of its size may be wrong
    for number, row in enumerate(sheet.iter_rows(values_only=True, max_col=_MAX_CELLS), start=1):
        if number > _MAX_ROWS:
            raise ContentError(f"sheet {sheet.title!r}: more than {_MAX_ROWS} rows")
        yield tuple(row)


def _table(sheet: Any) -> Table | None:
    head = [tuple("" if cell is None else str(cell) for cell in row) for row in islice(_rows(sheet), _HEAD_ROWS)]
    width = max((at + 1 for row in head for at, cell in enumerate(row) if cell.strip()), default=0)
    layout = find_rows([(*row[:width], *[""] * (width - len(row))) for row in head], frozenset())
    if layout is None or len(layout.names) < 2:
        return None
    first = layout.first_sample

    def get(positions: Sequence[int], base: int | None) -> list[Array]:
        del base
        return _numbers(sheet.title, _rows(sheet), positions, first)

    notes = []
    if layout.names_row < 0:
        notes.append("the columns have no names: #1 is the first")
    if layout.names_row > 0:
        notes.append(f"row{'s 1 to' if layout.names_row > 1 else ''} {layout.names_row} above the table: left out")
    if layout.units_row >= 0:
        notes.append(f"row {layout.units_row + 1} was read as units")
    return Table(sheet.title, layout.names, layout.units, get, first_row=first + 1, notes=tuple(notes))


def _numbers(sheet: str, rows: Iterable[tuple[Any, ...]], positions: Sequence[int], first: int) -> list[Array]:
    """Return the columns; rows behind the last sample that hold no number are left out, elsewhere a text is refused."""
    found: list[list[float]] = []
    strange: tuple[int, str] | None = None
    behind = 0
    for number, row in enumerate(islice(rows, first, None), start=first + 1):
        cells = [row[at] if at < len(row) else None for at in positions]
        numbers = [_number(cell) for cell in cells]
        bad = next((str(cell) for cell, value in zip(cells, numbers, strict=True) if value is None), None)
        if strange is not None or bad is not None:
            is_footer = all(value is None or np.isnan(value) for value in numbers)
            strange = strange or (number, bad or "")
            behind += 1
            if not is_footer or behind > MAX_FOOTER_LINES:
                told = f"{strange[1][:40]!r} is not a finite number; correct it or remove the row"
                raise ContentError(f"sheet {sheet!r}, row {strange[0]}: {told}")
            continue
        found.append([float("nan") if value is None else value for value in numbers])
    while found and all(np.isnan(found[-1])):
        found.pop()
    return [np.array(column, dtype=np.float64) for column in zip(*found, strict=True)] or [
        np.empty(0) for _ in positions
    ]


def _number(cell: Any) -> float | None:
    """Return the number in a cell, NaN where it is empty; None where it is something else."""
    if isinstance(cell, bool):
        return None
    if isinstance(cell, int | float):
        return float(cell)
    text = "" if cell is None else str(cell)
    return float("nan") if is_empty(text) or text in _ERRORS else finite_number(text)
