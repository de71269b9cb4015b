"""Python to C: forms that kernels use mean the same in both, and what isn't known is refused."""

import ctypes
import math
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.fmu.translation.program import Translation
from hil_forceps.fmu.translation.types import DOUBLE
from tests.unit.fmu.conftest import ROOT


class Pair(NamedTuple):
    first: float
    last: float


def numbers(a: float, b: float) -> float:
    whole = math.floor(a)
    if a > b > 0.0 and a != 3.0:
        return float(whole // 3 - whole % 3) + max(a, b, 1.0) ** 2 - min(whole, 2)
    result: float = (a if a <= b else -b) / 2.0 + 0.5 ** (whole + 1) + abs(b) ** 0.5
    return result


def loops(a: float, b: float) -> float:
    total, step = 0.0, 1
    for i in range(7, 0, -2):
        for factor in (a, b):
            total += factor * i
    while total > 10.0:
        step += 1
        if step > 5:
            break
        if step == 3:
            continue
        total -= a
    return total + step


def arrays(a: float, b: float) -> float:
    row = np.array([a, b, a * b, 1.0])
    square = row.copy().reshape((2, 2)) * 2.0
    turned = np.ascontiguousarray(square[:2, :2].T)
    turned[0, 1], turned[1, 0] = turned[1, 0], turned[0, 1]
    row[1:3] = turned[1]
    p = Pair(*(a, b))
    swapped = Pair(p.last, p.first)
    first, last = swapped
    result: float = row[0] + 10.0 * row[1] + 100.0 * row[2] + first / last + float(row.shape[0])
    return result


@pytest.mark.parametrize("function", [numbers, loops, arrays])
def test_python_and_c_give_the_same_bits(function: Callable[[float, float], float], tmp_path: Path) -> None:
    program = Translation()
    program.entry(function, (DOUBLE, DOUBLE), "entry")
    (tmp_path / "f.c").write_text('#include "arrays.h"\n' + program.text(), encoding="utf-8")
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-fsanitize=undefined", "-ffp-contract=off", "-shared"]
    include = f"-I{ROOT / 'hil_forceps' / 'fmu' / 'c'}"
    subprocess.run([*command, "-fPIC", include, "f.c", "-o", "f.so", "-lm"], cwd=tmp_path, check=True)
    entry = ctypes.CDLL(str(tmp_path / "f.so")).entry
    entry.restype, entry.argtypes = ctypes.c_double, [ctypes.c_void_p, ctypes.c_double, ctypes.c_double]
    arena = ctypes.create_string_buffer(16384 * 8 + 16)
    rng = np.random.default_rng(1)
    given: NDArray[np.float64] = np.concatenate((rng.normal(0.0, 4.0, (200, 2)), [[3.0, 1.0], [-0.0, 2.0], [5.0, 5.0]]))
    for a, b in given.tolist():
        if a != 0.0 and b != 0.0:
            assert entry(arena, a, b) == function(a, b), (a, b)


def unknown(a: float) -> float:
    return sorted([a])[0]


def changes_type(a: float) -> float:
    b = 1
    b = a  # type: ignore[assignment]
    return b + 1.0


def two_types(a: float) -> float:
    if a > 0.0:
        return (a, a)  # type: ignore[return-value]
    return a


@pytest.mark.parametrize("function", [unknown, changes_type, two_types])
def test_what_it_does_not_know_is_refused_with_its_place(function: Callable[[float], float]) -> None:
    with pytest.raises(NotImplementedError, match=function.__name__):
        Translation().entry(function, (DOUBLE,), "entry")
