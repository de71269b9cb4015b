"""Folders and files that the user names."""

from pathlib import Path

from hil_forceps.rig.errors import UserError


def make_folder(path: Path) -> None:
    """Make a folder for results; UserError when it can't be made or written to."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UserError(f"--out {path}: can't be written to: {error.strerror}; name another folder") from error
