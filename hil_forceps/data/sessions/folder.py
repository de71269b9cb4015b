"""Which sessions a folder holds: each log is one, and so is each folder of a run of the service."""

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from hil_forceps.data.readers.read_run import FORMATS
from hil_forceps.data.readers.tables.packed import inner_name
from hil_forceps.data.recording.format import RECORDING_NAME
from hil_forceps.data.sessions.session import RIG_NAME, TABLE_NAME, Session
from hil_forceps.data.sessions.table import Row, read_table
from hil_forceps.rig.errors import UserError

BUS_LOG = "bus"  # with any suffix: the same run as its recording
MAX_FOLDER_DEPTH = 8  # of folders in each other


def sessions_of(folder: Path, rig: Path | None, out: Path | None = None) -> list[Session]:
    """Return the sessions of a folder and of those below it, by name.

    A session belongs to the nearest folder above it that holds a rig.yaml, which is its rig; without one to the folder
    that it lies in, and `rig` is its rig. A sessions.csv in the folder says otherwise. `out` and what is hidden is
    left out. UserError, a line for each problem.
    """
    require_folder(folder)
    rows = read_table(folder / TABLE_NAME)
    skip = None if out is None else out.resolve()
    found: list[Session] = []
    problems: list[str] = []
    used: set[int] = set()
    for path in _logs(folder, skip, 0):
        row = next((row for row in rows if row.matches(path.relative_to(folder).as_posix())), None)
        used |= set() if row is None else {row.line}
        try:
            found.append(_session(folder, path, rig, row))
        except UserError as error:
            problems += error.problems
    problems += [
        f"{folder / TABLE_NAME}:{row.line}: session {row.pattern}: no such log" for row in rows if row.line not in used
    ]
    if problems:
        raise UserError(list(dict.fromkeys(problems)))
    if not found:
        raise UserError(f"{folder}: contains no logs; see `hil-forceps import --help` for the formats")
    count = Counter(session.name for session in found)
    named = [s if count[s.name] == 1 else s._replace(name=s.path.relative_to(folder).as_posix()) for s in found]
    return sorted(named, key=lambda session: session.name)


def require_folder(folder: Path) -> None:
    """UserError where there is no such folder."""
    if not folder.is_dir():
        raise UserError(
            f"{folder}: {'is not a folder' if folder.exists() else 'no such folder'}; name the folder of the logs"
        )


def _session(folder: Path, path: Path, rig: Path | None, row: Row | None) -> Session:
    own, instrument = rig_above(folder, path)
    name = path.parent if path.name == RECORDING_NAME else path.with_suffix("")
    told = name.relative_to(folder).as_posix() if name != folder else folder.resolve().name
    if row is not None:
        own = folder / row.rig if row.rig else own
        instrument = row.instrument or instrument
    own = own or rig
    if own is None:
        raise UserError(
            f"{folder}: no {RIG_NAME} in this folder or in {path.parent.relative_to(folder).as_posix()}; "
            "put the rig file of each instrument into its folder, or name one for all with --rig"
        )
    return Session(told, path, instrument, own, "" if row is None else row.date)


def rig_above(folder: Path, path: Path) -> tuple[Path | None, str]:
    """Return the rig.yaml that is nearest above a log within a folder, and the name of the instrument."""
    top = folder.resolve().name
    for above in path.parents:
        if (above / RIG_NAME).is_file():
            return above / RIG_NAME, top if above == folder else above.relative_to(folder).as_posix()
        if above == folder:
            break
    home = path.parent.parent if path.name == RECORDING_NAME and path.parent != folder else path.parent
    return None, top if home == folder else home.relative_to(folder).as_posix()


def _logs(folder: Path, skip: Path | None, depth: int) -> Iterator[Path]:
    """Yield the logs below a folder."""
    if depth > MAX_FOLDER_DEPTH or (skip is not None and folder.resolve() == skip):
        return
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError as error:
        raise UserError(f"{folder}: can't be read: {error.strerror}") from error
    shown = [entry for entry in entries if not entry.name.startswith((".", "_"))]
    files = [Path(entry.path) for entry in shown if entry.is_file()]
    folders = [Path(entry.path) for entry in shown if entry.is_dir(follow_symlinks=False)]
    if any(file.name == RECORDING_NAME for file in files):
        yield folder / RECORDING_NAME
        return
    several_axes = any((each / RECORDING_NAME).is_file() for each in folders)
    in_folder = {suffix: each.in_folder for each in FORMATS for suffix in each.suffixes}
    of_logs = {file: in_folder.get(Path(inner_name(file)).suffix.lower()) for file in files if file.name != TABLE_NAME}
    for turn in ("each", "otherwise"):
        chosen = [file for file, read in of_logs.items() if read == turn]
        if chosen:
            yield from (file for file in chosen if not (several_axes and file.stem == BUS_LOG))
            break
    for each in folders:
        yield from _logs(each, skip, depth + 1)
