"""Cells of a table as text: numbers, empty ones, and lines split into them."""

import csv
import math
import re
from typing import Final

MAX_LINE_CHARACTERS = 1 << 16
EMPTY: Final = ("", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None", "-", "--")
SPACE = " "

_EMPTY = frozenset(EMPTY)
# A digit fits in one place of a pattern only: else a long row of them takes time with its square.
_NUMBER = re.compile(r"[ \t]*[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?[ \t]*")
_COMMA_NUMBER = re.compile(r"[ \t]*[-+]?(?:[0-9]+(?:,[0-9]*)?|,[0-9]+)(?:[eE][-+]?[0-9]+)?[ \t]*")


def finite_number(cell: str) -> float | None:
    """Return the number in a cell; None where there is none, or one that is not finite."""
    if _NUMBER.fullmatch(cell) is None:  # float() takes 1_000 and digits of other scripts, too
        return None
    number = float(cell)
    return number if math.isfinite(number) else None


def is_number(cell: str) -> bool:
    """Tell whether a cell is a number, with a point or a comma."""
    return _NUMBER.fullmatch(cell) is not None or _COMMA_NUMBER.fullmatch(cell) is not None


def is_empty(cell: str) -> bool:
    """Tell whether a cell holds nothing, or one of the words for that."""
    return cell.strip() in _EMPTY


def is_skipped(line: str) -> bool:
    """Tell whether a line is blank or a comment."""
    text = line.lstrip()
    return not text or text.startswith("#")


def split_line(line: str, delimiter: str) -> list[str]:
    """Split a line into cells, quotes taken away; by any white space where the delimiter is a space."""
    if delimiter == SPACE:
        return line.split()
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=True), [])
    except csv.Error:
        return line.split(delimiter)
