"""Errors of low rank beside white noise: correlated over many entries, and made white by a projection."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Flat = NDArray[np.float32]
Matrix = NDArray[np.float32]
Rows = NDArray[np.intp]

LEAST_POWER = 1e-2  # of white noise's: less is none


class LoadErrors(NamedTuple):
    """Of one run: its entries of the flat vector that errors of the load reach, and how (entries, k)."""

    entries: Rows
    columns: Matrix


class LowRank(NamedTuple):
    """G of a run as orthonormal columns, and the power along each, over that of white noise."""

    entries: Rows
    basis: Matrix
    power: Flat

    def scale(self, flat: Flat, factors: Flat) -> None:
        """Multiply what lies along each column by its factor; in place, of a vector or a matrix of them."""
        here = flat[self.entries]
        along = self.basis.T @ here
        change = (factors - 1.0).astype(np.float32)
        flat[self.entries] = here + self.basis @ (along * (change if flat.ndim == 1 else change[:, None]))


def decompose(errors: LoadErrors, factor: Flat) -> LowRank:
    """Return errors of the load beside noise that `factor` makes white."""
    columns = errors.columns * factor[errors.entries, None]
    values, vectors = np.linalg.eigh((columns.T @ columns).astype(np.float64))
    kept = values > LEAST_POWER
    basis = columns @ (vectors[:, kept] / np.sqrt(values[kept])).astype(np.float32)
    return LowRank(errors.entries, basis, values[kept].astype(np.float32))
