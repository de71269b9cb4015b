"""How a text is laid out: preamble, delimiter, decimal mark, names, units, the first sample's line."""

from collections.abc import Sequence
from typing import NamedTuple

from hil_forceps.data.readers.tables.cells import SPACE, is_empty, is_number, is_skipped, split_line
from hil_forceps.data.readers.tables.row_layout import RowLayout, find_rows, is_sample, name_hits

DELIMITERS = (";", "\t", ",", "|", SPACE)
_WORDS = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars", SPACE: "spaces"}
_STATED = frozenset((*DELIMITERS, ":", "^", "~"))
_FIRST_LINES = 60  # a head, and more rows than tell one delimiter from another
_COMPARED_ROWS = 20  # that tell one delimiter from another


class TextLayout(NamedTuple):
    """What the first lines say; lines are counted from 1."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    delimiter: str
    names_line: int  # 0 where the names stand nowhere
    units_line: int  # 0 where none holds units
    first_line: int  # of samples
    has_quoted_commas: bool = False  # "1,5" between commas
    notes: tuple[str, ...] = ()


class _Try(NamedTuple):
    delimiter: str
    lines: list[int]  # from 0, of the rows
    rows: list[list[str]]
    layout: RowLayout


def find_layout(lines: Sequence[str], wanted: frozenset[str] = frozenset()) -> TextLayout | None:
    """Find the layout from the first lines; None where no table is seen. `wanted`: columns that a mapping names.

    Where the first few lines name columns of a run, the others aren't looked at.
    """
    stated = _stated(lines)
    for few in (lines[:_FIRST_LINES], lines):
        tries = [_try(few, each, wanted, stated) for each in ((stated[1],) if stated else DELIMITERS)]
        found = [each for each in tries if each is not None]
        best = max(found, key=lambda each: _score(each, wanted), default=None)
        is_clear = best is not None and _score(best, wanted)[0] and best.layout.first_sample < len(best.lines)
        if best is not None and (is_clear or len(few) == len(lines)):
            return _told(few, best, is_stated=stated is not None)
    return None


def _stated(lines: Sequence[str]) -> tuple[int, str] | None:
    """Return (line, delimiter) of a line `sep=;`, as Excel writes and reads it."""
    for at, line in enumerate(lines[:2]):
        text = line.strip("\n").strip('"')
        if text.lower().startswith("sep=") and len(text) == 5 and text[4] in _STATED:
            return at, text[4]
    return None


def _try(lines: Sequence[str], delimiter: str, wanted: frozenset[str], stated: tuple[int, str] | None) -> _Try | None:
    kept = [at for at, line in enumerate(lines) if not is_skipped(line) and not (stated and at == stated[0])]
    rows = [split_line(lines[at], delimiter) for at in kept]
    layout = find_rows(rows, wanted)
    if layout is None or len(layout.names) < 2:
        return None
    return _Try(delimiter, kept, rows, layout)


def _score(each: _Try, wanted: frozenset[str]) -> tuple[int, float, int, int]:
    """Rank a delimiter: names found, cells that are numbers, whether there are names, then the order of preference."""
    layout = each.layout
    hits = name_hits(each.rows[layout.names_row], wanted) if layout.names_row >= 0 else 0
    rows = each.rows[layout.first_sample : layout.first_sample + _COMPARED_ROWS]
    cells = [cell for row in rows for cell in row]
    share = sum(1 for cell in cells if is_number(cell) or is_empty(cell)) / max(len(cells), 1)
    preference = -DELIMITERS.index(each.delimiter) if each.delimiter in DELIMITERS else 0
    return (hits if hits >= 2 else 0), share, int(layout.names_row >= 0), preference


def _told(lines: Sequence[str], best: _Try, *, is_stated: bool) -> TextLayout:
    layout, notes = best.layout, []
    count = len(best.lines)
    first = best.lines[layout.first_sample] if layout.first_sample < count else len(lines)
    names = layout.names
    names_line = best.lines[layout.names_row] + 1 if layout.names_row >= 0 else 0
    if not names_line:
        names, names_line = _commented(lines, first, best.delimiter, names)
        notes.append(
            f"line {names_line}, a comment, was read as the names of the columns"
            if names_line
            else "the columns have no names: #1 is the first"
        )
    begin = layout.names_row if layout.names_row >= 0 else layout.first_sample
    if begin > 0:
        last = best.lines[begin - 1] + 1
        notes.append(f"{'line 1' if last == 1 else f'lines 1 to {last}'} before the table: left out")
    units_line = best.lines[layout.units_row] + 1 if layout.units_row >= 0 else 0
    if units_line:
        notes.append(f"line {units_line} was read as units")
    if best.delimiter not in (",", ";", "\t") and not is_stated:
        notes.append(f"cells were separated at {_WORDS[best.delimiter]}")
    if layout.has_trailing:
        notes.append(f"a {best.delimiter!r} at the end of each line was ignored")
    rows = best.rows[layout.first_sample : layout.first_sample + _COMPARED_ROWS]
    quoted = best.delimiter == "," and any("," in cell and is_number(cell) for row in rows for cell in row)
    return TextLayout(names, layout.units, best.delimiter, names_line, units_line, first + 1, quoted, tuple(notes))


def _commented(lines: Sequence[str], first: int, delimiter: str, names: tuple[str, ...]) -> tuple[tuple[str, ...], int]:
    """Take the names out of the comment before the first sample, if it has as many cells: numpy's savetxt does so."""
    for at in range(first - 1, -1, -1):
        text = lines[at].strip()
        if text.startswith(("#", "%")):
            cells = [cell.strip() for cell in split_line(text.lstrip("#% "), delimiter)]
            is_header = len(cells) == len(names) and not is_sample(cells) and all(cells)
            return (tuple(cells), at + 1) if is_header else (names, 0)
        if text:
            break
    return names, 0
