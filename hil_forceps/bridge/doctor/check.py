"""One thing that was looked at, and what came of it."""

from enum import StrEnum
from typing import NamedTuple


class Verdict(StrEnum):
    """What a check says."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"
    UNKNOWN = "could not look"


class Check(NamedTuple):
    """A check's outcome. `text` may quote what files and drives say, so it is made printable where it is shown."""

    id: str
    what: str  # was looked at
    verdict: Verdict
    text: str  # what was found; where it could not be looked at, why
    remedy: str = ""  # a line to type, or what to change; empty where all is well
    value: float | None = None
    unit: str = ""


def unknown(check_id: str, what: str, why: str) -> Check:
    """Return a check that could not be made."""
    return Check(check_id, what, Verdict.UNKNOWN, why)


def why(error: OSError) -> str:
    """Return what the system says against reading something, in words."""
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror or error}"
