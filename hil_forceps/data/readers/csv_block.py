"""The lines of a CSV file as numbers: a block at a time through numpy, cell by cell where that refuses."""

import csv
import io
import math
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.run import KNOWN_COLUMNS
from hil_forceps.rig.errors import UserError

Table = NDArray[np.float64]

_SHOWN = 40
_NUMBER = re.compile(r"[ \t]*[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?[ \t]*")


class Layout:
    """What the header says: names, where the columns of a run stand, and the marks between and inside numbers."""

    def __init__(self, names: tuple[str, ...], delimiter: str) -> None:
        self.names = names
        self.delimiter = delimiter
        self.positions = tuple(position for position, name in enumerate(names) if name in KNOWN_COLUMNS)
        self.known = tuple(names[position] for position in self.positions)
        self.has_decimal_comma = False  # seen so far


def parse_block(path: Path, line: int, text: str, layout: Layout) -> Table:
    """Return the rows [samples, columns of a run] of whole lines; `line` is the number of the line before them.

    UserError with line and column for the first cell that doesn't fit.
    """
    if layout.delimiter != "," and "," in text:
        _check_decimal_marks(path, line, text, layout)
        layout.has_decimal_comma = True
        text = text.replace(",", ".")
    table = _fast(text, layout)
    return _slow(path, line, text, layout) if table is None else table


def _fast(text: str, layout: Layout) -> Table | None:
    """Let numpy read plain numbers; None when anything is unusual: the slow way knows what."""
    if '"' in text or "#" in text or not _has_equal_lines(text, layout):
        return None
    try:
        table: Table = np.loadtxt(
            io.StringIO(text), delimiter=layout.delimiter, comments=None, ndmin=2, usecols=layout.positions
        )
    except ValueError:
        return None
    return table if np.all(np.isfinite(table)) else None


def _has_equal_lines(text: str, layout: Layout) -> bool:
    """Tell whether every line has the cells of the header; loadtxt doesn't mind when it uses some columns only."""
    try:
        characters = np.frombuffer(text.encode("ascii"), dtype=np.uint8)
    except UnicodeEncodeError:
        return False
    ends = np.flatnonzero(characters == ord("\n"))
    if not text.endswith("\n"):
        ends = np.append(ends, len(characters))
    marks = np.flatnonzero(characters == ord(layout.delimiter))
    return bool(np.all(np.diff(np.searchsorted(marks, ends), prepend=0) == len(layout.names) - 1))


def _slow(path: Path, line: int, text: str, layout: Layout) -> Table:
    reader = csv.reader(io.StringIO(text), delimiter=layout.delimiter, strict=True)
    try:
        rows = [
            _numbers(path, line + reader.line_num, cells, layout)
            for cells in reader
            if cells and (len(cells) > 1 or cells[0].strip()) and not cells[0].lstrip().startswith("#")
        ]
    except csv.Error as error:
        raise UserError(f"{path}:{line + reader.line_num}: not a CSV file: {error}") from error
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(layout.positions))


def finite_number(cell: str) -> float | None:
    """Return the number in a cell; None where there is none, or one that is not finite."""
    if _NUMBER.fullmatch(cell) is None:  # float() takes 1_000 and digits of other scripts, too
        return None
    number = float(cell)
    return number if math.isfinite(number) else None


def _numbers(path: Path, line: int, cells: list[str], layout: Layout) -> list[float]:
    names = layout.names
    if len(cells) != len(names):
        hint = ""
        if layout.delimiter == "," and len(cells) == 2 * len(names):
            hint = "; if commas are decimal marks, put semicolons between the cells"
        raise UserError(f"{path}:{line}: {len(cells)} cells where the header names {len(names)} columns{hint}")
    numbers = []
    for position in layout.positions:
        cell = cells[position]
        number = finite_number(cell)
        if number is None:
            where = f"{path}:{line}: column {position + 1} ({names[position]})"
            raise UserError(f"{where}: {cell.strip()[:_SHOWN]!r} is not a finite number; correct it or remove the line")
        numbers.append(number)
    return numbers


def _check_decimal_marks(path: Path, line: int, text: str, layout: Layout) -> None:
    """Refuse cells with both marks: 1.234,5 is one thing here and another there."""
    for offset, row in enumerate(text.split("\n"), start=1):
        if "," in row and "." in row and not row.lstrip().startswith("#"):
            for position, cell in enumerate(row.split(layout.delimiter), start=1):
                if "," in cell and "." in cell and position - 1 in layout.positions:
                    name = layout.names[position - 1]
                    where = f"{path}:{line + offset}: column {position} ({name})"
                    raise UserError(f"{where}: {cell.strip()[:_SHOWN]!r} has two decimal marks; write a plain number")
