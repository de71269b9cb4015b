"""What the checks read of this machine, as a port: the system itself, or a folder of recorded texts in its place."""

import ctypes
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple, Protocol

MAX_READ_BYTES: Final = 1 << 16  # of a file or an answer; what is longer is cut
COMMAND_TIMEOUT_S: Final = 5.0
_STA_UNSYNC: Final = 0x40  # adjtimex(2): the clock isn't synchronised


class Space(NamedTuple):
    """What a file system has left for this user."""

    free_bytes: int
    is_writable: bool


class ClockStatus(NamedTuple):
    """What the kernel says of its wall clock."""

    is_synchronised: bool
    max_error_s: float


class Reads(Protocol):
    """All of it raises OSError where the machine doesn't tell, and nothing else."""

    def text(self, path: str) -> str:
        """Return a file, without blanks around it."""

    def names(self, folder: str) -> list[str]:
        """Return what is in a folder, sorted."""

    def target(self, path: str) -> str:
        """Return the path behind all links."""

    def run(self, command: Sequence[str]) -> str:
        """Return what a command says."""

    def scheduling(self) -> tuple[int, int]:
        """Return policy and priority of this process."""

    def cores(self) -> frozenset[int]:
        """Return the cores that this process may run on."""

    def clock_status(self) -> ClockStatus:
        """Return the state of the wall clock."""

    def space(self, folder: str) -> Space:
        """Return what the file system of a folder has left."""

    def may_open(self, path: str) -> bool:
        """Tell whether this user may read and write a device; FileNotFoundError where there is none."""


class System:
    """This machine; files are looked up below `root`."""

    def __init__(self, root: Path = Path("/")) -> None:
        self._root = root

    def text(self, path: str) -> str:
        """See `Reads`."""
        with self._place(path).open("rb") as file:
            return file.read(MAX_READ_BYTES).decode("utf-8", "replace").strip()

    def names(self, folder: str) -> list[str]:
        """See `Reads`."""
        return sorted(entry.name for entry in self._place(folder).iterdir())

    def target(self, path: str) -> str:
        """See `Reads`."""
        return str(self._place(path).resolve(strict=True))

    def run(self, command: Sequence[str]) -> str:
        """See `Reads`; its words where it ends with an error."""
        try:
            # `ip` with a device's name as one argument, no shell
            done = subprocess.run(command, capture_output=True, timeout=COMMAND_TIMEOUT_S, check=False)  # noqa: S603
        except subprocess.TimeoutExpired as error:
            raise TimeoutError(f"{command[0]} does not end") from error
        except ValueError as error:  # a NUL in an argument
            raise OSError(f"{command[0]}: {error}") from error
        if done.returncode:
            words = " ".join(done.stderr[:MAX_READ_BYTES].decode("utf-8", "replace").split())
            raise OSError(f"{command[0]}: {words or f'exit code {done.returncode}'}")
        return done.stdout[:MAX_READ_BYTES].decode("utf-8", "replace")

    def scheduling(self) -> tuple[int, int]:
        """See `Reads`."""
        return os.sched_getscheduler(0), os.sched_getparam(0).sched_priority

    def cores(self) -> frozenset[int]:
        """See `Reads`."""
        return frozenset(os.sched_getaffinity(0))

    def clock_status(self) -> ClockStatus:
        """See `Reads`; adjtimex(2) with nothing to set."""
        timex = _Timex()
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.adjtimex(ctypes.byref(timex)) < 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))
        return ClockStatus(not timex.status & _STA_UNSYNC, timex.maxerror * 1e-6)

    def space(self, folder: str) -> Space:
        """See `Reads`."""
        found = os.statvfs(folder)
        is_writable = os.access(folder, os.W_OK | os.X_OK) and not found.f_flag & os.ST_RDONLY
        return Space(found.f_bavail * found.f_frsize, is_writable)

    def may_open(self, path: str) -> bool:
        """See `Reads`."""
        Path(path).stat()
        return os.access(path, os.R_OK | os.W_OK)

    def _place(self, path: str) -> Path:
        if "\0" in path:
            raise FileNotFoundError(f"no file has such a name: {path!r}")
        return self._root / path.lstrip("/")


class _Timex(ctypes.Structure):
    """`struct timex` of <sys/timex.h>, as far as it is read; the rest is room for it."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 256),
    )
