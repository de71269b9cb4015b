"""Runs as CSV: a header with the column names of `table.KNOWN_COLUMNS`, one sample a line, SI units."""

import csv
import difflib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np

from hil_forceps.rig.errors import UserError
from hil_forceps.runs.table import KNOWN_COLUMNS, Column, Run, bad_row, columns_problem

MAX_FILE_BYTES = 1 << 30  # an hour at 10 kHz with eight columns is about 4 GB as text: beyond this, use a recording


def read_csv(path: str | Path) -> Run:
    """Read one run; columns of other names are left out and named in its notes.

    Raises UserError with file, line and column for whatever can't be used: no file, not text, no header, a column
    that is missing or there twice, a cell that is not a finite number, a line too short or too long, time that does
    not increase.
    """
    path = Path(path)
    names, rows, lines = _cells(path)
    table = np.array(rows, dtype=np.float64).reshape(len(rows), len(names))
    columns: dict[str, Column] = {
        name: np.ascontiguousarray(table[:, position]) for position, name in enumerate(names) if name in KNOWN_COLUMNS
    }
    problem = columns_problem(columns)
    if problem:
        raise UserError(f"{path}:1: {problem}")
    row = bad_row(columns["time_s"], increasing=True)
    if row is not None:
        time_s = columns["time_s"]
        raise UserError(f"{path}:{lines[row]}: time_s: {time_s[row]:.9g} does not come after {time_s[row - 1]:.9g}")
    notes = tuple(_left_out(name) for name in names if name not in KNOWN_COLUMNS)
    return Run(path.stem, columns, notes)


def write_csv(run: Run, path: str | Path) -> None:
    """Write `run` so that `read_csv` gives the same numbers back, bit for bit; raises OSError as the disk does."""
    names = [name for name in KNOWN_COLUMNS if name in run.columns]
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        # tolist() makes Python floats, whose repr is the shortest text that reads back the same
        writer.writerows(zip(*(run.columns[name].tolist() for name in names), strict=True))


def _cells(path: Path) -> tuple[list[str], list[list[float]], list[int]]:
    lines: list[int] = []
    rows: list[list[float]] = []
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise UserError(f"{path}: larger than {MAX_FILE_BYTES >> 20} MiB")
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = _lines(file)
            _, header = next(reader, (1, []))
            names = _header(path, header)
            for line, cells in reader:
                lines.append(line)
                rows.append(_numbers(path, line, names, cells))
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not a text file (byte {error.start} is no UTF-8)") from error
    except csv.Error as error:
        raise UserError(f"{path}: not a CSV file: {error}") from error
    return names, rows, lines


def _lines(file: TextIO) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(file, strict=True)
    for cells in reader:
        if cells and not cells[0].lstrip().startswith("#"):
            yield reader.line_num, cells


def _header(path: Path, cells: list[str]) -> list[str]:
    names = [cell.strip() for cell in cells]
    if not names:
        raise UserError(f"{path}:1: no header; the first line must name the columns ({', '.join(KNOWN_COLUMNS)})")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise UserError(f"{path}:1: column {twice[0]!r} is there twice")
    if not any(name in KNOWN_COLUMNS for name in names):
        raise UserError(f"{path}:1: none of the columns of a run ({', '.join(KNOWN_COLUMNS)}) is in the first line")
    return names


def _numbers(path: Path, line: int, names: list[str], cells: list[str]) -> list[float]:
    if len(cells) != len(names):
        raise UserError(f"{path}:{line}: {len(cells)} cells where the header names {len(names)} columns")
    numbers = []
    for position, (name, cell) in enumerate(zip(names, cells, strict=True), start=1):
        try:
            number = float(cell)
        except ValueError:
            number = math.nan
        if name in KNOWN_COLUMNS and not math.isfinite(number):
            raise UserError(f"{path}:{line}: column {position} ({name}): {cell.strip()[:40]!r} is not a finite number")
        numbers.append(number)
    return numbers


def _left_out(name: str) -> str:
    near = difflib.get_close_matches(name, KNOWN_COLUMNS, n=1)
    return f"column {name!r} is not one of a run and was left out" + (f" (meant {near[0]}?)" if near else "")
