"""A kernel that is called for a whole run: compiled by the C compiler for the types that it is first called with."""

import ctypes
import hashlib
import inspect
import platform
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil_forceps.kernels.arguments import CTYPES, Argument, OtherTypeError, type_of
from hil_forceps.kernels.library import flags, library
from hil_forceps.kernels.translation.program import Translation
from hil_forceps.kernels.translation.types import VOID, Scalar, Type, of_annotation

_ROOM = 1 << 16  # doubles, for arrays that a kernel makes; those as long as a run are given to it
_threads = threading.local()


class Arena(ctypes.Structure):
    """`Arena` of arrays.h: room for the arrays that a kernel makes."""

    _fields_ = (
        ("used", ctypes.c_size_t),
        ("size", ctypes.c_size_t),
        ("full", ctypes.c_bool),
        ("unequal", ctypes.c_bool),
        ("at", ctypes.c_void_p),
    )


class RunKernel:
    """A kernel as a function; `py_func` is what it was made of, `by_numba` what is called where no C compiler is."""

    def __init__(
        self, function: Callable[..., Any], by_numba: Callable[..., Any], folder: Path, *, vectorised: bool = False
    ) -> None:
        """`folder`: for libraries; `vectorised`: its loops go over many columns."""
        self.__doc__, self.__name__, self.__module__ = function.__doc__, function.__name__, function.__module__
        self.__wrapped__ = function
        self.py_func, self.by_numba = function, by_numba
        self._folder, self._options = folder, flags(vectorised=vectorised)
        self._lock = threading.Lock()
        self._entries: list[_Entry] = []
        self._is_left_to_numba = False

    def __call__(self, *arguments: Any) -> Any:
        """Call the kernel; TypeError for arguments that no kernel takes."""
        known = self._known(arguments)
        if known is None and not self._is_left_to_numba:
            with self._lock:
                known = self._known(arguments) or self._compiled(arguments)
        if known is None:
            return self.by_numba(*arguments)
        entry, packed = known
        return entry.call(packed)

    def _known(self, arguments: Sequence[Any]) -> "tuple[_Entry, list[Any]] | None":
        """Return the entry for arguments of these types, and the arguments as C has them."""
        for entry in self._entries:
            try:
                return entry, entry.packed(arguments)
            except OtherTypeError:
                continue
        return None

    def _compiled(self, arguments: Sequence[Any]) -> "tuple[_Entry, list[Any]] | None":
        """Return the same for types that are new; None where no compiler makes it."""
        program = Translation()
        hints = inspect.get_annotations(self.py_func, eval_str=True)
        wanted = [of_annotation(hints[name]) for name in inspect.signature(self.py_func).parameters]
        kinds = [kind or type_of(each, program) for each, kind in zip(arguments, wanted, strict=True)]
        machine = (sys.platform, platform.machine(), self._options)
        digest = hashlib.blake2b(repr((machine, kinds, _identity(self.py_func))).encode(), digest_size=8).hexdigest()
        path = self._folder / f"{self.__module__}.{self.__name__}-{digest}.so"
        if path.exists():
            found: ctypes.CDLL | None = ctypes.CDLL(str(path))
        else:
            program.entry(self.py_func, kinds, "kernel")
            found = library(path, program.text(), self._options)
        if found is None:
            self._is_left_to_numba = True
            return None
        entry = _Entry(found, kinds, of_annotation(hints["return"]) or VOID)
        try:
            packed = entry.packed(arguments)
        except OtherTypeError as problem:
            raise TypeError(f"{self.__name__} takes other numbers than these: {problem}") from problem
        self._entries.append(entry)
        return entry, packed


def _identity(function: Callable[..., Any]) -> list[str]:
    """Return what tells a function from others of its name: its place, and what it has from around it."""
    told = [function.__qualname__, str(function.__code__.co_firstlineno)]
    for cell in function.__closure__ or ():
        held = cell.cell_contents
        told.append(f"{held.__module__}.{held.__qualname__}" if hasattr(held, "__qualname__") else repr(held))
    return told


class _Entry:
    """A kernel compiled for one choice of types."""

    def __init__(self, found: ctypes.CDLL, kinds: Sequence[Type], returned: Scalar) -> None:
        self._arguments = [Argument(kind) for kind in kinds]
        self._function = found.kernel
        self._function.argtypes = [ctypes.c_void_p, *(each.ctype for each in self._arguments)]
        self._function.restype = CTYPES[returned.c]

    def packed(self, arguments: Sequence[Any]) -> list[Any]:
        """Return the arguments as C has them; OtherTypeError where they are of other types."""
        if len(arguments) != len(self._arguments):
            raise OtherTypeError
        return [argument.packed(value) for argument, value in zip(self._arguments, arguments, strict=True)]

    def call(self, packed: list[Any]) -> Any:
        """Return what the kernel returns."""
        arena = _arena()
        returned = self._function(ctypes.addressof(arena), *packed)
        if arena.full:
            raise RuntimeError(f"a kernel makes arrays of more than {_ROOM} doubles; those are to be given to it")
        if arena.unequal:
            raise ValueError("a kernel was given arrays whose sizes don't go together")
        return returned


def _arena() -> Arena:
    """Return this thread's arena."""
    arena: Arena | None = getattr(_threads, "arena", None)
    if arena is None:
        _threads.room = np.empty(_ROOM)
        arena = _threads.arena = Arena(0, _ROOM, False, False, _threads.room.ctypes.data)
    arena.full = arena.unequal = False
    return arena
