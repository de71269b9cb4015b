"""Trajectories as files: `time_s,theta_j_rad`."""

import csv
import math
from pathlib import Path

from hil_forceps.control.trajectories import Trajectory
from hil_forceps.rig.errors import UserError


def read_trajectory(path: Path) -> Trajectory:
    """Read `time_s,theta_j_rad`; UserError with the line for anything but finite numbers and increasing times."""
    try:
        rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: can't be read: {error}") from error
    if not rows or [cell.strip() for cell in rows[0]] != ["time_s", "theta_j_rad"]:
        raise UserError(f"{path}:1: the header must be time_s,theta_j_rad")
    points: list[tuple[float, float]] = []
    for line, row in enumerate(rows[1:], 2):
        try:
            time_s, angle_rad = (float(cell) for cell in row)
        except ValueError:
            raise UserError(f"{path}:{line}: '{','.join(row)}' is not two numbers") from None
        if not (math.isfinite(time_s) and math.isfinite(angle_rad)):
            raise UserError(f"{path}:{line}: not finite")
        if points and time_s <= points[-1][0]:
            raise UserError(f"{path}:{line}: time_s does not increase")
        points.append((time_s, angle_rad))
    if not points:
        raise UserError(f"{path}: holds no points")
    times_s, angles_rad = zip(*points, strict=True)
    return Trajectory(times_s, angles_rad)


def write_trajectory(trajectory: Trajectory, path: Path) -> None:
    """Write what `read_trajectory` reads."""
    rows = zip(trajectory.times_s, trajectory.angles_rad, strict=True)
    lines = [f"{time_s:.6f},{angle_rad:.9f}" for time_s, angle_rad in rows]
    path.write_text("\n".join(["time_s,theta_j_rad", *lines, ""]), encoding="utf-8")
