"""Stamps as they come in files: a row written twice does no harm, time that stands or goes back does."""

from collections.abc import Callable

import numpy as np

from hil_forceps.data.run import Column, bad_row
from hil_forceps.rig.errors import UserError

Columns = dict[str, Column]

MAX_SAMPLE_TIME_S = 0.1  # of a drive's loop that a rig may state (hil_forceps/rig/sections.py)
_UNITS_S = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def drop_repeats(columns: Columns, label: str, where: Callable[[int], str]) -> tuple[Columns, tuple[str, ...]]:
    """Drop each row that is equal to the row before it in every column; return the rest and a note.

    `where` names the place of a row (from 0) for messages. UserError when a value is not finite, or when time stands
    or falls between rows that differ.
    """
    for name, values in columns.items():
        row = bad_row(values, increasing=False)
        if row is not None:
            raise UserError(f"{where(row)}: {name} is not a finite number; correct it or remove the row")
    time_s = columns["time_s"]
    late = np.flatnonzero(~(np.diff(time_s) > 0)) + 1
    if not late.size:
        return columns, ()
    is_same = np.ones(late.size, dtype=bool)
    for values in columns.values():
        is_same &= values[late] == values[late - 1]
    if not np.all(is_same):
        row = int(late[np.flatnonzero(~is_same)[0]])
        what = "comes twice with different values" if time_s[row] == time_s[row - 1] else "time goes back"
        told = f"time_s: {time_s[row]:.9g} does not come after {time_s[row - 1]:.9g} ({what})"
        raise UserError(f"{where(row)}: {told}; sort or cut the run, or give two runs as two files")
    kept = np.ones(len(time_s), dtype=bool)
    kept[late] = False
    if np.count_nonzero(kept) < 2:
        raise UserError(f"{label}: all {len(time_s)} rows are identical; at least 2 different samples are needed")
    count = f"{late.size} row{'s repeat' if late.size > 1 else ' repeats'}"
    note = (
        f"{count} the row before and {'were' if late.size > 1 else 'was'} dropped, the first at {where(int(late[0]))}"
    )
    return {name: values[kept] for name, values in columns.items()}, (note,)


def check_time_unit(time_s: Column, label: str, *, is_table: bool = True) -> None:
    """UserError where rows come so seldom that no drive does it: then the stamps are hardly seconds.

    `is_table`: its columns can be said to be in other units.
    """
    usual_s = float(np.median(np.diff(time_s)))
    if usual_s <= MAX_SAMPLE_TIME_S * (1.0 + 1e-9):
        return
    units = ((unit, size) for unit, size in _UNITS_S.items() if usual_s * size <= MAX_SAMPLE_TIME_S)
    unit, size = next(units, ("ns", 1e-9))
    told = f"time_s: rows are {usual_s:.6g} s apart, longer than any sample period of a drive (0.1 s)"
    mapped = f", or add --map time_s=COLUMN:{unit}" if is_table else ""
    raise UserError(f"{label}: {told}; if the stamps are {unit}, multiply them by {size:g}{mapped}")
