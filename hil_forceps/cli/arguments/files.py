"""Folders and files that the user names, and files that are named by what is in data."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from hil_forceps.bench.run_folder import BUS_LOGS, RECORDING_NAME, RUN_FILES
from hil_forceps.cli.arguments.made_folders import make
from hil_forceps.rig.errors import UserError

MAX_NAME_BYTES: Final = 200  # of 255, so that a suffix has room
_NO_FILE_NAME: Final = re.compile(r"^\.+$|[/\x00-\x1f\x7f]")


def make_folder(path: Path, inside: Path | None = None) -> None:
    """Make a folder for results; UserError when it can't be made or written to, or would lead somewhere else.

    `inside`: the folder in which it has to be; one that the user names himself may be a link to anywhere.
    """
    try:
        make(path)
        if inside is not None and not _leads_into(path, inside.resolve()):
            raise UserError(f"--out {inside}: {path.name} in it is a link out of it; remove that, or name another")
        _refuse_links_outside(path)
        probe = path / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UserError(f"--out {path}: can't be written to: {error.strerror}; name another folder") from error


def _refuse_links_outside(folder: Path) -> None:
    """UserError where a file in the folder is a link out of it: what is written to that name goes elsewhere."""
    home = folder.resolve()
    for entry in home.iterdir():
        if entry.is_symlink() and not entry.is_dir() and not _leads_into(entry, home):
            raise UserError(f"--out {folder}: {entry.name} in it is a link out of it; remove that, or name another")


def _leads_into(link: Path, home: Path) -> bool:
    try:
        return link.resolve().is_relative_to(home)
    except RuntimeError:  # links in a circle, before Python 3.13
        return False


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Put the file that the user named before each problem that is found in what it says."""
    try:
        yield
    except UserError as error:
        raise UserError([f"{path}: {problem}" for problem in error.problems]) from error


def file_name(name: str) -> str:
    """Return a name out of data as that of a file: one step of a path, of a length that a file system takes."""
    return _NO_FILE_NAME.sub("_", name).encode()[:MAX_NAME_BYTES].decode("utf-8", "ignore")


def clear_runs(folders: Sequence[Path], *, overwrite: bool) -> None:
    """Remove what a run left in folders; UserError where there is something and it may not be overwritten."""
    there = [path for folder in folders for name in RUN_FILES if (path := folder / name).is_file()]
    if there and not overwrite:
        raise UserError(f"--out {there[0].parent}: holds a run ({there[0].name}); name another folder, or --overwrite")
    try:
        for path in there:
            path.unlink()
    except OSError as error:
        raise UserError(f"{error.filename}: can't be overwritten: {error.strerror}; name another folder") from error


def recording_of(run: Path) -> Path:
    """Return the recording that the user means, by its folder or itself; UserError where there is none."""
    path = run / RECORDING_NAME if run.is_dir() else run
    if not path.is_file():
        axes = sorted(each.parent.name for each in run.glob(f"*/{RECORDING_NAME}")) if run.is_dir() else []
        told = f"holds no {RECORDING_NAME}" if run.is_dir() else "no such file or folder"
        told += f", but its folders {', '.join(axes[:8])} do" if axes else ""
        raise UserError(f"{run}: {told}; name the folder of a run, or its recording")
    return path


def bus_log_of(recording: Path) -> Path | None:
    """Return the bus log beside a recording, or above it where a run has several axes; of a bench's run NAME.log."""
    if recording.name != RECORDING_NAME:
        own = recording.with_suffix(".log")
        return own if own.is_file() else None
    folders = (recording.parent, recording.parent.parent)
    return next((path for folder in folders for name in BUS_LOGS if (path := folder / name).is_file()), None)
