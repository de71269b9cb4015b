"""PEAK's TRC, versions 1.0 to 2.1 (PEAK-System, "PEAK CAN TRC File Format", 2020-07-27); times in ms from the start."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from firmware_protocol.frames import Frame
from hil_forceps.data.readers.bus_logs.account import (
    FD_LENGTHS,
    Account,
    LoggedFrame,
    fits,
    is_id,
    payload,
)
from hil_forceps.data.readers.bus_logs.text_lines import Line
from hil_forceps.rig.errors import UserError

# Version 2's letters: N number, O offset, T type, B bus, I id, d direction, R reserved, L code, l length, D data.
_COLUMNS = {"1.0": "NOILD", "1.1": "NOTILD", "1.2": "NOBTILD", "1.3": "NOBTIRLD"}
_NEW_VERSIONS = frozenset(("2.0", "2.1"))
_KEY = re.compile(r";\$(FILEVERSION|COLUMNS)\s*=\s*([^;]*);?\s*", re.IGNORECASE)
_OFFSET = re.compile(r"([0-9]{1,12})(?:\.([0-9]{1,6}))?")
_FD_TYPES = frozenset(("FD", "FB", "FE", "BI"))
_DATA_TYPES = frozenset(("Rx", "Tx", "DT", *_FD_TYPES))
_OTHER_TYPES = {"RR": "remote", "ER": "error", "Error": "error"} | dict.fromkeys(("Warng", "ST", "EC", "EV"), "event")
_BASE_ID_DIGITS = 4  # an extended id has eight
_BUS_WARNING = "FFFFFFFF"


class _Layout(NamedTuple):
    version: str
    columns: str


def trc_frames(path: Path, lines: Iterator[Line], account: Account) -> Iterator[LoggedFrame]:
    """Yield the frames of a log; UserError for a version that isn't known, or columns that don't say enough."""
    layout = _Layout("1.0", _COLUMNS["1.0"])  # the first version has no such line
    for line in lines:
        text = line.text.strip()
        if line.problem:
            account.leave_out(f"line {line.number}", text, line.problem)
        elif text.startswith(";"):
            if match := _KEY.fullmatch(text):
                layout = _layout(f"{path}:{line.number}", layout, match[1].upper(), match[2].strip())
        elif text:
            if not layout.columns:
                raise UserError(f"{path}:{line.number}: no line ;$COLUMNS= before the first frame; save the log again")
            found = _frame(text.split(), layout)
            if found is None:
                account.leave_out(f"line {line.number}", text)
            elif isinstance(found, str):
                account.others[found] += 1
            else:
                yield found


def _layout(place: str, before: _Layout, key: str, value: str) -> _Layout:
    if key == "FILEVERSION":
        if value not in _COLUMNS and value not in _NEW_VERSIONS:
            raise UserError(f"{place}: TRC of version {value[:20]!r}; 1.0 to 2.1 are read: save it as 2.1")
        return _Layout(value, _COLUMNS.get(value, ""))
    columns = value.replace(",", "").replace(" ", "")
    if before.version not in _NEW_VERSIONS:
        return before
    if len(set(columns)) != len(columns) or not set("OTI") <= set(columns) or not set("lL") & set(columns):
        raise UserError(
            f"{place}: columns {value[:40]!r} must contain time, type, id and length once each; save the log again"
        )
    if columns.endswith("D") or "D" not in columns:
        return before._replace(columns=columns)
    raise UserError(f"{place}: columns {value[:40]!r}: the data must be the last column; save the log again")


def _frame(words: list[str], layout: _Layout) -> LoggedFrame | str | None:
    """Return the frame; a word for what is none; None for what can't be read."""
    place = {letter: position for position, letter in enumerate(layout.columns)}
    kind = words[place["T"]] if "T" in place and place["T"] < len(words) else "Rx"
    if kind in _OTHER_TYPES:
        return _OTHER_TYPES[kind]
    if kind not in _DATA_TYPES or len(words) < len(layout.columns.removesuffix("D")):
        return None
    identifier, data = words[place["I"]], words[len(layout.columns.removesuffix("D")) :]
    offset = _OFFSET.fullmatch(words[place["O"]])
    bus = words[place["B"]] if "B" in place else "1"
    if offset is None or len(bus) > 9 or identifier.strip("0123456789abcdefABCDEF"):
        return None
    if other := _other(identifier, data):
        return other
    is_fd = kind in _FD_TYPES
    count = _count(words, place, is_fd)
    content = payload(data)
    is_extended = len(identifier) > _BASE_ID_DIGITS
    if (
        content is None
        or len(content) != count
        or not fits(count, is_fd)
        or not is_id(int(identifier, 16), is_extended)
    ):
        return None
    time_ns = int(offset[1]) * 1_000_000 + int((offset[2] or "").ljust(6, "0"))
    return LoggedFrame(time_ns, bus, Frame(int(identifier, 16), content, is_fd, is_extended))


def _other(identifier: str, data: list[str]) -> str:
    if identifier == _BUS_WARNING:
        return "event"
    if data and data[0].upper() == "ERROR":
        return "error"
    return "remote" if data and data[0].upper() == "RTR" else ""


def _count(words: list[str], place: dict[str, int], is_fd: bool) -> int:
    """Return how many bytes the line says there are, -1 when it says nothing that makes sense."""
    word = words[place["l"]] if "l" in place else words[place["L"]]
    if len(word) > 2 or word.strip("0123456789"):
        return -1
    if "l" in place:
        return int(word)
    return FD_LENGTHS[int(word)] if is_fd and int(word) < len(FD_LENGTHS) else int(word)
