"""Reader for recordings of EPOS Studio, maxon's program for its EPOS controllers.

A text with semicolons: a preamble of one key a line, a row with the names of the recorded objects, a row with their
units, then samples. Torque is given in percent of the motor's rated torque (object 0x6076 of CiA 402), which the file
doesn't hold; the rig says it. Where no position was recorded, the angle is the integral of the speed.
"""

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil_forceps.data.readers.cut_text import whole_lines
from hil_forceps.data.readers.format import Format
from hil_forceps.data.readers.tables.cells import finite_number
from hil_forceps.data.readers.tables.packed import path_stem, read_unpacked
from hil_forceps.data.run import ANGLE_FROM_SPEED, Column, Run
from hil_forceps.data.time_order import drop_repeats
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

MAX_FILE_BYTES = 64 << 20  # the recorder holds some thousand samples
_MARK = b"EPOS Studio Version"

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
_RAD_PER_S = {"rpm": 2.0 * math.pi / 60.0, "min^-1": 2.0 * math.pi / 60.0, "rev/min": 2.0 * math.pi / 60.0}
_AMPERES = {"A": 1.0, "mA": 1e-3}
_OF_RATED = {"%": 1e-2, "‰": 1e-3}
_COUNTS = {"inc": 1.0, "qc": 1.0}


class _Table(NamedTuple):
    names: tuple[str, ...]  # of the objects, in lower case; the first is time's and empty
    units: tuple[str, ...]
    units_line: int
    values: list[list[float]]  # samples, a row each
    lines: list[int]  # of the file, that the samples stand on


def read_epos_studio(path: Path, rig: Rig | None) -> Run:
    """Read one recording: time, position or speed, and current or torque. UserError with the line otherwise.

    `rig` says the rated torque (`recording.rated_torque_N_m`) and the encoder's counts where the file needs them.
    """
    text, cut = _text(path)
    table = _table(path, text)
    columns = {"time_s": _channel(path, table, 0, _SECONDS)}
    notes = [cut] if cut else []
    used = {0}
    if (position := _find(table, "position actual value")) is not None:
        used.add(position)
        columns["theta_m_rad"] = _channel(path, table, position, _COUNTS) * _radians_per_count(path, rig)
    elif (speed := _find(table, "velocity actual value", "velocity actual value averaged")) is not None:
        used.add(speed)
        rad_per_s = _channel(path, table, speed, _RAD_PER_S)
        steps = 0.5 * (rad_per_s[1:] + rad_per_s[:-1]) * np.diff(columns["time_s"])
        columns["theta_m_rad"] = np.concatenate(([0.0], np.cumsum(steps)))
        notes.append(ANGLE_FROM_SPEED)
    else:
        raise UserError(f"{path}: neither position nor velocity was recorded; add one in the data recorder")
    if (reference := _find(table, "position demand value")) is not None:
        used.add(reference)
        columns["theta_m_ref_rad"] = _channel(path, table, reference, _COUNTS) * _radians_per_count(path, rig)
    if (current := _find(table, "current actual value", "current actual value averaged")) is not None:
        used.add(current)
        columns["current_A"] = _channel(path, table, current, _AMPERES)
    elif (torque := _find(table, "torque actual value", "torque actual value averaged")) is not None:
        used.add(torque)
        columns["tau_m_N_m"] = _channel(path, table, torque, _OF_RATED) * _rated_torque_N_m(path, rig)
    else:
        raise UserError(f"{path}: neither current nor torque was recorded; add one in the data recorder")
    notes += [f"object {name!r} was left out" for place, name in enumerate(table.names) if place not in used]
    columns, more = drop_repeats(columns, str(path), lambda row: f"{path}:{table.lines[row]}")
    return Run(path_stem(path), columns, (*notes, *more))


def _text(path: Path) -> tuple[str, str]:
    """Return the text, and a note where its end is missing."""
    cuts: list[str] = []
    try:
        data = read_unpacked(path, MAX_FILE_BYTES, "a recording of EPOS Studio", cuts)
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}") from error
    whole, cut = whole_lines(data)
    cut = "; ".join(filter(None, (*cuts, cut)))
    try:
        return whole.decode("utf-8-sig"), cut
    except UnicodeDecodeError:
        return whole.decode("cp1252", errors="replace"), cut


def _table(path: Path, text: str) -> _Table:
    names: tuple[str, ...] = ()  # in the row before the units
    units: tuple[str, ...] = ()
    units_line = 0
    values: list[list[float]] = []
    lines: list[int] = []
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=";")
    try:
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            if units:
                values.append(_numbers(path, reader.line_num, cells, len(units)))
                lines.append(reader.line_num)
            elif cells[0].strip() in _SECONDS:
                units, units_line = tuple(cell.strip() for cell in cells), reader.line_num
            else:
                names = tuple(cell.strip().lower() for cell in cells)
    except csv.Error as error:
        raise UserError(f"{path}:{reader.line_num}: not a recording of EPOS Studio: {error}") from error
    if not units:
        raise UserError(f"{path}: no row of units ('ms;rpm;%') in it; export the recording from EPOS Studio again")
    if len(names) != len(units):
        raise UserError(f"{path}:{units_line}: {len(units)} units for {len(names)} objects; export the recording again")
    if len(values) < 2:
        raise UserError(f"{path}: {len(values)} samples are too few: at least 2 are needed")
    return _Table(names, units, units_line, values, lines)


def _numbers(path: Path, line: int, cells: Sequence[str], count: int) -> list[float]:
    if len(cells) != count:
        raise UserError(f"{path}:{line}: {len(cells)} cells for {count} columns; correct the row or remove it")
    found = []
    for cell in cells:
        number = finite_number(cell.replace(",", "."))
        if number is None:
            told = f"{cell.strip()[:40]!r} is not a finite number; correct the row or remove it"
            raise UserError(f"{path}:{line}: {told}")
        found.append(number)
    return found


def _find(table: _Table, *names: str) -> int | None:
    return next((table.names.index(name) for name in names if name in table.names), None)


def _channel(path: Path, table: _Table, place: int, units: dict[str, float]) -> Column:
    unit = table.units[place]
    if unit not in units:
        name = table.names[place] or "time"
        raise UserError(f"{path}:{table.units_line}: {name} is in {unit!r}; {' or '.join(units)} are read")
    return units[unit] * np.array([row[place] for row in table.values])


def _rated_torque_N_m(path: Path, rig: Rig | None) -> float:
    rated = None if rig is None else rig.recording.rated_torque_N_m
    if rated is None:
        told = "torque is in percent of the motor's rated torque, which the file does not contain"
        raise UserError(f"{path}: {told}; name a rig (--rig) with recording.rated_torque_N_m")
    return rated


def _radians_per_count(path: Path, rig: Rig | None) -> float:
    counts = None if rig is None else rig.encoder.counts_per_rev
    if counts is None:
        told = "position is in counts, but the file does not contain the counts of one turn"
        raise UserError(f"{path}: {told}; name a rig (--rig) with encoder.counts_per_rev")
    return 2.0 * math.pi / counts


FORMAT = Format(
    "EPOS Studio",
    (),  # its files are called .csv
    lambda request: [read_epos_studio(request.path, request.rig)],
    looks_like=lambda head: _MARK in head,
    may_be_packed=True,
)
