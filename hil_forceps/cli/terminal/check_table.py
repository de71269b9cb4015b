"""Checks of `hil-forceps doctor` on standard output, in at most 80 columns for any text."""

import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final

from hil_forceps.bridge.doctor.check import Check, Verdict
from hil_forceps.rig.errors import one_line

WIDTH: Final = 80
_VERDICT_COLUMNS: Final = 5
_ID_COLUMNS: Final = 22
_INDENT: Final = _VERDICT_COLUMNS + _ID_COLUMNS
_COUNTED: Final = {Verdict.OK: "ok", Verdict.WARN: "warn", Verdict.FAIL: "fail", Verdict.UNKNOWN: "not checked"}
_SHORT: Final = {Verdict.OK: "ok", Verdict.WARN: "warn", Verdict.FAIL: "FAIL", Verdict.UNKNOWN: "-"}


def lines(checks: Sequence[Check]) -> Iterator[str]:
    """Return the lines of the table, and a last line with the number of checks by verdict."""
    for check in checks:
        if check.verdict is not Verdict.UNKNOWN or check.remedy:
            yield from _row(check)
    yield from _not_looked_at(checks)
    counts = Counter(check.verdict for check in checks)
    yield ", ".join(f"{counts[verdict]} {_COUNTED[verdict]}" for verdict in Verdict if counts[verdict])


def _not_looked_at(checks: Sequence[Check]) -> Iterator[str]:
    """Return the checks that were not possible, grouped by reason."""
    reasons: dict[str, list[str]] = {}
    for check in checks:
        if check.verdict is Verdict.UNKNOWN and not check.remedy:
            reasons.setdefault(check.text, []).append(check.id)
    for reason, names in reasons.items():
        text = one_line(f"not checked: {', '.join(names)}: {reason}")
        yield from textwrap.wrap(text, WIDTH, initial_indent="-    ", subsequent_indent="     ", break_on_hyphens=False)


def _row(check: Check) -> Iterator[str]:
    name = one_line(check.id)[: WIDTH - _VERDICT_COLUMNS]
    head = f"{_SHORT[check.verdict]:{_VERDICT_COLUMNS}}{name:{_ID_COLUMNS}}"
    text = f"not checked: {check.text}" if check.verdict is Verdict.UNKNOWN else check.text
    rest = _wrapped(text) + _wrapped(check.remedy, "-> ", "   ")
    if len(name) >= _ID_COLUMNS:
        yield head.rstrip()
        head = " " * _INDENT
    yield (head + (rest[0] if rest else "")).rstrip()
    for line in rest[1:]:
        yield " " * _INDENT + line


def _wrapped(text: str, first: str = "", further: str = "") -> list[str]:
    return textwrap.wrap(
        one_line(text),
        WIDTH - _INDENT,
        initial_indent=first,
        subsequent_indent=further,
        break_on_hyphens=False,
    )
