"""Names of columns: quantity and unit of a run's, and how others are told."""

import difflib

from hil_forceps.data.run import KNOWN_COLUMNS

_UNITS = ("N_m", "rad", "s", "A", "V")
_MAX_SHOWN_CHARACTERS = 40


def split_name(column: str) -> tuple[str, str]:
    """Return quantity and unit of a known column: `tau_m_N_m` gives ("tau_m", "N_m")."""
    unit = next(unit for unit in _UNITS if column.endswith(f"_{unit}"))
    return column[: -len(unit) - 1], unit


def left_out(name: str) -> str:
    """Say that a column was left out, with the name that was probably meant."""
    near = difflib.get_close_matches(name[:_MAX_SHOWN_CHARACTERS], KNOWN_COLUMNS, n=1)
    guess = f" (did you mean {near[0]}?)" if near else ""
    return f"column {show_name(name)} is not a column of a run and was left out{guess}"


def show_name(name: str) -> str:
    """Quote a name, cut where it is longer than any that makes sense."""
    return repr(name if len(name) <= _MAX_SHOWN_CHARACTERS else name[: _MAX_SHOWN_CHARACTERS - 3] + "...")
