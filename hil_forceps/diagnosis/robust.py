"""How much more than stationary noise a column's product with the noise varies: the sandwich of robust statistics.

Whitening makes noise white on the average over a run. Where it isn't stationary, as an encoder's rounding that stands
still while the motor dwells, a column that lives just there meets more noise than the average, and chance gives it
more. So products are summed block by block, and their scatter over the blocks is put beside what whitened noise would
have (White, Econometrica 48, 1980; blocks: Newey and West, Econometrica 55, 1987).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from hil_forceps.diagnosis.fit import gram, inverse
from hil_forceps.diagnosis.problem import Matrix
from hil_forceps.diagnosis.score import Group
from hil_forceps.diagnosis.spectrum import Flat, Layout

Vector = NDArray[np.float64]

BLOCKS = 24  # of a run: half a second of twelve


def inflations(
    layout: Layout,
    fitted: Matrix,
    columns: Matrix,
    groups: Sequence[Group],
    noise: Flat,
) -> Vector:
    """Return by how much the χ² of each group by chance exceeds that of white noise; at least 1.

    All whitened: `fitted` columns are projected out of `columns`; `noise`: what neither explains.
    """
    clean = left_by(fitted, columns)
    expected = gram(clean, clean)
    sums = _block_sums(layout, clean, noise)
    return _above(expected, sums.T @ sums, groups)


def _above(expected: Vector, scatter: Vector, groups: Sequence[Group]) -> Vector:
    """Return for each group by how much the scatter exceeds the expected one on the mean; at least 1."""
    found = np.ones(len(groups))
    for i, group in enumerate(groups):
        here = slice(group.first, group.stop)
        own, seen = expected[here, here], scatter[here, here]
        size = np.sqrt(np.maximum(np.diag(own), 1e-30))
        values, vectors = np.linalg.eigh(own / np.outer(size, size))
        kept = values > 1e-6
        if not kept.any():
            continue
        root = vectors[:, kept] / np.sqrt(values[kept])
        found[i] = max(1.0, float(np.trace(root.T @ (seen / np.outer(size, size)) @ root)) / int(kept.sum()))
    return found


def left_by(fitted: Matrix, columns: Matrix) -> Matrix:
    """Return what the `fitted` columns don't explain of others; those that hold nothing explain nothing."""
    size = np.sqrt(np.einsum("ij,ij->j", fitted, fitted, dtype=np.float64))
    useful = size > 1e-12 * max(float(size.max(initial=0.0)), 1e-12)
    unit = (fitted[:, useful] / size[useful]).astype(np.float32)
    if unit.shape[1] == 0:
        return columns
    share = inverse(gram(unit, unit)) @ gram(unit, columns)
    return np.asarray(columns - unit @ share.astype(np.float32), dtype=np.float32)


def _block_sums(layout: Layout, columns: Matrix, noise: Flat) -> Vector:
    """Return sums (blocks of all runs, columns) of column times noise over time; channels of a run join."""
    runs = max(part.run for part in layout.parts) + 1
    sums = np.zeros((runs, BLOCKS, columns.shape[1]))
    for part in layout.parts:
        course = over_time(noise[part.start : part.stop, None], part.rows)
        cuts = np.linspace(0, part.rows, BLOCKS + 1).astype(np.intp)[:-1]
        for first in range(0, columns.shape[1], 32):
            some = over_time(columns[part.start : part.stop, first : first + 32], part.rows)
            sums[part.run, :, first : first + 32] += np.add.reduceat(some * course, cuts, axis=0)
    return sums.reshape(-1, columns.shape[1])


def over_time(entries: Matrix, rows: int) -> Matrix:
    """Return whitened entries of a part (2 bins, columns) as courses over time (rows, columns), products kept."""
    bins = np.ascontiguousarray(entries.T).view(np.complex64).T * np.float32(np.sqrt(rows / 2.0))
    bins[0] *= np.float32(np.sqrt(2.0))
    return np.asarray(fft.irfft(bins, rows, axis=0), dtype=np.float32)
