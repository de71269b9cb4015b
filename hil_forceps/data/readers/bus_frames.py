"""Frames out of the bus logs that python-can reads: candump, ASC, BLF, TRC."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

from firmware_protocol.frames import Frame
from hil_forceps.data.readers.format import Format, Request
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError

LOG_SUFFIXES = frozenset({".log", ".asc", ".blf", ".trc"})


class Stamped(NamedTuple):
    """A frame and when it was on the bus; None where nobody said."""

    time_s: float | None
    frame: Frame


def read_frames(path: Path, kind: str = "") -> Iterator[Stamped]:
    """Yield the data frames, with ids of 11 and of 29 bits; error and remote frames are passed over.

    `kind`, one of `LOG_SUFFIXES`, says the format, else the suffix does. UserError when there is no such file or it
    can't be read as that.
    """
    import can  # noqa: PLC0415 - a third of a second that only this branch needs

    kind = kind or path.suffix.lower()
    try:
        # Opened here: a reader of python-can that refuses a file's head leaves the file open.
        with _open(path, kind) as file:
            for message in _reader(can, kind)(file):
                if message.is_error_frame or message.is_remote_frame:
                    continue
                frame = Frame(message.arbitration_id, bytes(message.data), message.is_fd, message.is_extended_id)
                yield Stamped(message.timestamp, frame)
    except OSError as error:
        raise UserError(f"{path}: not readable as a {kind} log: {error.strerror or error}") from error
    except Exception as error:  # python-can's readers raise whatever their parsers raise on a broken file
        raise UserError(f"{path}: not readable as a {kind} log: {error}") from error


def _open(path: Path, kind: str) -> IO[Any]:
    return path.open("rb") if kind == ".blf" else path.open(encoding="utf-8")


def _reader(can: Any, kind: str) -> Any:
    readers = {".log": can.CanutilsLogReader, ".asc": can.ASCReader, ".blf": can.BLFReader, ".trc": can.TRCReader}
    return readers[kind]


def _as_runs(kind: str) -> Callable[[Request], list[Run]]:
    def read(request: Request) -> list[Run]:
        from hil_forceps.data.readers.bus_run import read_bus_log  # noqa: PLC0415 - python-can, for bus logs only

        return read_bus_log(request.path, kind)

    return read


_CANDUMP = re.compile(rb"\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]{3,8}#")
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
BLF = Format("BLF", (".blf",), _as_runs(".blf"), magic=(b"LOGG",), in_folder="otherwise")
TRC = Format("TRC", (".trc",), _as_runs(".trc"), by_suffix=True, in_folder="otherwise")
