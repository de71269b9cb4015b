"""candump of can-utils: its log format (`-l`, `-L`) and what it prints for people, with stamps of every kind.

The formats are those of can-utils' `candump.c` and `lib.c`. `-t a` prints seconds since 1970 with ten digits, `-t A`
the local date, `-t d` and `-t z` three digits or more: the time since the frame before, or since the first one.
"""

import re
from collections.abc import Iterator
from datetime import date
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from firmware_protocol.frames import MAX_EXTENDED_ID, Frame
from hil_forceps.data.readers.bus_logs.account import Account, LoggedFrame, fits, payload, seconds_ns, show
from hil_forceps.data.readers.bus_logs.text_lines import Line
from hil_forceps.rig.errors import UserError

RECORD_AGAIN = "record with candump -L, or print with candump -ta"
_ERROR_FLAG = 0x2000_0000  # CAN_ERR_FLAG of linux/can.h; an id has 29 bits
_BASE_ID_DIGITS = 3
_ID = r"(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})"
_LOG = re.compile(
    r"(?:\((?P<s>[0-9]{1,12})\.(?P<f>[0-9]{1,9})\)\s+(?P<bus>\S{1,64})\s+)?"
    rf"{_ID}#(?:(?P<remote>[Rr][0-9A-Fa-f]?)|(?P<fd>#[0-9A-Fa-f])?(?P<data>(?:[0-9A-Fa-f]{{2}})*))(?:_[0-9A-Fa-f])?"
    r"(?:\s+[RT])?"
)
_PRINTED = re.compile(
    r"(?:\((?:(?P<s>[0-9]{1,12})|(?P<y>[0-9]{4})-(?P<mo>[0-9]{2})-(?P<d>[0-9]{2}) "
    r"(?P<h>[0-9]{2}):(?P<mi>[0-9]{2}):(?P<se>[0-9]{2}))\.(?P<f>[0-9]{6})\)\s+)?"
    rf"(?P<bus>\S{{1,64}})\s+(?:[RT]X\s+[B-] [E-]\s+)?{_ID}\s+\[(?P<n>[0-9]{{1,2}})\](?:\s+(?P<rest>\S.*))?"
)
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")  # candump -c
_SECONDS_DIGITS = 10  # of -t a; a difference has fewer, or lasts for 31 years
_NOT_FRAMES = ("#", ";", "//", "\t")  # comments, and the words that -e puts under an error frame
_DROPPED = "DROPCOUNT:"


class Clock(Enum):
    """What a stamp counts from."""

    NONE = "no stamps"
    ABSOLUTE = "seconds since 1970"
    DATE = "dates"
    DIFFERENCE = "differences"


class Entry(NamedTuple):
    """One line: `frame` is None for what is no data frame, and `other` says what it is."""

    clock: Clock
    time_ns: int | None
    bus: str
    frame: Frame | None
    other: str = ""


def parse_entry(text: str) -> Entry | None:
    """Read one line of either format; None when it is neither."""
    if match := _LOG.fullmatch(text):
        return _of_log(match)
    match = _PRINTED.fullmatch(text)
    return None if match is None else _printed(match)


def candump_frames(path: Path, lines: Iterator[Line], account: Account) -> Iterator[LoggedFrame]:
    """Yield the frames of a log; UserError where its stamps are differences and go back: then nobody knows from what.

    Differences from the first frame never go back; those from the frame before do at every second frame.
    """
    clock: Clock | None = None
    last_ns = 0
    for line in lines:
        text = _COLOUR.sub("", line.text) if "\x1b" in line.text else line.text
        if not line.problem and (not text.strip() or text.startswith(_NOT_FRAMES)):
            continue
        if not line.problem and text.startswith(_DROPPED):
            account.remark(f"candump lost frames (line {line.number}: {show(text)})")
            continue
        entry = None if line.problem else parse_entry(text.strip())
        if entry is None:
            account.leave_out(f"line {line.number}", text, line.problem)
            continue
        if clock is None:
            clock = entry.clock
            if clock is Clock.DATE:
                account.remark("its dates are those of the clock of the recording computer")
        elif entry.clock is not clock:
            account.leave_out(f"line {line.number}", text, f"{entry.clock.value}, after {clock.value}")
            continue
        if clock is Clock.DIFFERENCE and entry.time_ns is not None and entry.time_ns < last_ns:
            told = "its stamps go back: they are differences to the frame before (candump -td), which are incomplete"
            raise UserError(f"{path}:{line.number}: {told}; {RECORD_AGAIN}")
        last_ns = entry.time_ns or 0
        if entry.frame is None:
            account.others[entry.other] += 1
        else:
            yield LoggedFrame(entry.time_ns, entry.bus, entry.frame)


def _of_log(match: re.Match[str]) -> Entry | None:
    clock, time_ns = Clock.NONE, None
    if match["s"]:
        clock, time_ns = Clock.ABSOLUTE, seconds_ns(match["s"], match["f"])
    bus = match["bus"] or ""
    if other := _other(match["id"], bool(match["remote"])):
        return Entry(clock, time_ns, bus, None, other)
    data = bytes.fromhex(match["data"])
    is_fd = match["fd"] is not None
    if not fits(len(data), is_fd):
        return None
    return Entry(clock, time_ns, bus, _frame(match["id"], data, is_fd))


def _printed(match: re.Match[str]) -> Entry | None:
    count, rest = match["n"], match["rest"] or ""
    stamp = _stamp(match)
    if stamp is None:
        return None
    clock, time_ns = stamp
    if other := _other(match["id"], rest.startswith("remote request")) or ("error" if "ERRORFRAME" in rest else ""):
        return Entry(clock, time_ns, match["bus"], None, other)
    is_fd = len(count) > 1  # can-utils prints [8] for a classic frame, [08] for an FD one
    tokens = rest.split(maxsplit=int(count))
    data = payload(tokens[: int(count)])
    after = tokens[int(count) :]
    is_plain = not after or after[0].startswith("'")  # -a puts the characters behind the bytes
    if data is None or len(data) != int(count) or not fits(len(data), is_fd) or not is_plain:
        return None
    return Entry(clock, time_ns, match["bus"], _frame(match["id"], data, is_fd))


def _stamp(match: re.Match[str]) -> tuple[Clock, int | None] | None:
    if match["s"]:
        is_absolute = len(match["s"]) >= _SECONDS_DIGITS
        return (Clock.ABSOLUTE if is_absolute else Clock.DIFFERENCE), seconds_ns(match["s"], match["f"])
    if match["y"] is None:
        return Clock.NONE, None
    try:
        days = date(int(match["y"]), int(match["mo"]), int(match["d"])).toordinal() - date(1970, 1, 1).toordinal()
    except ValueError:
        return None
    seconds = ((days * 24 + int(match["h"])) * 60 + int(match["mi"])) * 60 + int(match["se"])
    return Clock.DATE, seconds * 1_000_000_000 + int(match["f"]) * 1000


def _frame(identifier: str, data: bytes, is_fd: bool) -> Frame:
    return Frame(int(identifier, 16), data, is_fd, len(identifier) > _BASE_ID_DIGITS)


def _other(identifier: str, is_remote: bool) -> str:
    """Return what no data frame is; an id beyond 29 bits has a flag of linux/can.h, of an error or of nothing known."""
    if int(identifier, 16) > MAX_EXTENDED_ID:
        return "error" if int(identifier, 16) & _ERROR_FLAG else "event"
    return "remote" if is_remote else ""
