"""The one way in which numeric functions are compiled here."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

_P = ParamSpec("_P")
_R = TypeVar("_R")


def kernel(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile `function` with numba, keeping its type for the checker.

    Compiled code is cached on disk (the first call of a fresh installation compiles). Division by zero gives inf or
    NaN as in numpy instead of raising, so a kernel never raises on data: what isn't finite travels on to the gate.
    No fast-math: the same inputs give the same bits, in a loop or one step at a time.
    """
    return cast(Callable[_P, _R], numba.njit(cache=True, error_model="numpy")(function))
