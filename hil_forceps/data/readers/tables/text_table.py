"""Tables as text, of any layout: the layout from the first lines, the numbers in blocks."""

from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil_forceps.data.readers.format import Progress
from hil_forceps.data.readers.tables.assemble import MAX_SAMPLES, assemble
from hil_forceps.data.readers.tables.blocks import Block, whole_blocks, without_footer
from hil_forceps.data.readers.tables.cells import MAX_LINE_CHARACTERS, is_skipped, split_line
from hil_forceps.data.readers.tables.columns import Header, OnColumns, Use, choose_columns, require_columns
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.data.readers.tables.numbers import Numbers, Sheet, parse_block, sample_lines
from hil_forceps.data.readers.tables.packed import path_stem, text_pieces
from hil_forceps.data.readers.tables.text_layout import TextLayout, find_layout
from hil_forceps.data.run import KNOWN_COLUMNS, Column, Run
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

_HEAD_BYTES = 1 << 20
_HEAD_LINES = 2000


class Opened(NamedTuple):
    """What the first lines of a text say, and the blocks, these lines among them."""

    layout: TextLayout
    header: Header
    repeated: frozenset[bytes]
    blocks: Iterator[Block]


def read_text_table(
    path: Path, progress: Progress | None, rig: Rig | None, mapping: ColumnMap, on_columns: OnColumns | None = None
) -> Run:
    """Read one run; UserError with file, line and column for whatever can't be used; OSError as the disk does."""
    size = path.stat().st_size
    notes: list[str] = []
    opened = open_text(path, mapping, notes, progress and (lambda done: progress(done, size)))
    found = choose_columns(opened.header, mapping)
    if on_columns is not None:
        on_columns(opened.header, found)
    require_columns(found, opened.header, mapped=bool(mapping))
    layout = opened.layout
    sheet = Sheet(
        layout.names,
        tuple(use.position for use in found.uses),
        layout.delimiter,
        layout.has_quoted_commas,
        opened.repeated,
    )
    notes += layout.notes
    columns = _columns(path, opened, found.uses, sheet, notes)
    if len(columns["time_s"]) < 2:
        few = f"{len(columns['time_s'])} samples are too few: at least 2 are needed"
        raise UserError(f"{path}:{max(layout.names_line, 1)}: {'; '.join([few, *notes])}")
    run = assemble(
        path, path_stem(path), columns, found.uses, rig, lambda row: f"{path}:{_line_of(path, opened, sheet, row)}"
    )
    return Run(run.name, run.columns, (*found.notes, *notes, *run.notes))


def open_text(path: Path, mapping: ColumnMap, notes: list[str], told: Callable[[int], object] | None = None) -> Opened:
    """Read the first lines and find the layout; UserError where there is none."""
    pieces = text_pieces(path, notes, told or (lambda _: None))
    blocks = whole_blocks(path, pieces, notes)
    first = next(blocks, Block(b"", 0, is_last=True))
    if not first.text:
        told_end = "; ".join(notes) or "it is empty"
        raise UserError(f"{path}:1: no header and no complete line: {told_end}; export it as CSV in UTF-8")
    lines, is_windows = _head_lines(path, first)
    if is_windows:
        notes.append("names and units are not UTF-8, and were read as Windows-1252")
    wanted = frozenset(
        each for source in mapping.values() for each in (source.text, source.text.rpartition(":")[0]) if each
    )
    layout = find_layout(lines, wanted) or _first_line_as_names(path, lines)
    raw = first.text.split(b"\n", len(lines))
    places = {layout.names_line, layout.units_line} - {0}
    repeated = frozenset(raw[at - 1].strip() for at in places if at <= len(raw)) - {b""}
    header = Header(layout.names, layout.units, f"{path}:{max(layout.names_line, 1)}")
    return Opened(layout, header, repeated, _samples_only(first, layout.first_line, blocks))


def _head_lines(path: Path, first: Block) -> tuple[list[str], bool]:
    """Return the first lines, and whether they aren't UTF-8."""
    raw = first.text[:_HEAD_BYTES].split(b"\n")[:_HEAD_LINES]
    if len(first.text) > _HEAD_BYTES or raw[-1] == b"":
        raw = raw[:-1] or raw
    if max(map(len, raw)) > MAX_LINE_CHARACTERS:
        raise UserError(f"{path}: a line of more than {MAX_LINE_CHARACTERS} characters: not a CSV file")
    try:
        return [line.decode() for line in raw], False
    except UnicodeDecodeError:
        return [line.decode("cp1252", errors="replace") for line in raw], True


def _first_line_as_names(path: Path, lines: list[str]) -> TextLayout:
    """Take the first line for the names where no table is seen: then what is missing is told."""
    at = next((at for at, line in enumerate(lines) if not is_skipped(line)), None)
    if at is None:
        raise UserError(f"{path}:1: no header; the first line must name the columns ({', '.join(KNOWN_COLUMNS)})")
    line = lines[at]
    delimiter = ";" if ";" in line else "\t" if "\t" in line and "," not in line else ","
    names = tuple(name.strip() for name in split_line(line, delimiter))
    return TextLayout(names, (), delimiter, at + 1, 0, at + 2)


def _samples_only(first: Block, first_line: int, rest: Iterator[Block]) -> Iterator[Block]:
    """Yield the blocks from the first sample on."""
    text = first.text
    before = text.split(b"\n", first_line - 1)[:-1] if first_line <= text.count(b"\n") else text.split(b"\n")[:-1]
    begin = sum(len(line) + 1 for line in before)
    return chain((Block(text[begin:], len(before), first.is_last),), rest)


def _columns(path: Path, opened: Opened, uses: list[Use], sheet: Sheet, notes: list[str]) -> dict[str, Column]:
    parts: list[Numbers] = [[] for _ in uses]
    rows = repeated = 0
    has_decimal_comma = False
    for whole in opened.blocks:
        block = without_footer(whole, sheet.delimiter, len(sheet.names), sheet.positions, notes)
        parsed = parse_block(path, block, sheet)
        for part, column in zip(parts, parsed.columns, strict=True):
            part.append(column)
        rows += len(parsed.columns[0])
        repeated += parsed.repeated_headers
        has_decimal_comma |= parsed.has_decimal_comma
        if rows > MAX_SAMPLES:
            raise UserError(f"{path}:{block.line}: more than {MAX_SAMPLES} samples; cut the file")
    if has_decimal_comma:
        notes.append("decimal commas were converted")
    if repeated:
        notes.append(f"{repeated} line{'s' if repeated > 1 else ''} with the header again: left out")
    columns = {}
    for use in uses:
        columns[use.name] = np.concatenate(parts[0]) if parts[0] else np.empty(0)
        del parts[0]  # else everything is in memory twice
    return columns


def _line_of(path: Path, opened: Opened, sheet: Sheet, row: int) -> int:
    """Find the line that a row stands on: read again, as it is needed for one message only."""
    seen = 0
    for block in whole_blocks(path, text_pieces(path, []), []):
        for number in sample_lines(block.text, sheet):
            if block.line + number >= opened.layout.first_line:
                if seen == row:
                    return block.line + number
                seen += 1
    return opened.layout.first_line
