"""Where in a table, given as rows of cells, the names, the units and the first sample stand."""

from collections.abc import Sequence
from typing import NamedTuple

from hil_forceps.data.readers.tables.cells import is_empty, is_number
from hil_forceps.data.readers.tables.units import unit_of
from hil_forceps.data.readers.tables.written_name import parse_name

MIN_TABLE_ROWS = 3  # rows alike that make a table; a preamble may hold two lines of numbers one behind the other
_LABELS = frozenset(("unit", "units", "einheit", "einheiten"))
_MAX_HEAD_ROWS = 5  # above the first row of numbers, among which the names are looked for
_WITHOUT_CELLS = frozenset(("", "comment"))  # a last name that rows may have no cell for

Row = Sequence[str]


class RowLayout(NamedTuple):
    """Places of rows, from 0; -1 where a table has none."""

    names_row: int
    units_row: int
    first_sample: int  # one behind the last row where there is none
    names: tuple[str, ...]  # one for each cell of a sample; `#1` and so on where the table has none
    units: tuple[str, ...]
    has_trailing: bool = False  # samples end with an empty cell that no name stands over


def find_rows(rows: Sequence[Row], wanted: frozenset[str]) -> RowLayout | None:
    """Find the layout: by a row with names of a run or `wanted` ones, else by rows of numbers; None without a table."""
    header = next((at for at, row in enumerate(rows) if len(row) >= 2 and name_hits(row, wanted) >= 2), None)
    if header is not None:
        return _below(rows, header)
    first = _first_sample(rows)
    return None if first is None else _above(rows, first)


def name_hits(row: Row, wanted: frozenset[str]) -> int:
    """Count the columns of a run, or those that a mapping wants, that cells name."""
    names = {cell.strip() for cell in row} - {""}
    return len({name if name in wanted else parse_name(name).column for name in names} - {""})


def is_sample(row: Row) -> bool:
    """Tell whether a row may be a sample: a number, and at least half of its cells numbers or empty."""
    numbers = sum(map(is_number, row))
    empty = sum(map(is_empty, row))
    return numbers >= 1 and numbers + empty >= 2 and 2 * (numbers + empty) >= len(row)


def is_units(row: Row) -> bool:
    """Tell whether a row holds units only."""
    cells = [cell.strip() for cell in row if cell.strip()]
    units = [cell for cell in cells if unit_of(cell) is not None]
    return len(units) >= 1 and all(cell in units or cell.lower() in _LABELS for cell in cells)


def _below(rows: Sequence[Row], header: int) -> RowLayout:
    """Take what follows the names: units, and rows with a label only."""
    at, units_row = header + 1, -1
    while at < len(rows) and not is_sample(rows[at]):
        if units_row < 0 and is_units(rows[at]):
            units_row = at
        elif not _is_label(rows[at]):
            break
        at += 1
    return _fitted(rows, header, units_row, at)


def _is_label(row: Row) -> bool:
    return len(row) > 1 and sum(1 for cell in row if cell.strip()) == 1


def _first_sample(rows: Sequence[Row]) -> int | None:
    """Return the first of some rows of numbers with as many cells each."""
    begin = 0
    for at, row in enumerate(rows):
        if not is_sample(row) or (at > begin and len(row) != len(rows[begin])):
            begin = at if is_sample(row) else at + 1
        elif at - begin + 1 >= MIN_TABLE_ROWS:
            return begin
    return begin if begin < len(rows) else None


def _above(rows: Sequence[Row], first: int) -> RowLayout:
    """Look for the names above the first sample."""
    count, units_row = len(rows[first]), -1
    for at in range(first - 1, max(first - 1 - _MAX_HEAD_ROWS, -1), -1):
        row = rows[at]
        if units_row < 0 and is_units(row) and abs(len(row) - count) <= 1:
            units_row = at
        elif abs(len(row) - count) <= 1 and 2 * sum(1 for cell in row if cell.strip() and not is_number(cell)) >= count:
            return _fitted(rows, at, units_row, first)
    return _fitted(rows, -1, units_row, first)


def _fitted(rows: Sequence[Row], names_row: int, units_row: int, first: int) -> RowLayout:
    """Give names and units as many cells as the samples have, where only a last, empty one differs."""
    count = len(rows[first]) if first < len(rows) else 0
    names = [name.strip() for name in rows[names_row]] if names_row >= 0 else [f"#{n + 1}" for n in range(count)]
    has_trailing = False
    if count == len(names) - 1 and names[-1].lower() in _WITHOUT_CELLS:
        names.pop()
    elif count == len(names) + 1 and not rows[first][-1].strip():
        names.append("")
        has_trailing = True
    units = [unit.strip() for unit in rows[units_row]] if units_row >= 0 else []
    units = [unit if unit_of(unit) else "" for unit in units]
    return RowLayout(names_row, units_row, first, tuple(names), tuple(units), has_trailing)
