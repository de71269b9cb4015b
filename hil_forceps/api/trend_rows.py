"""Rows of estimates as input for the search for changes: dates, order, one table."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from hil_forceps.api.batch.store import Rows, schema, write_rows
from hil_forceps.data.sessions.dates import REMEDY, date_of
from hil_forceps.data.sessions.session import Session
from hil_forceps.drift.family import Estimated
from hil_forceps.drift.result import SessionLine, When


def session_lines(
    sessions: Sequence[Session], rows: Sequence[dict[str, Any]], *, file_dates: bool
) -> tuple[list[SessionLine], dict[str, datetime]]:
    """Return a line for each session, in their order, and the known dates by name."""
    first = {row["session"]: row for row in reversed(rows)}
    lines, dates = [], {}
    for session in sessions:
        row = first[session.name]
        # For a log in another folder only its path is known.
        file_time_s = session.path.stat().st_mtime if file_dates and session.path.is_file() else None
        dated = date_of(session.name, session.told_date, row["recorded_utc"] or "", file_time_s)
        reason = row["reason"] if row["parameter"] is None else None
        if reason is None and dated.date is None:
            reason = f"no date is known; {REMEDY}"
        if dated.date is not None:
            dates[session.name] = dated.date
        date = None if dated.date is None else iso(dated.date)
        lines.append(SessionLine(session.name, session.instrument, date, dated.source, reason, row["notes"]))
    lines.sort(key=lambda line: (line.instrument, line.date or "", line.name))
    return lines, dates


def iso(date: datetime) -> str:
    """Return a date as text, to the second, UTC."""
    return date.strftime("%Y-%m-%dT%H:%M:%SZ")


def estimated(rows: Rows, dates: dict[str, datetime]) -> list[Estimated]:
    """Return the parameters of one instrument over its dated sessions; those of one date are in order of names."""
    measured = [row for row in rows if row["value"] is not None and row["session"] in dates]
    measured.sort(key=lambda row: (dates[row["session"]], row["session"]))
    found = []
    for name in dict.fromkeys(row["parameter"] for row in rows if row["parameter"] is not None):
        own = [row for row in measured if row["parameter"] == name]
        if own:
            found.append(
                Estimated(
                    name,
                    own[0]["unit"],
                    own[0]["assumed"],
                    tuple(When(row["session"], iso(dates[row["session"]])) for row in own),
                    tuple(row["value"] for row in own),
                    tuple(row["sd"] for row in own),
                )
            )
    return found


def consolidated(rows: Rows, lines: Sequence[SessionLine], dates: dict[str, datetime], path: Path) -> Rows:
    """Write all estimates as one table, in the order of instruments and dates, and return it."""
    import pyarrow as pa  # noqa: PLC0415 - takes a while to load

    place = {line.name: (at, line) for at, line in enumerate(lines)}
    ordered = sorted(rows, key=lambda row: place[row["session"]][0])
    whole = [
        {
            **{name: row[name] for name in schema().names},
            "date": dates.get(row["session"]),
            "date_from": place[row["session"]][1].date_from or None,
        }
        for row in ordered
    ]
    columns = schema()
    for name, kind in (("date", pa.timestamp("us", tz="UTC")), ("date_from", pa.string())):
        columns = columns.append(pa.field(name, kind))
    write_rows(whole, columns, path)
    return whole
