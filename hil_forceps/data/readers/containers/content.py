"""What a container holds, as its library's side tells it: tables with names and units, and the numbers on demand."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_NAMES = 10_000
MAX_SAMPLES = 50_000_000


class ContentError(Exception):
    """The file can't be used; its text says why and what to do."""


@dataclass(frozen=True, slots=True)
class Table:
    """One table: `get` returns the columns at some positions, at the times of column `base` where one is given."""

    label: str  # of a sheet; "" where a file has one table
    names: tuple[str, ...]
    units: tuple[str, ...]
    get: Callable[[Sequence[int], int | None], list[Array]]
    group: str = ""  # path that all names have in front
    first_row: int = 1
    notes: tuple[str, ...] = ()


def without_group(names: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """Take away the path that all names have in front: `log/pos`, `log/time` are pos and time in log."""
    heads = {name.rpartition("/")[0] for name in names}
    if len(heads) != 1:
        return "", tuple(names)
    (head,) = heads
    return head, tuple(name[len(head) + 1 :] if head else name for name in names)


def vectors(name: str, shape: Sequence[int]) -> list[str]:
    """Name the columns of an array: itself where it is one, `name#1` and so on along the shorter axis of a matrix."""
    if len(shape) == 1 or (len(shape) == 2 and min(shape) == 1):
        return [name]
    if len(shape) != 2 or min(shape) > MAX_NAMES:
        return []
    return [f"{name}#{number}" for number in range(1, min(shape) + 1)]


def vector(values: Array, number: int) -> Array:
    """Return a column (from 0) of an array, samples along the longer axis."""
    if values.ndim == 1 or min(values.shape) == 1:
        return np.asarray(values.reshape(-1), dtype=np.float64)
    return np.asarray(values[:, number] if values.shape[0] >= values.shape[1] else values[number], dtype=np.float64)
