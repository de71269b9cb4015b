"""Names of columns: what a name that is not one of a run was probably meant to be, and what to do about it."""

import difflib
from collections.abc import Iterable, Sequence

from hil_forceps.data.run import KNOWN_COLUMNS, REQUIRED_COLUMNS, TORQUE_COLUMNS
from hil_forceps.rig.units import factor, show_unit

_UNITS = ("N_m", "rad", "s", "A", "V")
_SAME = {"Nm": "N_m", "sec": "s", "seconds": "s", "degrees": "deg", "volt": "V", "amp": "A", "amps": "A"}
_VOLT_UNITS = {"mV": 1e-3, "kV": 1e3}
_LONGEST_SHOWN = 40


def split_name(column: str) -> tuple[str, str]:
    """Return quantity and unit of a known column: `tau_m_N_m` gives ("tau_m", "N_m")."""
    unit = next(unit for unit in _UNITS if column.endswith(f"_{unit}"))
    return column[: -len(unit) - 1], unit


_QUANTITIES = {split_name(column)[0]: column for column in KNOWN_COLUMNS}


def name_problems(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return (errors, notes) about the names in a header.

    An error is a needed column that is missing, a name that stands twice, or a channel given in another unit with
    its own column absent; a note says which column was left out.
    """
    errors = [f"column {show_name(name)} is there twice" for name in sorted({n for n in names if names.count(n) > 1})]
    notes = []
    for name in names:
        if name in KNOWN_COLUMNS:
            continue
        known, remedy = _other_unit(name)
        if known and known not in names:
            errors.append(f"column {show_name(name)} is not in the unit of a run: {remedy}")
        else:
            notes.append(left_out(name))
    if not errors:
        errors = _missing(names)
    return errors, notes


def left_out(name: str) -> str:
    """Say that a column was left out, with the name that was probably meant."""
    near = difflib.get_close_matches(name[:_LONGEST_SHOWN], KNOWN_COLUMNS, n=1)
    guess = f" (meant {near[0]}?)" if near else ""
    return f"column {show_name(name)} is not one of a run and was left out{guess}"


def show_name(name: str) -> str:
    """Quote a name, cut where it is longer than any that makes sense."""
    return repr(name if len(name) <= _LONGEST_SHOWN else name[: _LONGEST_SHOWN - 3] + "...")


def _missing(names: Sequence[str]) -> list[str]:
    errors = [f"column {name} is missing{_nearest(name, names)}" for name in REQUIRED_COLUMNS if name not in names]
    if not any(name in names for name in TORQUE_COLUMNS):
        errors.append(f"neither {TORQUE_COLUMNS[0]} nor {TORQUE_COLUMNS[1]} is there{_nearest('current_A', names)}")
    return errors


def _nearest(wanted: str, names: Iterable[str]) -> str:
    """Name the foreign column that may be the one wanted, by its spelling or by its quantity without a unit."""
    foreign = [name for name in names if name not in KNOWN_COLUMNS]
    quantity = split_name(wanted)[0]
    bare = [name for name in foreign if name.lower() in (quantity, quantity[:1] if quantity == "time" else quantity)]
    near = bare or difflib.get_close_matches(wanted, foreign, n=1)
    return f"; if {show_name(near[0])} is it, in SI, name it {wanted}" if near else ""


def _other_unit(name: str) -> tuple[str, str]:
    """Return (known column, what to do) when `name` is its quantity in another unit, ("", "") when it is not."""
    for quantity in sorted(_QUANTITIES, key=len, reverse=True):
        if not name.startswith(f"{quantity}_"):
            continue
        column = _QUANTITIES[quantity]
        wanted = split_name(column)[1]
        given = name[len(quantity) + 1 :]
        given = _SAME.get(given, given)
        if given == wanted:
            return column, f"name it {column}"
        ratio = _VOLT_UNITS.get(given) if wanted == "V" else factor(given, wanted)
        if ratio is not None:
            return column, f"multiply it by {ratio:.12g} ({show_unit(given)} to {show_unit(wanted)}), name it {column}"
    return "", ""
