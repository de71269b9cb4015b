"""Stored results of sessions: one Parquet file each, written completely or not at all, and one table of all.

A session is fitted again if its log, its rig, the version or the options have changed.
"""

import hashlib
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil_forceps import __version__
from hil_forceps.api.batch.files import whole
from hil_forceps.api.batch.work import Outcome, Stamp, Task, stamp_of
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.data.sessions.session import Session
from hil_forceps.diagnosis.result import TWO_SIDED_95
from hil_forceps.rig import Rig
from hil_forceps.rig.loading import dump_rig

SESSIONS = "sessions"  # folder of the files
METHOD = 1  # raised with each change of the fit that changes its numbers
_UNFINISHED = re.compile(r"\..*-[0-9a-f]{10}\.parquet\.\d+")  # of `file_of`
_KEY, _STAMP = b"hil_forceps.key", b"hil_forceps.stamp"
Rows = list[dict[str, Any]]


def key_of(rig: Rig, mapping: ColumnMap) -> str:
    """Return the part of the key that does not depend on the log: rig, version and options."""
    text = json.dumps([__version__, METHOD, dump_rig(rig), sorted((str(k), str(v)) for k, v in mapping.items())])
    return hashlib.sha256(text.encode()).hexdigest()


def schema() -> Any:
    """Return the columns of a session's file."""
    import pyarrow as pa  # noqa: PLC0415 - takes a while to load

    text, number, count = pa.string(), pa.float64(), pa.int64()
    return pa.schema(
        [
            ("session", text),
            ("instrument", text),
            ("parameter", text),  # null: the session could not be used
            ("unit", text),
            ("value", number),  # null: not measured
            ("sd", number),
            ("low", number),  # 95 %
            ("high", number),
            ("assumed", number),  # by the rig
            ("reason", text),  # why not measured, or not used; null where nothing is wrong
            ("method", text),
            ("rows", count),
            ("rows_used", count),
            ("notes", text),
            ("recorded_utc", text),  # as the recording says, null where it doesn't
            ("path", text),
        ]
    )


def file_of(out: Path, session: Session) -> Path:
    """Return the file of a session's result; different names have different files."""
    readable = "".join(c if c.isalnum() or c in "-_." else "_" for c in session.name)[-80:]
    own = hashlib.sha256(session.name.encode()).hexdigest()[:10]
    return out / SESSIONS / f"{readable}-{own}.parquet"


def rows_of(outcome: Outcome) -> Rows:
    """Return the rows of a session: one for each parameter, or one with the reason why there is none."""
    fit = outcome.fit
    common: dict[str, Any] = {
        "session": outcome.session.name,
        "instrument": outcome.session.instrument,
        "recorded_utc": outcome.recorded or None,
        "path": str(outcome.session.path),
    }
    if fit is None:
        return [{**common, "reason": outcome.reason}]
    common |= {
        "method": fit.method,
        "rows": fit.rows,
        "rows_used": fit.rows_used,
        "notes": "; ".join(fit.notes) or None,
    }
    return [
        {
            **common,
            "parameter": m.name,
            "unit": m.unit,
            "value": None if m.reason else m.value,
            "sd": None if m.reason else m.sd,
            "low": None if m.reason else m.value - TWO_SIDED_95 * m.sd,
            "high": None if m.reason else m.value + TWO_SIDED_95 * m.sd,
            "assumed": m.assumed,
            "reason": m.reason or None,
        }
        for m in fit.parameters
    ]


def write_rows(rows: Rows, columns: Any, path: Path) -> None:
    """Write a table completely or not at all; OSError if writing fails."""
    import pyarrow as pa  # noqa: PLC0415
    import pyarrow.parquet as pq  # noqa: PLC0415

    with whole(path) as unfinished:
        pq.write_table(pa.Table.from_pylist(rows, schema=columns), unfinished, compression="zstd")


def keep(outcome: Outcome, out: Path) -> None:
    """Write the result of a session."""
    told = {_KEY: outcome.key.encode(), _STAMP: json.dumps(outcome.stamp).encode()}
    write_rows(rows_of(outcome), schema().with_metadata(told), file_of(out, outcome.session))


def kept(out: Path, task: Task) -> Rows | None:
    """Return the stored result of a session, None if it must be fitted."""
    import pyarrow as pa  # noqa: PLC0415
    import pyarrow.parquet as pq  # noqa: PLC0415

    path = file_of(out, task.session)
    if not path.is_file():
        return None
    try:
        table = pq.read_table(path)
        told = table.schema.metadata or {}
        stamp = Stamp(*json.loads(told[_STAMP]))
        same = told[_KEY] == task.key.encode() and table.schema.names == schema().names
        if not (same and _is_of(stamp, task.session.path)):
            return None
        rows: Rows = table.to_pylist()
    except (OSError, KeyError, TypeError, ValueError, pa.ArrowException):
        return None  # damaged: it is done again
    # The same log may now be told to be another instrument's.
    return [{**row, "instrument": task.session.instrument, "path": str(task.session.path)} for row in rows]


def _is_of(stamp: Stamp, path: Path) -> bool:
    try:
        stat = path.stat()
        if stat.st_size != stamp.bytes:
            return False
        return stat.st_mtime_ns == stamp.changed_ns or stamp_of(path).digest == stamp.digest
    except OSError:
        return False


def clear_others(out: Path, sessions: Sequence[Session]) -> None:
    """Remove results of sessions that no longer exist, and partial files of killed processes.

    Other tables in the folder stay: results are recognised by their key.
    """
    wanted = {file_of(out, session) for session in sessions}
    folder = out / SESSIONS
    for path in folder.glob("*.parquet") if folder.is_dir() else ():
        if path not in wanted and _is_result(path):
            path.unlink(missing_ok=True)
    for path in folder.glob(".*.parquet.*") if folder.is_dir() else ():
        if _UNFINISHED.fullmatch(path.name):
            path.unlink(missing_ok=True)


def _is_result(path: Path) -> bool:
    import pyarrow as pa  # noqa: PLC0415
    import pyarrow.parquet as pq  # noqa: PLC0415

    try:
        return _KEY in (pq.read_schema(path).metadata or {})
    except (OSError, pa.ArrowException):
        return False
