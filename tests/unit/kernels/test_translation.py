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

from hil_forceps.kernels.run_kernel import Arena
from hil_forceps.kernels.translation.program import Translation
from hil_forceps.kernels.translation.types import DOUBLE

ROOT = Path(__file__).parents[3]
WEIGHTS, OTHERS, TABLE = (0.5, -1.5, 2.0), (1.0, 2.0, 3.0), np.array([[1.0, 2.0], [3.0, 4.0]])


LAST = -1


class Pair(NamedTuple):
    first: float
    last: float


class Large(NamedTuple):
    """Handed over by its address."""

    a: float
    b: float
    counts: NDArray[np.int64]
    shares: NDArray[np.float32]


def numbers(a: float, b: float) -> float:
    whole = math.floor(a)
    if a > b > 0.0 and a != 3.0:
        return float(whole // 3 - whole % 3) + max(a, b, 1.0) ** 2 - min(whole, 2)
    result: float = (a if a <= b else -b) / 2.0 + 0.5 ** (whole + 1) + abs(b) ** 0.5
    return result + int(a) + round(b) + (whole & 5) + math.hypot(a, b) + math.erfc(a)


def loops(a: float, b: float) -> float:
    total, step = 0.0, 1
    for i in range(7, 0, -2):
        for factor in (a, b):
            total += factor * i
    for weight, other in zip(WEIGHTS, OTHERS):  # noqa: B905  # not known to numba
        total += weight * other
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


def parts_of_arrays(a: float, b: float) -> float:
    deep = np.zeros((2, 3, 2))
    deep[1, 2], deep[0] = np.array([a, b]), a
    deep[:, 1, 0] = b
    column = deep[1, :, 1]
    column[-1] += 2.0
    middle = deep[:, 1:, :]
    total = 0.0
    for i in range(middle.shape[0]):
        for j in range(middle.shape[1]):
            total += (i + 2 * j + 1) * middle[i, j, 0] + middle[i, j, 1]
    result: float = total + column.sum() + np.diag(column)[2, 2] + TABLE[1, 0] * deep.size
    return result


def elementwise(a: float, b: float) -> float:
    x, y = np.array([a, b, 1.0]), np.ones(3)
    y[:2] = 0.5
    y *= a
    x += 2.0 * y - x / 3.0
    stacked = np.stack((x, -y))
    stacked[:, 0] -= b
    spread = stacked - x[:2].reshape((-1, 1))
    spread[:] = spread * spread
    result: float = spread.sum() + np.full(3, a).min()
    return result


def either(a: float, b: float) -> float:
    row = np.array([a, b])
    chosen = row * 2.0 if a > b else row
    negative = row.min() < 0.0 and (row * row).sum() > 1.0
    unlike = a in (1.0, b) or not negative
    places = (2, 3, 5) if unlike else (1, 0, 1)
    total = chosen[0]
    for i in range(3):
        total += i * places[i]
    result: float = total + (10.0 if negative else 0.0)
    return result


def grown(p: Large, by: float) -> Large:
    p = Large(p.a + by, p.b, p.counts, p.shares)
    p.counts[0] += 1
    return p


def structs(a: float, b: float) -> float:
    given = Large(a, b, np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.float32))
    given.shares[1] = a / 3.0
    after = grown(grown(given, 1.0), 2.0)
    result: float = after.a - given.a + after.counts[0] + given.shares[1] * given.shares[1]
    return result


def places(a: float, b: float) -> float:
    x, w = np.array([a, b, a + b, 1.0, 2.0]), (1.0, 2.0, 4.0)
    total = 0.0
    for i in range(3):
        total += x[i - 1] + 10.0 * x[-1 - i] + x[LAST + i] + w[i - 2]
        total += 100.0 * x[i + 2 : i + 9].shape[0] + x[i - 2 : i].size + x[:-i].size + x[-i:].size
    return total


def overlapping(a: float, b: float) -> float:
    x, m = np.array([a, b, 1.0, 2.0]), np.array([a, b, 3.0, 4.0]).reshape((2, 2))
    x[1:] = x[:-1]
    m[:] = m.T
    m[:, :] = m[:, :1]
    x[:] = x + x[:1]
    spread = x.reshape((4, 1)) * x.reshape((1, 4))
    result: float = (
        x[3] + 10.0 * m[0, 1] + spread[1].sum() + spread[3, 2]
    )  # numpy adds up eight and more in another order
    return result


def loop_variables(a: float, b: float) -> float:
    total, i = a, 5
    for i in range(0):  # noqa: B007
        total += 1.0
    total += i
    for i in range(4):
        total += i * b
        i += 2  # noqa: PLW2901
    total += i
    for i in range(2):
        for i in range(3):  # noqa: B007, PLW2901
            total *= 0.5
    for factor in (2.0, b):
        b += factor
        total += factor
    return total + i + 3600 * 1000000 + 7 % 3


FORMS = [places, overlapping, loop_variables, numbers, loops, arrays, parts_of_arrays, elementwise, either, structs]


@pytest.mark.parametrize("function", FORMS)
def test_python_and_c_give_the_same_bits(function: Callable[[float, float], float], tmp_path: Path) -> None:
    program = Translation()
    program.entry(function, (DOUBLE, DOUBLE), "entry")
    (tmp_path / "f.c").write_text('#include "arrays.h"\n' + program.text(), encoding="utf-8")
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-fsanitize=undefined", "-ffp-contract=off", "-shared"]
    include = f"-I{ROOT / 'hil_forceps' / 'kernels'}"
    subprocess.run([*command, "-fPIC", include, "f.c", "-o", "f.so", "-lm"], cwd=tmp_path, check=True)
    entry = ctypes.CDLL(str(tmp_path / "f.so")).entry
    entry.restype, entry.argtypes = ctypes.c_double, [ctypes.c_void_p, ctypes.c_double, ctypes.c_double]
    room = np.full(1000, np.nan)
    arena = Arena(0, room.size, False, False, room.ctypes.data)
    rng = np.random.default_rng(1)
    given: NDArray[np.float64] = np.concatenate((rng.normal(0.0, 4.0, (200, 2)), [[3.0, 1.0], [-0.0, 2.0], [5.0, 5.0]]))
    for a, b in given.tolist():
        if a != 0.0 and b != 0.0:
            assert entry(ctypes.addressof(arena), a, b) == function(a, b), (a, b)
            assert not arena.full
            assert not arena.unequal


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


def steps_over(a: float) -> float:
    return float(np.array([a, a, a])[::2].sum())


def returns_an_array(a: float) -> NDArray[np.float64]:
    return np.array([a])


def returns_another_number(a: float) -> int:
    return a  # type: ignore[return-value]


def leaves_one_out(a: float) -> float:
    total = 0.0
    for factor in (a, 2.0):
        if factor > 1.0:
            break
        total += factor
    return total


def reads_first(a: float) -> float:
    total = a + ROOT  # type: ignore[operator, used-before-def]  # noqa: F823
    ROOT = a  # noqa: F841
    return float(total)


REFUSED = [
    unknown, changes_type, two_types, steps_over, returns_an_array, returns_another_number, leaves_one_out, reads_first
]  # fmt: skip


@pytest.mark.parametrize("function", REFUSED)
def test_what_it_does_not_know_is_refused_with_its_place(function: Callable[[float], float]) -> None:
    with pytest.raises(NotImplementedError, match=function.__name__):
        Translation().entry(function, (DOUBLE,), "entry")
