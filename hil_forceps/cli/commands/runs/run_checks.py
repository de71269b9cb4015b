"""Checks of `hil-forceps run` before anything is opened: options and rigs that are inconsistent."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from hil_forceps.bridge.links.adapters import LinkSpec, check_spec
from hil_forceps.cli.arguments.drive_line import line_rate
from hil_forceps.cli.arguments.files import named
from hil_forceps.cli.arguments.trajectory_file import check_trajectory, read_trajectory
from hil_forceps.cli.terminal.notes import note
from hil_forceps.control.trajectories import PAPER_TRAJECTORY, Trajectory
from hil_forceps.drives.compatibility.lint import findings
from hil_forceps.drives.compatibility.several import findings as findings_of_several
from hil_forceps.drives.profile import Finding
from hil_forceps.estimation.registry import ESTIMATOR_IDS
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError


def checked_rate(
    paths: Sequence[Path], rigs: Mapping[str, Rig], wanted: LinkSpec, baudrate: int | None, drive: str | None
) -> int:
    """Return the rate of a serial line; UserError if a rig is for another line or drive."""
    rates = set()
    for path, rig in zip(paths, rigs.values(), strict=True):
        _check_profile(path, rig, drive)
        rates.add(line_rate(path, rig, wanted.interface, wanted.serial_url, baudrate))
    check_spec(wanted)
    return max(rates)


def check_rigs(paths: Sequence[Path], rigs: Mapping[str, Rig]) -> None:
    """Print the notes of `hil-forceps check`; UserError for its problems, and for rigs that no estimator can use."""
    for path, rig in zip(paths, rigs.values(), strict=True):
        _check_settings(str(path), findings(rig))
        with named(path):
            rig.plant()  # UserError for missing values that every estimator needs
    if len(rigs) > 1:
        _check_settings(" ".join(map(str, paths)), findings_of_several(rigs))


def with_following_error(rigs: Mapping[str, Rig], max_deg: float | None) -> dict[str, Rig]:
    """Return the rigs with this following error window, unless theirs is narrower; UserError for no such angle."""
    if max_deg is None:
        return dict(rigs)
    if not 0.0 < max_deg <= 360.0:
        raise UserError(f"--max-following-error {max_deg:g}: must be above 0 and at most 360 degrees")
    return {name: _narrowed(rig, math.radians(max_deg)) for name, rig in rigs.items()}


def _narrowed(rig: Rig, max_rad: float) -> Rig:
    own_rad = rig.limits.following_error_max_rad
    if own_rad is not None and own_rad <= max_rad:
        return rig
    return rig.with_changes({"limits.following_error_max_rad": max_rad})


def check_duration(duration_s: float | None) -> None:
    """UserError if the duration is not a positive number."""
    if duration_s is not None and not (math.isfinite(duration_s) and duration_s > 0.0):
        raise UserError(f"--duration {duration_s}: must be a positive number of seconds")


def check_outside(references: str, token: Path | None, timeout_s: float | None, trajectory: tuple[Path, ...]) -> None:
    """UserError for options that exclude or require each other."""
    if references and trajectory:
        raise UserError("--references and --trajectory: the jaw follows only one of them; leave one out")
    if not references:
        wanting = {"--references-token": token, "--references-timeout": timeout_s}
        if extra := [name for name, given in wanting.items() if given is not None]:
            raise UserError(f"{extra[0]}: only with --references; add it, or leave {extra[0]} out")


def motions(
    trajectory: tuple[Path, ...], paths: Sequence[Path], rigs: Mapping[str, Rig], duration: float | None
) -> tuple[list[Trajectory | None], float]:
    """Return the trajectory of each axis and the duration of the run; UserError if one exceeds the limits."""
    points = _trajectories(trajectory, len(rigs))
    last_s = 20.0 if not trajectory else max(each.times_s[-1] for each in points)
    duration_s = max(last_s, 1e-3) if duration is None else duration
    sources = [*trajectory] if len(trajectory) in {0, len(rigs)} else [*trajectory] * len(rigs)
    for place, (path, loaded) in enumerate(zip(paths, rigs.values(), strict=True)):
        check_trajectory(sources[place] if sources else None, points[place], duration_s, path, loaded)
    return [*points], duration_s


def _trajectories(paths: Sequence[Path], axes: int) -> list[Trajectory]:
    """Return the trajectory of each axis; UserError if their number is wrong."""
    if len(paths) not in {0, 1, axes}:
        raise UserError(f"--trajectory: {len(paths)} files for {axes} axes; give one for all, or one for each")
    points = [read_trajectory(path) for path in paths] or [PAPER_TRAJECTORY]
    return points * axes if len(points) == 1 else points


def _check_profile(path: Path, rig: Rig, wanted: str | None) -> None:
    """UserError if --drive names another profile than the rig."""
    if wanted is not None and wanted != rig.drive_profile:
        raise UserError(
            f"--drive {wanted}: {path} is for a drive with the profile {rig.drive_profile}; leave --drive out, or "
            "change `motor_driver:` (docs/drives.md)"
        )


def check_algorithm(name: str) -> None:
    """UserError if there is no such estimator."""
    if name not in ESTIMATOR_IDS:
        raise UserError(f"--algorithm: unknown algorithm '{name}'; use one of {', '.join(ESTIMATOR_IDS)}")


def _check_settings(where: str, found: Sequence[Finding]) -> None:
    problems = [f"{where}: {each.key}: {each.text}" for each in found if each.level == "problem"]
    if problems:
        raise UserError(problems)
    for each in found:
        note(f"{where}: {each.key}: {each.text}")
