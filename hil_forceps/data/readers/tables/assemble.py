"""Columns as read, in the file's units, as a run in SI: gaps are counted, repeats dropped, the time axis checked."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.column_names import split_name
from hil_forceps.data.readers.tables.columns import Use
from hil_forceps.data.readers.tables.mapping import LEFT_OUT, entry
from hil_forceps.data.readers.tables.units import unit_of
from hil_forceps.data.run import ANGLE_FROM_SPEED, Column, Run, columns_problem
from hil_forceps.data.time_order import Columns, check_time_unit, drop_repeats
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

MAX_SAMPLES = 50_000_000  # three arrays of these are in memory at a time for one of the columns

Where = Callable[[int], str]  # the place of a row (from 0), for messages


def assemble(path: Path | str, name: str, columns: Columns, uses: Sequence[Use], rig: Rig | None, where: Where) -> Run:
    """Make the run: rows with an empty or NaN cell are dropped and counted, the others converted to SI.

    UserError where a unit needs a rig that isn't there, most of the rows have an empty cell, a number is infinite, or
    time goes back or is hardly in seconds.
    """
    problem = columns_problem(columns)
    if problem:
        raise UserError(f"{path}: {problem}")
    columns, kept, notes = _without_gaps(columns, where)
    for use in uses:
        unit = unit_of(use.unit)
        if unit is not None and unit.kind == "rad_per_s":
            continue
        factor = _factor(path, use, rig)
        if factor != 1.0:
            columns[use.name] = columns[use.name] * factor

    def place(row: int) -> str:
        return where(row if kept is None else int(kept[row]))

    columns, more = drop_repeats(columns, str(path), place)
    check_time_unit(columns["time_s"], str(path))
    for use in uses:
        unit = unit_of(use.unit)
        if unit is not None and unit.kind == "rad_per_s":
            columns[use.name] = _integral(unit.factor * columns[use.name], columns["time_s"])
            notes.append(ANGLE_FROM_SPEED)
    return Run(name, columns, (*notes, *more))


def _without_gaps(columns: Columns, where: Where) -> tuple[Columns, NDArray[np.int64] | None, list[str]]:
    """Drop rows with an empty cell; return the rest, the rows kept (None where all are) and a note."""
    empty = {name: np.isnan(values) for name, values in columns.items()}
    counts = {name: int(np.count_nonzero(each)) for name, each in empty.items()}
    if not any(counts.values()):
        return columns, None, []
    is_gap = np.logical_or.reduce(list(empty.values()))
    total, count = len(is_gap), int(np.count_nonzero(is_gap))
    if total - count < 2 or 2 * count > total:
        worst = max(counts, key=lambda name: counts[name])
        told = f"{worst} is empty or NaN in {counts[worst]} of {total} rows"
        leave = "" if worst == "time_s" else f", or leave the column out: {entry(worst, LEFT_OUT, '')}"
        first = where(int(np.flatnonzero(empty[worst])[0]))
        raise UserError(f"{first}: {told}, so that most rows can't be used; export all columns with one rate{leave}")
    each = ", ".join(f"{name} {number}" for name, number in counts.items() if number)
    rows = f"{count} row{'s' if count > 1 else ''} with empty or NaN cells"
    kept = np.flatnonzero(~is_gap).astype(np.int64)
    note = f"{rows} became gaps ({each})"
    return {name: values[kept] for name, values in columns.items()}, kept, [note]


def _factor(path: Path | str, use: Use, rig: Rig | None) -> float:
    unit = unit_of(use.unit or split_name(use.name)[1])
    assert unit is not None
    if unit.kind == "count":
        counts = None if rig is None else rig.encoder.counts_per_rev
        if counts is None:
            told = f"{use.name} is in counts, but the file does not contain the counts of one turn"
            raise UserError(f"{path}: {told}; name a rig (--rig) with encoder.counts_per_rev")
        return 2.0 * math.pi / counts
    if unit.kind == "rated":
        rated = None if rig is None else rig.recording.rated_torque_N_m
        if rated is None:
            told = f"{use.name} is in {use.unit} of the motor's rated torque, which the file does not contain"
            raise UserError(f"{path}: {told}; name a rig (--rig) with recording.rated_torque_N_m")
        return unit.factor * rated
    return unit.factor


def _integral(rad_per_s: Column, time_s: Column) -> Column:
    steps = 0.5 * (rad_per_s[1:] + rad_per_s[:-1]) * np.diff(time_s)
    return np.concatenate(([0.0], np.cumsum(steps)))
