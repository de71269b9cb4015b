"""Folders that a command made for its results; if the command is refused, the empty ones are removed."""

from pathlib import Path
from typing import Final

_made: Final[list[Path]] = []  # of the current command, outer folders first


def make(path: Path) -> None:
    """Make a folder and its missing parents, and remember them; OSError if that fails."""
    missing = [each for each in (path, *path.parents) if not each.exists()]
    path.mkdir(parents=True, exist_ok=True)
    _made.extend(reversed(missing))


def forget() -> None:
    """Forget the folders made before; they stay."""
    _made.clear()


def remove_empty() -> None:
    """Remove the folders that were made and are empty."""
    while _made:
        try:
            _made.pop().rmdir()
        except OSError:
            continue  # not empty, or removed already
