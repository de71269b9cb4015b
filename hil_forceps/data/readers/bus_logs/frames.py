"""Frames out of bus logs: candump, ASC, BLF, TRC."""

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from hil_forceps.data.readers.bus_logs.account import Account, LoggedFrame
from hil_forceps.data.readers.bus_logs.asc import asc_frames
from hil_forceps.data.readers.bus_logs.blf import MAGIC, blf_frames
from hil_forceps.data.readers.bus_logs.candump import candump_frames
from hil_forceps.data.readers.bus_logs.text_lines import text_lines
from hil_forceps.data.readers.bus_logs.trc import trc_frames
from hil_forceps.data.readers.format import Format, Request
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError

MAX_BUSES = 256  # names of buses that are told; a log with more is none
_TEXT_LOGS = {".log": candump_frames, ".asc": asc_frames, ".trc": trc_frames}
LOG_SUFFIXES = frozenset((*_TEXT_LOGS, ".blf"))


def read_frames(path: Path, kind: str = "", account: Account | None = None) -> Iterator[LoggedFrame]:
    """Yield the data frames, in the order of the log; what else stands in it goes to `account`.

    `kind`, one of `LOG_SUFFIXES`, says the format, else the suffix does. At most one frame for each line of a text, or
    for 16 unpacked bytes of a BLF. UserError when there is no such file, it isn't of that format, or nothing in it can
    be read.
    """
    kind = kind or path.suffix.lower()
    account = Account() if account is None else account
    count = 0
    try:
        with path.open("rb") as file:
            for frame in _frames_of(path, file, kind, account):
                count += 1
                yield frame
    except OSError as error:
        raise UserError(f"{path}: not readable as a {kind} log: {error.strerror or error}") from error
    if not count and (account.damage or account.unreadable):
        first = account.first_unreadable or account.damage
        remedy = "correct its suffix, or save it again"
        raise UserError(f"{path}: not readable as a {kind} log: it contains no frame, first {first}; {remedy}")


def _frames_of(path: Path, file: BinaryIO, kind: str, account: Account) -> Iterator[LoggedFrame]:
    if kind == ".blf":
        return blf_frames(path, file, account)
    return _TEXT_LOGS[kind](path, text_lines(path, file), account)


def of_bus(path: Path, frames: Iterable[LoggedFrame], bus: str | None) -> Iterator[LoggedFrame]:
    """Yield the frames of one bus, of all when None; UserError, with the buses there are, when none is of this one."""
    if bus is None:
        yield from frames
        return
    others: set[str] = set()
    is_there = False
    for frame in frames:
        if frame.bus == bus:
            is_there = True
            yield frame
        elif len(others) < MAX_BUSES:
            others.add(frame.bus)
    if not is_there:
        there = ", ".join(sorted(others)) or "no bus"
        raise UserError(f"{path}: contains no frame of bus {bus!r}; use --bus with one of: {there}")


def _as_runs(kind: str) -> Callable[[Request], list[Run]]:
    def read(request: Request) -> list[Run]:
        from hil_forceps.data.readers.bus_logs.run import read_bus_log  # noqa: PLC0415 - the protocol, for bus logs only

        return read_bus_log(request.path, kind, request.choice)

    return read


_CANDUMP = re.compile(rb"(?:\xef\xbb\xbf)?\s*\([0-9]+\.[0-9]+\)\s+\S+\s+[0-9A-Fa-f]{3,8}#")
# The service writes a recording and a bus log of one run: logs are read only where nothing else in a folder is a run.
CANDUMP = Format(
    "candump",
    (".log",),
    _as_runs(".log"),
    by_suffix=True,
    looks_like=lambda head: _CANDUMP.match(head) is not None,
    in_folder="otherwise",
)
ASC = Format("ASC", (".asc",), _as_runs(".asc"), by_suffix=True, in_folder="otherwise")
BLF = Format("BLF", (".blf",), _as_runs(".blf"), magic=(MAGIC,), in_folder="otherwise")
TRC = Format("TRC", (".trc",), _as_runs(".trc"), by_suffix=True, in_folder="otherwise")
