"""Vector's ASC: CAN and CAN FD frames, absolute and relative stamps, hexadecimal and decimal.

A relative stamp counts from the event before it, of whatever kind; so every event moves the clock on, and where one
can't be read, all later times are lost. Checked against logs in python-can's repository (`test/data/*.asc`).
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.frames import Frame
from hil_forceps.data.readers.bus_logs.account import (
    FD_LENGTHS,
    Account,
    LoggedFrame,
    fits,
    is_id,
    payload,
    seconds_ns,
    show,
)
from hil_forceps.data.readers.bus_logs.text_lines import Line
from hil_forceps.rig.errors import UserError

_BASE = re.compile(r"base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?", re.IGNORECASE)
_EVENT = re.compile(r"([0-9]{1,12})\.([0-9]{1,9})\s+(\S.*)")
_BLOCK = re.compile(r"begin\s+trigger\s?block\b", re.IGNORECASE)
_HEAD = re.compile(r"(?:date|end\s+trigger\s?block|(?:no\s+)?internal\s+events\s+logged)\b", re.IGNORECASE)
_NUMBER = "[0-9A-Fa-f]"
_CLASSIC = re.compile(
    rf"(?P<bus>[0-9]{{1,9}})\s+(?P<id>{_NUMBER}{{1,10}})(?P<extended>x?)\s+(?P<way>rx|txrq|tx)\s+"
    rf"(?:(?P<remote>r)\b.*|d\s+(?P<code>{_NUMBER}{{1,2}})(?P<rest>\s.*)?)",
    re.IGNORECASE,
)
# The name before the bit-rate switch is there where a database was: the lazy one, tried last.
_FD = re.compile(
    rf"canfd\s+(?P<bus>[0-9]{{1,9}})\s+(?P<way>rx|txrq|tx)\s+(?P<id>{_NUMBER}{{1,10}})(?P<extended>x?)\s+(?:\S+\s+)??"
    rf"(?P<switch>[01])\s+[01]\s+(?P<code>{_NUMBER})\s+(?P<count>[0-9]{{1,2}})(?P<rest>\s.*)?",
    re.IGNORECASE,
)
_ERROR = re.compile(r"(?:canfd\s+)?[0-9]{1,9}\s+(?:[rt]x\s+)?errorframe\b", re.IGNORECASE)
# What begins like a frame and isn't one is damage; all else is an event of another kind, or has its id in words.
_BEGUN = re.compile(rf"canfd\b|[0-9]{{1,9}}\s+{_NUMBER}+x?\b", re.IGNORECASE)
_REQUEST = "txrq"  # asked for, not yet sent: the frame follows as Tx
_EDL_FLAG = 0x1000  # of the third number behind the data: an FD frame


@dataclass(slots=True)
class _Head:
    """What the lines before the frames say."""

    base: int = 16
    is_relative: bool | None = None  # None until said
    blocks: int = 0

    def take(self, text: str) -> bool:
        """Take a line that is no event; False when it is none of a head either."""
        if match := _BASE.match(text):
            self.base = 16 if match[1].lower() == "hex" else 10
            self.is_relative = None if match[2] is None else match[2].lower() == "relative"
            return True
        if _BLOCK.match(text):
            self.blocks += 1
            return True
        return _HEAD.match(text) is not None


def asc_frames(path: Path, lines: Iterator[Line], account: Account) -> Iterator[LoggedFrame]:
    """Yield the frames of a log; UserError where what its stamps count from is not said."""
    head = _Head()
    clock_ns = 0
    for line in lines:
        text = line.text.strip()
        if not line.problem and (not text or text.startswith("//")):
            continue
        event = None if line.problem else _EVENT.fullmatch(text)
        if event is None:
            if not line.problem and head.take(text):
                _check_blocks(path, line, head)
                continue
            account.leave_out(f"line {line.number}", text, line.problem)
            if head.is_relative:
                account.damage = _lost_time(line)
                return
            continue
        if head.is_relative is None:
            told = "the header has no origin of the stamps; write `base hex timestamps absolute`, or relative, there"
            raise UserError(f"{path}:{line.number}: {told}")
        stamp_ns = seconds_ns(event[1], event[2])
        clock_ns = clock_ns + stamp_ns if head.is_relative else stamp_ns
        found = _frame(event[3], head.base)
        if found is None:
            account.leave_out(f"line {line.number}", text)
        elif isinstance(found, str):
            account.others[found] += 1
        else:
            bus, frame = found
            yield LoggedFrame(clock_ns, bus, frame)


def _check_blocks(path: Path, line: Line, head: _Head) -> None:
    if head.is_relative and head.blocks > 1:
        told = "a second trigger block with relative stamps has no known start time"
        raise UserError(
            f"{path}:{line.number}: {told}; save the log with absolute stamps, or each block to its own file"
        )


def _lost_time(line: Line) -> str:
    return (
        f"line {line.number} ({line.problem or show(line.text)}): with relative stamps the following frames have no "
        "time"
    )


def _frame(text: str, base: int) -> tuple[str, Frame] | str | None:
    """Return bus and frame; a word for what is none; None for what should be one and isn't."""
    if _ERROR.match(text):
        return "error"
    if match := _CLASSIC.fullmatch(text):
        return _other(match, bool(match["remote"])) or _classic(match, base)
    if match := _FD.fullmatch(text):
        return _other(match, match["count"].strip("0") == "" and match["code"] != "0") or _fd(match, base)
    return None if _BEGUN.match(text) else "event"


def _other(match: re.Match[str], is_remote: bool) -> str:
    if match["way"].lower() == _REQUEST:
        return "request"
    return "remote" if is_remote else ""


def _classic(match: re.Match[str], base: int) -> tuple[str, Frame] | None:
    code = _number(match["code"], base)
    if code is None or code >= len(FD_LENGTHS):
        return None
    return _checked(match, base, min(code, 8), is_fd=False)


def _fd(match: re.Match[str], base: int) -> tuple[str, Frame] | None:
    count, code = int(match["count"]), int(match["code"], 16)
    is_fd = count > 8 or match["switch"] == "1" or _has_fd_flag((match["rest"] or "").split()[count:])
    shortest = FD_LENGTHS[code - 1] + 1 if is_fd and code else 0  # with that code
    if not shortest <= count <= FD_LENGTHS[code] or (not is_fd and count != min(code, 8)):
        return None
    return _checked(match, base, count, is_fd=is_fd)


def _checked(match: re.Match[str], base: int, count: int, *, is_fd: bool) -> tuple[str, Frame] | None:
    identifier = _number(match["id"], base)
    data = payload((match["rest"] or "").split()[:count], base)
    is_extended = bool(match["extended"])
    if identifier is None or not is_id(identifier, is_extended) or data is None or len(data) != count:
        return None
    return (match["bus"], Frame(identifier, data, is_fd, is_extended)) if fits(count, is_fd) else None


def _has_fd_flag(behind: list[str]) -> bool:
    """Tell by the flags behind the data; without flags what stands under CANFD is taken for what it says."""
    flags = _number(behind[2], 16) if len(behind) > 2 else None
    return flags is None or bool(flags & _EDL_FLAG)


def _number(word: str, base: int) -> int | None:
    try:
        return int(word, base)
    except ValueError:
        return None
