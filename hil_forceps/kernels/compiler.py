"""The ways in which numeric functions are compiled here.

A `kernel` is called from Python for each sample: numba compiles it, and a call takes a quarter of a microsecond. A
`run_kernel` is called for a whole run: the C compiler compiles it, in seconds where numba takes a minute. Both are
compiled from the same text, and give the same bits.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ParamSpec, Protocol, TypeVar, cast

import numba
from numba.extending import register_jitable

from hil_forceps.kernels.cache import cache_folder
from hil_forceps.kernels.run_kernel import RunKernel

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
    folder = str(cache_folder(sources, root))

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


def run_kernel_compiler(sources: Sequence[str], root: Path = _ROOT, *, vectorised: bool = False) -> Compiler:
    """Return the decorator for kernels that are called for a whole run, built from `sources` as above.

    They fill arrays that they are given, and return nothing or a number. Where no C compiler is, numba compiles them.
    `vectorised`: for kernels whose loops go over many columns.
    """
    folder, by_numba = cache_folder(sources, root), kernel_compiler(sources, root)
    config: Any = numba.config

    def compiler(function: Callable[_P, _R]) -> Callable[_P, _R]:
        compiled = by_numba(function)
        if config.DISABLE_JIT:
            return compiled
        return cast(Callable[_P, _R], RunKernel(function, compiled, folder, vectorised=vectorised))

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
