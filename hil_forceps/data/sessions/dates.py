"""When a session was: what the table says, else its recording, else its name, else, where that is wished, its file.

The time of a file changes with a copy, so it is taken only when it is asked for.
"""

import re
from datetime import UTC, datetime
from typing import Literal, NamedTuple

from hil_forceps.rig.errors import UserError

DateSource = Literal["table", "recording", "name", "file", ""]

# 2026-11-28, 20261128, both with a time behind T, _, - or a blank: T0930, _09-30-15, 093015. Nothing else is a date
# for sure: 28-11-2026 and 11-28-2026 look alike.
_DATE = re.compile(
    r"(?<!\d)(?P<year>(?:19|20)\d\d)(?P<dash>-?)(?P<month>\d\d)(?P=dash)(?P<day>\d\d)"
    r"(?:[T_ -]?(?P<hour>\d\d)[-:.h]?(?P<minute>\d\d)(?:[-:.]?(?P<second>\d\d))?(?P<zone>Z)?)?(?!\d)"
)
REMEDY = (
    "name its file by its date (2026-11-28_0930.mcap), give its date in sessions.csv, or take the times of the files "
    "with --file-dates"
)


class Dated(NamedTuple):
    """When a session was, in UTC, and who says so; both empty where nobody does."""

    date: datetime | None
    source: DateSource


def date_of(name: str, told: str, recorded: str, file_time_s: float | None) -> Dated:
    """Return when a session was.

    `told`: by the table; `recorded`: by the recording, both ISO 8601 or empty. `file_time_s`: Unix time of the file,
    where it may be taken. UserError for a date of the table that is none.
    """
    if told:
        return Dated(parsed(told, f"session {name}: date {told!r}"), "table")
    if recorded:
        try:
            return Dated(parsed(recorded, name), "recording")
        except UserError:  # damage: the next best, then
            pass
    by_name = date_in(name)
    if by_name is not None:
        return Dated(by_name, "name")
    if file_time_s is not None:
        return Dated(datetime.fromtimestamp(file_time_s, UTC), "file")
    return Dated(None, "")


def parsed(text: str, what: str) -> datetime:
    """Return a date of ISO 8601, UTC unless it says otherwise; UserError for any other text."""
    try:
        date = datetime.fromisoformat(text.strip())
    except ValueError as error:
        raise UserError(f"{what}: is not a date; write it as 2026-11-28 or 2026-11-28T09:30") from error
    return date.replace(tzinfo=UTC) if date.tzinfo is None else date.astimezone(UTC)


def date_in(name: str) -> datetime | None:
    """Return the date in a name; the last of several parts of a path that have one."""
    for part in reversed(name.split("/")):
        for match in _DATE.finditer(part):
            parts = match.groupdict()
            time = [int(parts[key] or 0) for key in ("hour", "minute", "second")]
            day = [int(parts[key]) for key in ("year", "month", "day")]
            try:
                return datetime(day[0], day[1], day[2], time[0], time[1], time[2], tzinfo=UTC)
            except ValueError:  # 20261340 is a number
                continue
    return None
