"""Whether the planned run has room, and may be written."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from hil_forceps.bridge.doctor.check import Check, Verdict, unknown, why
from hil_forceps.bridge.doctor.reads import Reads

# Of run.mcap and bus.log, for each period of the host and axis: docs/doctor.md has the command that measures it. The
# bus log holds at most four frames of eight bytes a period, some 45 bytes a line.
BYTES_PER_PERIOD: Final = 500
MIN_FREE_SPACE_RATIO: Final = 2.0  # over what the run takes: another run has room then


def checks(reads: Reads, out: Path, duration_s: float, period_s: float, axes: int) -> Iterator[Check]:
    """Look at the folder, or at the first above it that is there; nothing is made."""
    folder = out.absolute()
    while not _is_there(folder) and folder != folder.parent:
        folder = folder.parent
    what = f"the folder for results, {out}"
    try:
        space = reads.space(str(folder))
    except OSError as error:
        yield unknown("disk.folder", what, why(error))
        return
    if not space.is_writable:
        remedy = "name another folder with --out"
        yield Check("disk.folder", what, Verdict.FAIL, f"{folder} can't be written to", remedy)
    else:
        yield Check("disk.folder", what, Verdict.OK, f"{folder} can be written to")
    yield _space(space.free_bytes, duration_s, BYTES_PER_PERIOD * axes * duration_s / period_s)


def _space(free_bytes: int, duration_s: float, needed_bytes: float) -> Check:
    name, what = "disk.space", f"free disk for {duration_s:g} s of recording and bus log"
    text = f"{free_bytes / 1e6:.3g} MB free, {needed_bytes / 1e6:.3g} MB needed"
    value = free_bytes / 1e6
    remedy = "free disk space, name another folder with --out, or use a shorter --duration"
    if free_bytes < needed_bytes:
        return Check(name, what, Verdict.FAIL, text, remedy, value, "MB")
    if free_bytes < MIN_FREE_SPACE_RATIO * needed_bytes:
        return Check(name, what, Verdict.WARN, f"{text}: not enough for a second run", remedy, value, "MB")
    return Check(name, what, Verdict.OK, text, "", value, "MB")


def _is_there(folder: Path) -> bool:
    try:
        return folder.is_dir()
    except (OSError, ValueError):
        return False
