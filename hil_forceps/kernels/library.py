"""A library out of C text: compiled once, kept, loaded."""

import ctypes
import os
import shlex
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Sequence
from functools import cache
from importlib import resources
from pathlib import Path

from llvmlite.binding import get_host_cpu_features
from numba.core import event

COMPILING = "hil_forceps:compile"

# The same bits as numba's code: no contraction of a·b + c, no other order of a sum. Neither `errno` nor the flags of
# the floating-point unit are looked at here, and to keep them right would take time.
_FLAGS = (
    "-std=c99",
    "-O2",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fwrapv",
    "-DHF_OVERFLOW_TO_HEAP",
    "-fPIC",
    "-shared",
    "-w",
)
# The step of the plant is many small functions, each called from two or three places: gcc's own limits leave most of
# them out of line, and a row takes twice as long. Without any limits compiling takes ten times as long for nothing.
_INLINING = ("max-inline-insns-auto=200", "large-function-growth=1000", "inline-unit-growth=300")


def compiler() -> list[str] | None:
    """Return the command of the C compiler, `CC` where that is set; None where there is none."""
    command = shlex.split(os.environ.get("CC", "cc"))
    return command if command and shutil.which(command[0]) else None


@cache
def flags(*, vectorised: bool) -> tuple[str, ...]:
    """Return the compiler's options on this machine: what they are, a library's name must tell.

    `vectorised`: for loops over many columns. Elsewhere that is no faster, and compiles for half as long again.
    """
    wide = ("-mavx2",) if get_host_cpu_features().get("avx2") else ()
    return (*_FLAGS, *(("-O3",) if vectorised else ()), *wide)


def _inlining(command: list[str]) -> list[str]:
    """Return options that gcc alone knows."""
    told = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)  # noqa: S603 - see above
    return [f"--param={each}" for each in _INLINING] if "Free Software Foundation" in told.stdout else []


def library(path: Path, text: str, options: Sequence[str]) -> ctypes.CDLL | None:
    """Compile C text to a library at `path`; None, and a warning, where the compiler can't.

    `COMPILING` is told to numba's listeners meanwhile.
    """
    command = compiler()
    if command is None:
        return None
    with event.trigger_event(COMPILING):
        return _compiled([*command, *options, *_inlining(command)], path, text)


def _compiled(command: list[str], path: Path, text: str) -> ctypes.CDLL | None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as scratch:
        folder = Path(scratch)
        (folder / "kernel.c").write_text(f'#include "arrays.h"\n{text}', encoding="utf-8")
        (folder / "arrays.h").write_text(resources.files(__package__).joinpath("arrays.h").read_text(encoding="utf-8"))
        ran = subprocess.run(  # noqa: S603 - the compiler, of text that is made here
            [*command, "kernel.c", "-o", "kernel.so", "-lm"],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        if ran.returncode != 0:
            said = (ran.stderr.strip().splitlines() or ["no message"])[0]
            warnings.warn(f"{command[0]} can't compile kernels ({said}); numba does, which takes minutes", stacklevel=2)
            return None
        # Another process may be at the same: whoever is last replaces one whole file by another.
        os.replace(folder / "kernel.so", path)  # noqa: PTH105 - of open libraries, as well
    return ctypes.CDLL(str(path))
