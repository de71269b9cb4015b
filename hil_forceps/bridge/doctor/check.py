"""One check of `hil-forceps doctor`, and its result."""

from enum import StrEnum
from typing import NamedTuple


class Verdict(StrEnum):
    """Result of a check, as in JSON."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"
    UNKNOWN = "could not look"


class Check(NamedTuple):
    """A check's outcome. `text` may quote files and drives; it is made printable when it is shown."""

    id: str
    what: str  # was checked
    verdict: Verdict
    text: str  # what was found, or why the check was not possible
    remedy: str = ""  # a command, or what to change; empty if the check passed
    value: float | None = None
    unit: str = ""


def unknown(check_id: str, what: str, why: str) -> Check:
    """Return a check that could not be made."""
    return Check(check_id, what, Verdict.UNKNOWN, why)


def why(error: OSError) -> str:
    """Return the system's reason for which something can't be read."""
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror or error}"
