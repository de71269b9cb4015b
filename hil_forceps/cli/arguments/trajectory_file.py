"""Trajectory files: CSV with the columns `time_s,theta_j_rad`."""

import csv
from pathlib import Path

from hil_forceps.control.requests import first_excess
from hil_forceps.control.trajectories import Trajectory
from hil_forceps.data.readers.tables.cells import finite_number
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

FIRST_LINE = 2  # line of the first point, after the header
MAX_FILE_BYTES = 64 << 20  # an hour at 1 kHz


def read_trajectory(path: Path) -> Trajectory:
    """Read a trajectory; UserError with the line if a number is not finite or the times do not increase."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise UserError(f"{path}: larger than {MAX_FILE_BYTES >> 20} MiB; use fewer points")
        text = path.read_text(encoding="utf-8-sig")
        rows = list(csv.reader(text.splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path}: can't be read: {error}; save it as CSV in UTF-8") from error
    if not rows or [cell.strip() for cell in rows[0]] != ["time_s", "theta_j_rad"]:
        raise UserError(f"{path}:1: the first line must be time_s,theta_j_rad; correct it")
    if not text.endswith("\n"):
        raise UserError(f"{path}:{len(rows)}: the last line has no line end and may be cut off; complete it")
    points: list[tuple[float, float]] = []
    for line, row in enumerate(rows[1:], FIRST_LINE):
        numbers = [number for cell in row if (number := finite_number(cell)) is not None]
        if len(row) != 2 or len(numbers) != 2:
            raise UserError(f"{path}:{line}: {','.join(row)[:60]!r} is not two finite numbers; correct the line")
        time_s, angle_rad = numbers
        if points and time_s <= points[-1][0]:
            raise UserError(f"{path}:{line}: time_s does not increase; sort the points, and remove duplicate times")
        if time_s < 0.0:
            told = "is negative, but time counts from the first operational sample"
            raise UserError(f"{path}:{line}: time_s {time_s:g} {told}; begin the trajectory at 0 or later")
        points.append((time_s, angle_rad))
    if not points:
        raise UserError(f"{path}: contains no points; add a line time_s,theta_j_rad for each")
    times_s, angles_rad = zip(*points, strict=True)
    return Trajectory(times_s, angles_rad)


def check_trajectory(path: Path | None, trajectory: Trajectory, until_s: float, rig_path: Path, rig: Rig) -> None:
    """UserError if a trajectory exceeds the limits of the gate; `path` is None for the paper's trajectory."""
    found = first_excess(trajectory, until_s, rig.plant(), rig.limits)
    if found is None:
        return
    where = "the paper's trajectory" if path is None else f"{path}:{found.point + FIRST_LINE}"
    change = f"{'change the trajectory' if path else 'use another --trajectory'}, or the limit"
    raise UserError(f"{where}: {found.words} in {rig_path}; {change}")


def write_trajectory(trajectory: Trajectory, path: Path) -> None:
    """Write a trajectory in the format of `read_trajectory`."""
    rows = zip(trajectory.times_s, trajectory.angles_rad, strict=True)
    lines = [f"{time_s:.6f},{angle_rad:.9f}" for time_s, angle_rad in rows]
    path.write_text("\n".join(["time_s,theta_j_rad", *lines, ""]), encoding="utf-8")
