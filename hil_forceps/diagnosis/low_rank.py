"""Errors of low rank beside white noise: correlated over many entries, and made white by a projection."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.mapper import Mapper

Flat = NDArray[np.float32]
Matrix = NDArray[np.float32]
Rows = NDArray[np.intp]

LEAST_POWER = 1e-2  # of white noise's: less is none
BLOCK = 1 << 10  # entries that one core takes at a time


class LoadErrors(NamedTuple):
    """Of one run: its entries of the flat vector that errors of the load reach, and how (entries, k)."""

    entries: Rows
    columns: Matrix


class LowRank(NamedTuple):
    """G of a run as orthonormal columns, and the power along each, over that of white noise."""

    entries: Rows
    basis: Matrix
    power: Flat


Block = tuple[int, slice]  # which run, and which of its entries


def scale(flat: Flat, load: Sequence[LowRank], factors: Sequence[Flat], mapper: Mapper = map) -> None:
    """Multiply what lies along each column of each run by its factor; in place, of a vector or a matrix of them.

    Matrices by blocks of entries, since one run may have more columns than all others together.
    """
    sizes = [each.entries.size for each in load]
    blocks = _blocks(sizes, max(BLOCK, *sizes) if flat.ndim == 1 else BLOCK) if load else []
    here = [flat[each.entries] for each in load]

    def along(block: Block) -> Flat:
        k, rows = block
        return np.asarray(load[k].basis[rows].T @ here[k][rows])

    change = [np.zeros((each.power.size, *flat.shape[1:]), dtype=np.float32) for each in load]
    for (k, _), part in zip(blocks, mapper(along, blocks), strict=True):
        change[k] += part
    for k, factor in enumerate(factors):
        change[k] *= (factor - 1.0).astype(np.float32) if flat.ndim == 1 else (factor - 1.0).astype(np.float32)[:, None]

    def changed(block: Block) -> None:
        k, rows = block
        flat[load[k].entries[rows]] = here[k][rows] + load[k].basis[rows] @ change[k]

    list(mapper(changed, blocks))


def _blocks(sizes: Sequence[int], length: int = BLOCK) -> list[Block]:
    return [(k, slice(at, at + length)) for k, size in enumerate(sizes) for at in range(0, size, length)]


def decompose(errors: Sequence[LoadErrors], factor: Flat, mapper: Mapper = map) -> list[LowRank]:
    """Return errors of the load of each run beside noise that `factor` makes white.

    By blocks of entries, since one run may have more columns than all others together.
    """
    columns = [each.columns * factor[each.entries, None] for each in errors]
    blocks = _blocks([each.shape[0] for each in columns])

    def product(block: Block) -> Matrix:
        part = columns[block[0]][block[1]]
        return part.T @ part

    grams = [np.zeros((each.shape[1], each.shape[1])) for each in columns]
    for (k, _), part in zip(blocks, mapper(product, blocks), strict=True):
        grams[k] += part
    roots = []
    for values, vectors in mapper(np.linalg.eigh, grams):
        kept = values > LEAST_POWER
        roots.append((values[kept], (vectors[:, kept] / np.sqrt(values[kept])).astype(np.float32)))
    bases = [
        np.empty((each.shape[0], root.shape[1]), dtype=np.float32)
        for each, (_, root) in zip(columns, roots, strict=True)
    ]

    def turn(block: Block) -> None:
        k, rows = block
        np.matmul(columns[k][rows], roots[k][1], out=bases[k][rows])

    list(mapper(turn, blocks))
    return [LowRank(e.entries, b, v.astype(np.float32)) for e, b, (v, _) in zip(errors, bases, roots, strict=True)]
