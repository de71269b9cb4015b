"""Reader for the surgical-tool text format of the University of Minnesota's Medical Robotics and Devices Lab.

The data are others' (repository `mis-tool-characterization`, ODbL 1.0 / DbCL 1.0); see docs/real-input.md. A data set
is a folder or a zip with files `XY.TXT`: X numbers the frequency, Y the load. Ten comma-separated columns a sample;
lines that begin with `%` are a header, were edited by hand in places and are not trusted for anything.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.readers.cut_text import whole_lines
from hil_forceps.data.readers.format import Format, Request
from hil_forceps.data.readers.surgical_tool.files import MAX_FILE_BYTES, Member, open_data_set
from hil_forceps.data.run import Column, Run, bad_row
from hil_forceps.rig.errors import UserError

Table = NDArray[np.float64]

_TURN = 2 * np.pi
_NEWTON_METRES_PER_COUNT = 3.9811e-5


class Channel(NamedTuple):
    """One column of the files and the column of a run that it becomes; for a left jaw, a right one flips the sign."""

    position: int  # from 0
    column: str
    scale: float  # SI units per count, with the sign of the project's equations (1)-(3)


# Signs. Closing the jaw is the positive sense of everything. On a left jaw the spindle encoder counts down while it
# closes, the jaw encoder and the motor side's torque and current count up, and the load that resists closing is
# negative at the jaw's torque sensor. With these signs both powers come out right in every file: the spindle puts
# energy in over a cycle (mean of τ_m θ̇_m > 0), the load takes some (mean of τ_w θ̇_j > 0), and θ_j rises with θ_m.
#
# θ_m is the spindle's own encoder, not the motor's (column 8, here `theta_drive_rad`, in turns of the spindle),
# although that one is 17 times finer: the gear between them has about 2° of play, and the torque sensor sits on the
# spindle's side of it, so (1) holds for the spindle and not for the motor.
CHANNELS = (
    Channel(1, "theta_m_rad", -_TURN / 8192),
    Channel(2, "tau_m_N_m", _NEWTON_METRES_PER_COUNT),
    Channel(3, "current_A", 1.0),
    Channel(4, "theta_j_rad", _TURN / 4000),
    Channel(5, "tau_w_N_m", -_NEWTON_METRES_PER_COUNT),
    Channel(8, "theta_drive_rad", _TURN / (4096 * 35)),
    Channel(9, "theta_m_ref_rad", -_TURN / 8192),
)
TIME_POSITION = 0
BRAKE_POSITION = 6
COLUMN_COUNT = 10
MIN_SAMPLES = 100
SAMPLE_TIME_RANGE_S = (5e-4, 2e-3)  # the instrument samples at 1 kHz; seconds printed as ms would be far outside


def read_surgical_tool(path: str | Path) -> list[Run]:
    """Read every run of a data set, in order of the file names; see `iter_surgical_tool`."""
    return list(iter_surgical_tool(path))


def iter_surgical_tool(path: str | Path) -> Iterator[Run]:
    """Read the runs of a folder or zip one after another, named by their files ("23" from `23.TXT`).

    Which jaw it is comes from the data: on a left jaw the spindle works on the positive side of its zero, on a right
    jaw on the negative. Raises UserError with file and line when something can't be used, and when left and right
    are mixed in one set.
    """
    first: tuple[str, str] | None = None
    for found in open_data_set(path):
        member, cut = _whole(found)
        table = parse_table(member, cut)
        side = jaw_side(table)
        first = first or (side, member.label)
        if side != first[0]:
            raise UserError(
                f"{member.label}: a {side} jaw in one data set with {first[1]}, a {first[0]} jaw; separate them"
            )
        yield to_run(member.name, table, side, cut)


def jaw_side(table: Table) -> str:
    """Tell "left" from "right" by the side of its zero on which the spindle moves; the jaw closes at zero."""
    spindle = table[:, CHANNELS[0].position]
    return "left" if float(np.median(spindle)) > 0 else "right"


def _whole(member: Member) -> tuple[Member, tuple[str, ...]]:
    """Return the member with its whole lines, and a note where others were left out."""
    data, cut = whole_lines(member.data)
    return member._replace(data=data), (cut,) if cut else ()


def to_run(name: str, table: Table, side: str, notes: tuple[str, ...] = ()) -> Run:
    """Convert raw columns [samples, 10] to SI and to the project's signs."""
    flip = 1.0 if side == "left" else -1.0
    columns: dict[str, Column] = {"time_s": table[:, TIME_POSITION]}
    for channel in CHANNELS:
        columns[channel.column] = flip * channel.scale * table[:, channel.position]
    brake = float(np.median(np.abs(table[:, BRAKE_POSITION])))
    return Run(name, columns, (f"{side} jaw", f"jaw brake command {brake:.2f} A", *notes))


def parse_table(member: Member, notes: tuple[str, ...] = ()) -> Table:
    """Turn one file's text into numbers [samples, 10]; UserError names the line and column that do not fit."""
    lines = [
        (number, line)
        for number, line in enumerate(_text(member).splitlines(), start=1)
        if line.strip() and not line.startswith("%")
    ]
    for number, line in lines:
        cells = line.count(",") + 1
        if cells != COLUMN_COUNT:
            raise UserError(f"{member.label}:{number}: {cells} columns, but the format has {COLUMN_COUNT}")
    if len(lines) < MIN_SAMPLES:
        told = "; ".join((f"{len(lines)} samples; a run has at least {MIN_SAMPLES}", *notes))
        raise UserError(f"{member.label}: {told}")
    try:
        table: Table = np.loadtxt([line for _, line in lines], delimiter=",", comments=None, ndmin=2)
    except ValueError:
        raise UserError(_first_bad_cell(member, lines)) from None
    for position in range(COLUMN_COUNT):
        row = bad_row(table[:, position], increasing=position == TIME_POSITION)
        if row is not None:
            what = "time does not increase" if position == TIME_POSITION else "not a finite number"
            raise UserError(f"{member.label}:{lines[row][0]}: column {position + 1}: {what}")
    interval_s = float(np.median(np.diff(table[:, TIME_POSITION])))
    if not SAMPLE_TIME_RANGE_S[0] <= interval_s <= SAMPLE_TIME_RANGE_S[1]:
        raise UserError(f"{member.label}: column 1: samples are {interval_s:.4g} apart; expected seconds, at 1 kHz")
    return table


def _text(member: Member) -> str:
    try:
        return member.data.decode("ascii")
    except UnicodeDecodeError as error:
        line = member.data.count(b"\n", 0, error.start) + 1
        raise UserError(f"{member.label}:{line}: not a text file of this format") from error


def _first_bad_cell(member: Member, lines: list[tuple[int, str]]) -> str:
    for number, line in lines:
        for position, cell in enumerate(line.split(","), start=1):
            try:
                float(cell)
            except ValueError:
                return f"{member.label}:{number}: column {position}: {cell.strip()[:40]!r} is not a number"
    return f"{member.label}: numbers that can't be read"


def _looks_like(head: bytes) -> bool:
    lines = [line for line in head.splitlines() if line.strip()]
    data = [line for line in lines if not line.startswith(b"%")]
    if len(data) < len(lines):
        return not data or data[0].count(b",") == COLUMN_COUNT - 1
    return bool(data) and data[0].count(b",") == COLUMN_COUNT - 1 and not re.search(rb"[A-Za-z_]{3}", data[0])


def _read_text(request: Request) -> list[Run]:
    path = request.path
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise UserError(f"{path}: larger than {MAX_FILE_BYTES >> 20} MiB")
        member, cut = _whole(Member(path.stem, str(path), path.read_bytes()))
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}") from error
    table = parse_table(member, cut)
    return [to_run(member.name, table, jaw_side(table), cut)]


TEXT = Format("surgical tool", (".txt",), _read_text, looks_like=_looks_like, in_folder="part")
ZIP = Format(
    "surgical tool, zipped",
    (".zip",),
    lambda request: list(iter_surgical_tool(request.path)),
    magic=(b"PK\x03\x04", b"PK\x05\x06"),
)
