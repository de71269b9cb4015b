"""Runs as CSV: a header with the column names of `run.KNOWN_COLUMNS`, one sample a line, SI units."""

import codecs
import csv
from collections.abc import Callable, Iterator
from io import TextIOWrapper
from pathlib import Path
from typing import TextIO

import numpy as np

from hil_forceps.data.column_names import name_problems
from hil_forceps.data.readers.csv_block import Layout, parse_block
from hil_forceps.data.readers.cut_text import no_end_note, zero_bytes_note
from hil_forceps.data.readers.format import Format, NoRunError, Progress
from hil_forceps.data.run import KNOWN_COLUMNS, Column, Run, columns_problem
from hil_forceps.data.time_order import check_time_unit, drop_repeats
from hil_forceps.rig.errors import UserError

MAX_FILE_BYTES = 4 << 30  # an hour at 10 kHz with eight columns
MAX_SAMPLES = 50_000_000  # three arrays of these are in memory at a time for one of the columns
BLOCK_CHARACTERS = 1 << 22
LONGEST_LINE = 1 << 16


def read_csv(path: str | Path, progress: Progress | None = None) -> Run:
    """Read one run; columns of other names are left out and named in its notes.

    Between cells stand commas, semicolons or tabs; with semicolons or tabs the decimal mark may be a comma. A row
    that repeats the one before it in every column of a run is dropped and noted; so are a last line without an end, and
    what follows zero bytes. Raises UserError with file, line and column for whatever can't be used: no file, not text,
    no header, a column that is missing, there twice or in another unit, a cell that is not a finite number, a line too
    short or too long, time that does not increase or is hardly in seconds.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise UserError(f"{path}: larger than {MAX_FILE_BYTES >> 30} GiB; cut it, or record as .mcap or .parquet")
        with path.open("rb") as raw, TextIOWrapper(raw, encoding="utf-8-sig", newline=None) as file:
            return _read(path, file, lambda: progress and progress(raw.tell(), size))
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        line = _line_of_bad_byte(path)
        raise UserError(f"{path}:{line}: not a text file ({_not_utf8(error)}); save it as CSV in UTF-8") from error


def write_csv(run: Run, path: str | Path) -> None:
    """Write `run` so that `read_csv` gives the same numbers back, bit for bit; raises OSError as the disk does."""
    names = [name for name in KNOWN_COLUMNS if name in run.columns]
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        # tolist() makes Python floats, whose repr is the shortest text that reads back the same
        writer.writerows(zip(*(run.columns[name].tolist() for name in names), strict=True))


def _read(path: Path, file: TextIO, told: Callable[[], object]) -> Run:
    header_line, header = _header_line(path, file)
    layout, notes = _layout(path, header_line, header)
    parts: list[list[Column]] = [[] for _ in layout.positions]
    starts: list[tuple[int, int]] = []  # (first row, line before the block) of every block
    rows, line = 0, header_line
    for text in _blocks(path, file, header_line, notes):
        table = parse_block(path, line, text, layout)
        starts.append((rows, line))
        for part, column in zip(parts, table.T, strict=True):
            part.append(np.ascontiguousarray(column))
        rows += len(table)
        line += text.count("\n")
        if rows > MAX_SAMPLES:
            raise UserError(f"{path}:{line}: more than {MAX_SAMPLES} samples; cut the file")
        told()
    columns: dict[str, Column] = {}
    for name in layout.known:
        columns[name] = np.concatenate(parts[0]) if parts[0] else np.empty(0)
        del parts[0]  # else everything is in memory twice
    problem = columns_problem(columns)
    if problem:
        raise UserError(f"{path}:{header_line}: {'; '.join([problem, *notes])}")
    columns, more = drop_repeats(columns, str(path), lambda row: f"{path}:{_line_of(path, starts, row)}")
    check_time_unit(columns["time_s"], str(path))
    if layout.has_decimal_comma:
        notes.append("decimal commas were read as such")
    return Run(path.stem, columns, (*notes, *more))


def _header_line(path: Path, file: TextIO) -> tuple[int, str]:
    for number, text in enumerate(iter(lambda: file.readline(LONGEST_LINE), ""), start=1):
        if "\0" in text:
            raise UserError(f"{path}:{number}: not a text file (it holds zero bytes); export it as CSV in UTF-8")
        if text.strip() and not text.lstrip().startswith("#"):
            return number, text
    raise UserError(f"{path}:1: no header; the first line must name the columns ({', '.join(KNOWN_COLUMNS)})")


def _layout(path: Path, line: int, header: str) -> tuple[Layout, list[str]]:
    delimiter = ";" if ";" in header else "\t" if "\t" in header and "," not in header else ","
    try:
        names = [name.strip() for name in next(csv.reader([header], delimiter=delimiter, strict=True))]
    except csv.Error as error:
        raise UserError(f"{path}:{line}: not a CSV file: {error}") from error
    if names[-1] == "" and len(names) > 1:
        raise UserError(f"{path}:{line}: column {len(names)} has no name; remove the last {delimiter!r} of every line")
    errors, notes = name_problems(names)
    if errors and not any(name in KNOWN_COLUMNS for name in names):
        # Names in other units are told one by one; strangers only are probably no header at all.
        wrong = [error for error in errors if "unit of a run" in error]
        first = f"none of the columns of a run ({', '.join(KNOWN_COLUMNS)}) is in the first line"
        if not wrong:
            raise NoRunError(f"{path}:{line}: {first}")
        errors = wrong
    if errors:
        raise UserError([f"{path}:{line}: {error}" for error in errors])
    return Layout(tuple(names), delimiter), notes


def _blocks(path: Path, file: TextIO, line: int, notes: list[str]) -> Iterator[str]:
    """Yield the rest of the file in pieces that end where a line ends; a note where the file doesn't."""
    while text := file.read(BLOCK_CHARACTERS):
        tail = "" if text.endswith("\n") or "\0" in text else file.readline(LONGEST_LINE)
        if len(tail) == LONGEST_LINE and not tail.endswith("\n"):
            raise UserError(f"{path}: a line of more than {LONGEST_LINE} characters: not a CSV file")
        text += tail
        zero = text.find("\0")
        whole = text[: text.rfind("\n", 0, zero if zero >= 0 else len(text)) + 1]
        line += whole.count("\n")
        left = text[len(whole) :].strip()
        if left and not left.startswith("#"):
            notes.append(zero_bytes_note(line + 1) if zero >= 0 else no_end_note(line + 1))
        if whole:
            yield whole
        if zero >= 0:
            return


def _line_of(path: Path, starts: list[tuple[int, int]], row: int) -> int:
    """Find the line that a row stands on: read again, as it is needed for one message only."""
    first, line = [start for start in starts if start[0] <= row][-1]
    with path.open(encoding="utf-8-sig", newline=None) as file:
        for number, text in enumerate(file, start=1):
            if number > line and text.strip() and not text.lstrip().startswith("#"):
                if first == row:
                    return number
                first += 1
    return line


def _line_of_bad_byte(path: Path) -> int:
    """Find the line with the first byte that is no UTF-8: read again, as it is needed for one message only."""
    decoder = codecs.getincrementaldecoder("utf-8")()
    line = 1
    with path.open("rb") as file:
        for raw in iter(lambda: file.readline(LONGEST_LINE), b""):
            try:
                decoder.decode(raw)
            except UnicodeDecodeError:
                break
            line += raw.endswith(b"\n")
    return line


def _not_utf8(error: UnicodeDecodeError) -> str:
    if error.object[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "it looks like UTF-16"
    return f"byte {error.object[error.start]:#04x} is no UTF-8"


FORMAT = Format("CSV", (".csv",), lambda request: [read_csv(request.path, request.progress)])
