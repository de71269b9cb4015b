"""A column's name as a file writes it: the quantity, and the unit behind it."""

import re
from typing import NamedTuple

from hil_forceps.data.column_names import split_name
from hil_forceps.data.readers.tables.units import unit_of
from hil_forceps.data.run import KNOWN_COLUMNS

QUANTITIES = {split_name(column)[0]: column for column in KNOWN_COLUMNS}
_LONGEST_FIRST = sorted(QUANTITIES, key=len, reverse=True)
_MAX_NAME_CHARACTERS = 200  # the patterns below go back and forth in a name
_BRACKETS = re.compile(r"(.*?)[\s_]*[\[(<{]([^\[\](){}<>]*)[\])>}]\s*")
_BEHIND = re.compile(r"(.+?)(?:\s*/\s*|\s+in\s+|\s*,\s+)(\S.*?)\s*")
_BETWEEN_WORDS = re.compile(r"[\s\-.]+")


class WrittenName(NamedTuple):
    """What stands in a header's cell."""

    column: str  # of a run, whose quantity is named; "" where none is
    base: str  # the name without its unit, in lower case, words joined by _
    unit: str  # as written, "" where none is
    other_unit: str = ""  # in brackets behind a name that says another: theta_m_rad [deg]


def parse_name(name: str) -> WrittenName:
    """Take a name apart: `theta_m [deg]`, `Theta M (deg)`, `theta_m / deg`, `theta_m_deg` are one and the same."""
    if len(name) > _MAX_NAME_CHARACTERS:
        return WrittenName("", name, "")
    base, unit = _split(name.strip())
    plain = _plain(base)
    if plain in QUANTITIES:
        return WrittenName(QUANTITIES[plain], plain, unit)
    for quantity in _LONGEST_FIRST:
        rest = base[len(quantity) + 1 :]
        if plain.startswith(f"{quantity}_") and (found := unit_of(rest)) is not None:
            other = unit if unit and unit_of(unit) != found else ""
            return WrittenName(QUANTITIES[quantity], quantity, rest, other)
    return WrittenName("", plain, unit)


def _split(name: str) -> tuple[str, str]:
    for pattern in (_BRACKETS, _BEHIND):
        found = pattern.fullmatch(name)
        if found and unit_of(found[2]) is not None:
            return found[1], found[2].strip()
    return name, ""


def _plain(base: str) -> str:
    return _BETWEEN_WORDS.sub("_", base.strip().lower())
