"""What must hold of whatever a reader makes of its input, and where files for it are put.

Whatever the bytes: a reader ends, gives no more frames or rows than the bytes can hold, and raises nothing but
`UserError`, whose problems are one line each and begin with the path.
"""

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from hypothesis import strategies as st

from hil_forceps.rig.errors import UserError

DEFLATE_RATIO = 1032  # of zlib, at best
PLACES = st.integers(0, (1 << 20) - 1)


class FoundError(AssertionError):
    """Something that must not be."""


@cache
def scratch() -> Path:
    """Return a folder for files, the same in one process."""
    kept.append(tempfile.TemporaryDirectory(prefix="reader-fuzz-"))
    return Path(kept[-1].name)


kept: list["tempfile.TemporaryDirectory[str]"] = []


def require(holds: bool, what: str) -> None:
    """FoundError where something doesn't hold."""
    if not holds:
        raise FoundError(what)


def told_well(path: Path, error: UserError) -> None:
    """Check the words of a refusal."""
    require(len(error.problems) > 0, "a refusal without a word")
    for problem in error.problems:
        require(problem.startswith(str(path)), f"no path before: {problem!r}")
        require(problem.isprintable() and len(problem) < 1000, f"no single line, or too long: {problem[:1000]!r}")
        require(len(problem) > len(str(path)) + 4, f"no words: {problem!r}")


def runs_are_sound(path: Path, read: Callable[[], Any], most_rows: int) -> bool:
    """Check what comes of a file as runs; True when there was any."""
    try:
        runs = read()
    except UserError as error:
        told_well(path, error)
        return False
    require(len(runs) > 0, "no run and no refusal")
    for run in runs:
        require(len(run) <= most_rows, f"{len(run)} rows out of what can hold {most_rows}")
        require(all(note.isprintable() and len(note) < 1000 for note in run.notes), f"notes {run.notes}")
    return True


class Cut(NamedTuple):
    """A sound file, how much of it is left, and whether zero bytes follow."""

    name: str
    where: int
    zeros: int
