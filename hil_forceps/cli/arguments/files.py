"""Folders and files of the command line, and file names derived from data."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from hil_forceps.bench.run_folder import BUS_LOGS, RECORDING_NAME, RUN_FILES
from hil_forceps.cli.arguments.made_folders import make
from hil_forceps.rig.errors import UserError

MAX_NAME_BYTES: Final = 200  # file systems allow 255; the rest is for a suffix
_NO_FILE_NAME: Final = re.compile(r"^\.+$|[/\x00-\x1f\x7f]")


def make_folder(path: Path, inside: Path | None = None) -> None:
    """Make a folder for results; UserError if it can't be made or written to, or contains a link out of it.

    `inside`: the folder that must contain it. Without it the path was named by the user, and may be any link.
    """
    try:
        make(path)
        if inside is not None and not _leads_into(path, inside.resolve()):
            raise UserError(
                f"--out {inside}: {path.name} in it links out of it; remove the link, or name another folder"
            )
        _refuse_links_outside(path)
        probe = path / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UserError(f"--out {path}: can't be written to: {error.strerror}; name another folder") from error


def _refuse_links_outside(folder: Path) -> None:
    """UserError if a file in the folder links out of it: results with this name would be written elsewhere."""
    home = folder.resolve()
    for entry in home.iterdir():
        if entry.is_symlink() and not entry.is_dir() and not _leads_into(entry, home):
            raise UserError(
                f"--out {folder}: {entry.name} in it links out of it; remove the link, or name another folder"
            )


def _leads_into(link: Path, home: Path) -> bool:
    try:
        return link.resolve().is_relative_to(home)
    except RuntimeError:  # a loop of links, before Python 3.13
        return False


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Put the file's path before each problem that is found in its content."""
    try:
        yield
    except UserError as error:
        raise UserError([f"{path}: {problem}" for problem in error.problems]) from error


def file_name(name: str) -> str:
    """Return a name from data as a file name: one path component, no longer than file systems allow."""
    return _NO_FILE_NAME.sub("_", name).encode()[:MAX_NAME_BYTES].decode("utf-8", "ignore")


def clear_runs(folders: Sequence[Path], *, overwrite: bool) -> None:
    """Delete the files of an earlier run in these folders; UserError if there are some and `overwrite` is False."""
    there = [path for folder in folders for name in RUN_FILES if (path := folder / name).is_file()]
    if there and not overwrite:
        raise UserError(
            f"--out {there[0].parent}: contains a run ({there[0].name}); name another folder, or use --overwrite"
        )
    try:
        for path in there:
            path.unlink()
    except OSError as error:
        raise UserError(f"{error.filename}: can't be overwritten: {error.strerror}; name another folder") from error


def recording_of(run: Path) -> Path:
    """Return the path of a recording, given itself or its folder; UserError if there is none."""
    path = run / RECORDING_NAME if run.is_dir() else run
    if not path.is_file():
        axes = sorted(each.parent.name for each in run.glob(f"*/{RECORDING_NAME}")) if run.is_dir() else []
        told = f"contains no {RECORDING_NAME}" if run.is_dir() else "no such file or folder"
        told += f", but its folders {', '.join(axes[:8])} do" if axes else ""
        raise UserError(f"{run}: {told}; name the folder of a run, or its recording")
    return path


def bus_log_of(recording: Path) -> Path | None:
    """Return the bus log of a recording: in its folder, or in the folder above if there are several axes.

    The bus log of a run of `bench` has the name of its recording.
    """
    if recording.name != RECORDING_NAME:
        own = recording.with_suffix(".log")
        return own if own.is_file() else None
    folders = (recording.parent, recording.parent.parent)
    return next((path for folder in folders for name in BUS_LOGS if (path := folder / name).is_file()), None)
