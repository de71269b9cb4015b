"""The work of one session: read its log, fit the known parameters. It may run in another process or computer."""

import hashlib
from pathlib import Path
from typing import NamedTuple

from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.data.recording.format import BEGUN_KEY
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.data.sessions.session import Session
from hil_forceps.drift.session_fit import SessionFit, fit_session
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

MAX_REASON_CHARACTERS = 300


class Task(NamedTuple):
    """The input of one session's fit."""

    session: Session
    rig: Rig
    mapping: ColumnMap
    key: str  # of rig, version and options: see `store`


class Stamp(NamedTuple):
    """Identity of the log from which a result was computed."""

    bytes: int
    changed_ns: int
    digest: str


class Outcome(NamedTuple):
    """The result of one session."""

    session: Session
    key: str
    stamp: Stamp
    fit: SessionFit | None  # None: it could not be used
    reason: str  # why, in a line
    recorded: str  # when it began, as the recording says; ISO 8601 or empty


def stamp_of(path: Path) -> Stamp:
    """Return size, time and digest of a file; OSError if it can't be read."""
    stat = path.stat()
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return Stamp(stat.st_size, stat.st_mtime_ns, digest)


def fit_task(task: Task) -> Outcome:
    """Fit one session; an error in its data is the reason in the result, not an exception."""
    session, stamp, recorded = task.session, Stamp(0, 0, ""), ""
    try:
        stamp = stamp_of(session.path)
        recorded = recorded_begin(session.path)
        runs = read_run(session.path, rig=task.rig, mapping=task.mapping)
        return Outcome(session, task.key, stamp, fit_session(runs, task.rig), "", recorded)
    except UserError as error:
        reason = error.problems[0]
    except OSError as error:
        reason = f"{session.path}: {error.strerror or error}"
    except Exception as error:
        reason = f"the fit failed, {type(error).__name__}: {error}"
    return Outcome(session, task.key, stamp, None, " ".join(reason.split())[:MAX_REASON_CHARACTERS], recorded)


def recorded_begin(path: Path) -> str:
    """Return the start of a recording as it contains it, "" if it does not."""
    if path.suffix.lower() != ".mcap":
        return ""
    return read_recording(path).metadata.get(BEGUN_KEY, "")
