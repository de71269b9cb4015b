"""Folders that a command made for its results: one that is refused leaves none of them behind."""

from pathlib import Path
from typing import Final

_made: Final[list[Path]] = []  # of the command under way, outer ones first


def make(path: Path) -> None:
    """Make a folder with those above it, and remember which of them were not there; OSError as the disk does."""
    missing = [each for each in (path, *path.parents) if not each.exists()]
    path.mkdir(parents=True, exist_ok=True)
    _made.extend(reversed(missing))


def forget() -> None:
    """Begin anew: what was made before stays."""
    _made.clear()


def remove_empty() -> None:
    """Remove those that were made and hold nothing."""
    while _made:
        try:
            _made.pop().rmdir()
        except OSError:
            continue  # something is in it, or it is gone
