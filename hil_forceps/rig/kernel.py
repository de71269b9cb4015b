"""The one way in which numeric functions are compiled here.

numba caches compiled code by the source file of each function. But a kernel holds the code of the kernels it calls and
the values of the constants it names, from other files too; change one of those, and the cache would go on answering
with the old. So the cache lives in a folder named after the text of every file that can end up in a kernel.
"""

import hashlib
import os
import stat
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ParamSpec, Protocol, TypeVar

import numba
from numba.extending import register_jitable

from hil_forceps.rig.errors import UserError

_P = ParamSpec("_P")
_R = TypeVar("_R")
_ROOT = Path(__file__).parents[2]


class Compiler(Protocol):
    """A decorator that compiles a function and keeps its type for the checker."""

    def __call__(self, function: Callable[_P, _R], /) -> Callable[_P, _R]:
        """Compile on the first call."""


def kernel_compiler(sources: Sequence[str], root: Path = _ROOT) -> Compiler:
    """Return the decorator for kernels built from `sources`, files and folders relative to `root`.

    Division by zero gives inf or NaN as in numpy instead of raising, so a kernel never raises on data: what isn't
    finite travels on to the gate. Kernels release the GIL. No fast-math: the same inputs give the same bits, in a loop
    or one step at a time.
    """
    folder = str(_cache_base(root) / f"kernels-{fingerprint(sources, root)}")

    def compiler(function: Callable[_P, _R]) -> Callable[_P, _R]:
        # numba asks for the folder once, when it wraps the function; other users of numba keep theirs.
        config: Any = numba.config
        before, config.CACHE_DIR = config.CACHE_DIR, folder
        try:
            compiled: Callable[_P, _R] = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
        finally:
            config.CACHE_DIR = before
        return compiled

    return compiler


# The decorators below are for what only kernels call. An entry from Python takes as long to compile as the function
# itself, so these have none; called from Python they are plain Python. And numba counts references to each array that a
# function is given, in tuples too: atomic operations, more than half of the time of the diagnosis's filter. So what
# makes no array is compiled without counting (`_nrt=False`). It must neither return an array nor get one from what it
# calls.
_WITHIN_KERNELS: Any = {
    "nogil": True,
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}


def _within_kernels(function: Callable[_P, _R], **options: bool) -> Callable[_P, _R]:
    callee: Callable[_P, _R] = register_jitable(**_WITHIN_KERNELS, **options)(function)
    return callee


def subroutine(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a function for the kernels that call it; it makes no array."""
    return _within_kernels(function, _nrt=False)


def with_work_arrays(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a function for the kernels that call it; it makes arrays for its own use and returns none of them."""
    return _within_kernels(function, _nrt=True)


def returning_arrays(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a function for the kernels that call it; what it returns is an array, or holds some.

    What counts no references must not call it, for nobody would free them.
    """
    return _within_kernels(function)


def as_its_caller(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Have every kernel that calls a function hold its code; given arrays it makes more of them, given numbers none.

    It counts references where its caller does. What counts none can call it with numbers only.
    """
    return _within_kernels(function, forceinline=True)


def inlined(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Have every kernel that calls a function hold its code, for small pieces of an inner loop; it makes no array."""
    return _within_kernels(function, forceinline=True, _nrt=False)


def fingerprint(sources: Sequence[str], root: Path = _ROOT) -> str:
    """Return a short name for the text of `sources` and of this file, which says how they are compiled.

    FileNotFoundError when one is not there.
    """
    digest = hashlib.blake2b(Path(__file__).read_bytes(), digest_size=8)
    for source in sources:
        path = root / source
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(f"{file.relative_to(root)}\0".encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _cache_base(root: Path) -> Path:
    """Return NUMBA_CACHE_DIR where it is set, else beside the sources where that can be written, else the user's."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return _private(Path(chosen))
    beside = root / "hil_forceps" / "__pycache__"
    if os.access(beside if beside.is_dir() else beside.parent, os.W_OK):
        return beside
    return _private(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hil-forceps")


def _private(folder: Path) -> Path:
    """Return a folder for compiled code, which is loaded and run; UserError where others may put theirs into it.

    One beside the sources is as safe as these are.
    """
    try:
        found = folder.stat()
    except OSError:
        return folder  # it will be made, for this user alone to write to
    if found.st_mode & stat.S_IWOTH or found.st_uid not in {0, os.getuid()}:
        raise UserError(
            f"{folder}: compiled kernels are kept here, and other users may write to it; set NUMBA_CACHE_DIR to a "
            "folder of your own (`chmod go-w`)"
        )
    return folder
