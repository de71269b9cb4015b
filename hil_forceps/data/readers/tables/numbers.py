"""Lines of a table as numbers: by pyarrow's CSV reader; cell by cell where that refuses, to tell place and reason."""

import csv
import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.readers.tables.blocks import Block
from hil_forceps.data.readers.tables.cells import EMPTY, SPACE, finite_number, is_empty, is_skipped
from hil_forceps.rig.errors import UserError

Numbers = list[NDArray[np.float64]]  # a column each

_SHOWN_CHARACTERS = 40
_BLANKS = re.compile(rb"[ \t]+")
_AT_ENDS = re.compile(rb"(?m)^ | $")


class Sheet(NamedTuple):
    """How the lines of samples are laid out: the names of all cells, and which are wanted."""

    names: tuple[str, ...]
    positions: tuple[int, ...]
    delimiter: str
    has_quoted_commas: bool
    repeated: frozenset[bytes]  # lines, without their ends, that are no samples wherever they stand: names and units


class Parsed(NamedTuple):
    """The numbers of a block, NaN where a cell is empty, and what was seen in it."""

    columns: Numbers
    has_decimal_comma: bool
    repeated_headers: int


def parse_block(path: Path, block: Block, sheet: Sheet) -> Parsed:
    """Return the wanted columns; UserError with line and column for the first cell that doesn't fit."""
    text = block.text
    is_decimal_comma = sheet.has_quoted_commas
    if sheet.delimiter != "," and b"," in text:
        _check_decimal_marks(path, block, sheet)
        is_decimal_comma = True
        text = text.replace(b",", b".")
    if sheet.delimiter == SPACE:
        text = _AT_ENDS.sub(b"", _BLANKS.sub(b" ", text))
    samples, repeated = _samples(text, sheet)
    columns = _by_arrow(samples, sheet)
    if columns is None:
        columns = _by_cell(path, block.line, text, sheet)
    return Parsed(columns, is_decimal_comma, repeated)


def sample_lines(text: bytes, sheet: Sheet) -> Iterator[int]:
    """Yield the lines, counted from 1, that hold samples."""
    for number, line in enumerate(text.split(b"\n"), start=1):
        if not is_skipped(line.decode(errors="replace")) and line.strip() not in sheet.repeated:
            yield number


def _samples(text: bytes, sheet: Sheet) -> tuple[bytes, int]:
    """Take comments and repeated headers away; count these."""
    repeats = any(line in text for line in sheet.repeated)
    if b"#" not in text and not repeats:
        return text, 0
    lines = [line for line in text.split(b"\n") if not line.lstrip().startswith(b"#")]
    kept = [line for line in lines if line.strip() not in sheet.repeated]
    return b"\n".join(kept), len(lines) - len(kept)


def _by_arrow(text: bytes, sheet: Sheet) -> Numbers | None:
    """Let pyarrow read; None when anything is unusual: going cell by cell tells what."""
    if not text.strip():
        return [np.empty(0) for _ in sheet.positions]
    arrow: Any = importlib.import_module("pyarrow")
    arrow_csv: Any = importlib.import_module("pyarrow.csv")
    names = [str(at) for at in range(len(sheet.names))]
    wanted = [names[at] for at in sheet.positions]
    try:
        table = arrow_csv.read_csv(
            arrow.BufferReader(text),
            read_options=arrow_csv.ReadOptions(column_names=names),
            parse_options=arrow_csv.ParseOptions(delimiter=sheet.delimiter, newlines_in_values=b'"' in text),
            convert_options=arrow_csv.ConvertOptions(
                check_utf8=False,
                column_types=dict.fromkeys(wanted, arrow.float64()),
                include_columns=wanted,
                null_values=list(EMPTY),
                decimal_point="," if sheet.has_quoted_commas else ".",
            ),
        )
    except (arrow.ArrowException, ValueError):
        return None
    columns = [np.concatenate([_values(chunk) for chunk in table.column(name).chunks]) for name in wanted]
    return None if any(bool(np.any(np.isinf(values))) for values in columns) else columns


def _values(chunk: Any) -> NDArray[np.float64]:
    """Return an array of pyarrow, NaN where it is null; its own `to_numpy` loads pandas, which takes a second."""
    valid, data = chunk.buffers()
    span = slice(chunk.offset, chunk.offset + len(chunk))
    values = np.frombuffer(data, dtype=np.float64)[span]
    if valid is None:
        return values
    is_valid = np.unpackbits(np.frombuffer(valid, dtype=np.uint8), bitorder="little")[span]
    return np.where(is_valid, values, np.nan)


def _by_cell(path: Path, line: int, text: bytes, sheet: Sheet) -> Numbers:
    lines = text.decode("utf-8", errors="surrogateescape").split("\n")
    reader = csv.reader(iter(each + "\n" for each in lines), delimiter=sheet.delimiter, strict=True)
    repeated = {each.decode("utf-8", errors="surrogateescape") for each in sheet.repeated}
    rows = []
    try:
        while (cells := next(reader, None)) is not None:
            raw = lines[reader.line_num - 1] if reader.line_num <= len(lines) else ""
            if cells and not is_skipped(raw) and raw.strip() not in repeated:
                rows.append(_row(path, line + reader.line_num, cells, sheet))
    except csv.Error as error:
        raise UserError(f"{path}:{line + reader.line_num}: not a CSV file: {error}") from error
    table = np.array(rows, dtype=np.float64).reshape(len(rows), len(sheet.positions))
    return [np.ascontiguousarray(column) for column in table.T]


def _row(path: Path, line: int, cells: list[str], sheet: Sheet) -> list[float]:
    names = sheet.names
    if len(cells) != len(names):
        hint = ""
        if sheet.delimiter == "," and len(cells) == 2 * len(names):
            hint = "; if commas are decimal marks, put semicolons between the cells"
        raise UserError(f"{path}:{line}: {len(cells)} cells, but the header has {len(names)} columns{hint}")
    numbers = []
    for position in sheet.positions:
        cell = cells[position]
        if sheet.has_quoted_commas:
            cell = cell.replace(",", ".")
        number = float("nan") if is_empty(cell) else finite_number(cell)
        if number is None:
            raise UserError(_bad_cell(path, line, position, cell, sheet))
        numbers.append(number)
    return numbers


def _bad_cell(path: Path, line: int, position: int, cell: str, sheet: Sheet) -> str:
    foreign = next((ord(each) - 0xDC00 for each in cell if "\udc80" <= each <= "\udcff"), None)
    if foreign is not None:
        return f"{path}:{line}: not a text file (byte {foreign:#04x} is no UTF-8); save it as CSV in UTF-8"
    where = f"{path}:{line}: column {position + 1} ({sheet.names[position]})"
    return f"{where}: {cell.strip()[:_SHOWN_CHARACTERS]!r} is not a finite number; correct it or remove the line"


def _check_decimal_marks(path: Path, block: Block, sheet: Sheet) -> None:
    """Refuse cells with both marks: 1.234,5 is one thing here and another there."""
    if b"." not in block.text:
        return
    delimiter = sheet.delimiter
    for offset, row in enumerate(block.text.decode(errors="replace").split("\n"), start=1):
        if "," in row and "." in row and not row.lstrip().startswith("#"):
            for position, cell in enumerate(row.split() if delimiter == SPACE else row.split(delimiter)):
                if "," in cell and "." in cell and position in sheet.positions:
                    where = f"{path}:{block.line + offset}: column {position + 1} ({sheet.names[position]})"
                    raise UserError(
                        f"{where}: {cell.strip()[:_SHOWN_CHARACTERS]!r} has two decimal marks; write a plain number"
                    )
