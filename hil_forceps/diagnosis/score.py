"""How much of the whitened residual each place of the catalogue would explain, and what chance would give.

What the known parameters could explain is taken out first.

Linear algebra on Gram matrices: with whitened columns J of the fitted unknowns (prior weights Λ), C of the candidates
and residual r, the projected Gram is S = CᵀC − CᵀJ (JᵀJ + Λ)⁻¹ JᵀC, the projected slope b likewise, and a place with
columns c gains b_cᵀ S_cc⁻¹ b_c. Under noise alone b ~ N(0, S), so chance is drawn from S without simulating anything.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.fit import gram, inverse
from hil_forceps.diagnosis.problem import Matrix
from hil_forceps.diagnosis.spectrum import Flat

Vector = NDArray[np.float64]
Square = NDArray[np.float64]

DRAWS = 4000
COST_PER_COLUMN = 2.0  # of a place with more columns: what χ² falls by chance, twice
LEAST_SHARE = 1e-7  # of a column's power left after projection: below it the data hold nothing of its own


class Group(NamedTuple):
    """The columns of a place."""

    first: int
    stop: int
    one_sided: bool


class Scores(NamedTuple):
    """What each place gains."""

    gains: Vector  # fall of χ², less the cost of its columns
    amplitudes: list[Vector]  # in units of each column's finite difference
    informative: NDArray[np.bool_]
    threshold: float  # of the highest gain by chance
    projected: Square
    slope: Vector


def project(
    fitted: Matrix, weights: Vector, u: Vector, columns: Matrix, residual: Flat, products: Square | None = None
) -> tuple[Square, Vector]:
    """Return S and b for whitened columns and residual; `products`: CᵀC, where it is known."""
    jc, solved, b = _taken_out(fitted, weights, u, columns, residual)
    s = (gram(columns, columns) if products is None else products) - jc.T @ solved
    return 0.5 * (s + s.T), b


def _taken_out(
    fitted: Matrix, weights: Vector, u: Vector, columns: Matrix, residual: Flat
) -> tuple[Square, Square, Vector]:
    """Return JᵀC, (JᵀJ + Λ)⁻¹ JᵀC and b."""
    jj = gram(fitted, fitted) + np.diag(weights)
    jc = gram(fitted, columns)
    jr = gram(fitted, residual[:, None])[:, 0] - weights * u
    solved = inverse(jj) @ np.column_stack((jc, jr))
    return jc, solved[:, :-1], gram(columns, residual[:, None])[:, 0] - jc.T @ solved[:, -1]


def _telling(left: Vector, own: Vector) -> NDArray[np.bool_]:
    """Tell which columns the data hold something of, by their power after and before projection."""
    return (left > LEAST_SHARE * np.maximum(own, 1e-30)) & (left > 1e-8)


def gains_alone(
    fitted: Matrix, weights: Vector, u: Vector, columns: Matrix, groups: Sequence[Group], residual: Flat
) -> Vector:
    """Return what each place gains, as `score` has it; without chance, which asks for the products of all columns."""
    jc, solved, b = _taken_out(fitted, weights, u, columns, residual)
    gains = []
    for group in groups:
        these = slice(group.first, group.stop)
        own = gram(columns[:, these], columns[:, these])
        s = own - jc[:, these].T @ solved[:, these]
        here = Group(0, group.stop - group.first, group.one_sided)
        gains.append(_gain(s, b[these], here, _telling(np.diag(s), np.diag(own)))[0])
    return np.array(gains)


def score(
    fitted: Matrix,
    weights: Vector,
    u: Vector,
    columns: Matrix,
    groups: Sequence[Group],
    residual: Flat,
    chance: float,
    seed: int,
    products: Square | None = None,
) -> Scores:
    """Score all places; `chance` is the family-wise share of data sets without effect that may exceed the threshold.

    `products`: CᵀC, where it is known.
    """
    own = np.array([float(c) for c in np.einsum("ij,ij->j", columns, columns, dtype=np.float64)])
    s, b = project(fitted, weights, u, columns, residual, products)
    good = _telling(np.diag(s), own)
    gains, amplitudes, informative = [], [], []
    for group in groups:
        gain, amplitude = _gain(s, b, group, good)
        gains.append(gain)
        amplitudes.append(amplitude)
        informative.append(bool(good[group.first : group.stop].any()))
    threshold = _threshold(s, groups, good, chance, seed)
    return Scores(np.array(gains), amplitudes, np.array(informative), threshold, s, b)


def _gain(s: Square, b: Vector, group: Group, good: NDArray[np.bool_]) -> tuple[float, Vector]:
    chosen = np.arange(group.first, group.stop)[good[group.first : group.stop]]
    amplitude = np.zeros(group.stop - group.first)
    if chosen.size == 0:
        return 0.0, amplitude
    solution = np.linalg.lstsq(s[np.ix_(chosen, chosen)], b[chosen], rcond=1e-9)[0]
    if group.one_sided and solution[0] <= 0.0:
        return 0.0, amplitude
    amplitude[chosen - group.first] = solution
    return float(b[chosen] @ solution) - COST_PER_COLUMN * (chosen.size - 1), amplitude


def _threshold(s: Square, groups: Sequence[Group], good: NDArray[np.bool_], chance: float, seed: int) -> float:
    """Return the highest gain that noise alone gives in all but `chance` of data sets."""
    # Columns differ in size by orders of magnitude: the rounding of the largest would drown the smallest.
    size = np.sqrt(np.maximum(np.diag(s), 1e-30))
    kept = np.flatnonzero(good)
    place = np.full(size.size, -1)
    place[kept] = np.arange(kept.size)
    s = (s / np.outer(size, size))[np.ix_(kept, kept)]
    values, vectors = np.linalg.eigh(s)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    slopes = root @ rng.standard_normal((s.shape[0], DRAWS))
    highest = np.zeros(DRAWS)
    for group in groups:
        chosen = place[group.first : group.stop]
        chosen = chosen[chosen >= 0]
        if chosen.size == 0:
            continue
        inverse = np.linalg.pinv(s[np.ix_(chosen, chosen)], rcond=1e-9, hermitian=True)
        here = slopes[chosen]
        gain = np.einsum("ik,ij,jk->k", here, inverse, here) - COST_PER_COLUMN * (chosen.size - 1)
        if group.one_sided:
            gain = np.where(here[0] > 0.0, gain, 0.0)
        highest = np.maximum(highest, gain)
    return _tail(highest, chance)


def _tail(highest: Vector, chance: float) -> float:
    """Return the quantile 1 − chance; beyond what the draws reach, by the exponential tail of a χ²."""
    reachable = max(chance, 20.0 / DRAWS)
    quantile = float(np.quantile(highest, 1.0 - reachable))
    return quantile + 2.0 * float(np.log(reachable / chance))
