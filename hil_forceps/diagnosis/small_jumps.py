"""Jumps of a load too small to stand out from row to row.

One of 1.4 standard deviations of the load cell's noise shows in no increment. As two bends of a ramp it was put in
140 ms instead of one: the simulated jaw then misses the blow, and its residual has five times its power for 60 ms.
Means before and after tell it, and where about it was.

A ramp or a smooth course look like a jump from afar, so each is tried in its place. Only loads that jump by
much are taken to jump by little.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hil_forceps.diagnosis.smoothing import NoiseFilter, whitened

Vector = NDArray[np.float64]

# To both sides, the longer one first: it sees smaller ones, where the load holds or ramps for so long.
REACHES_S = (0.3, 0.15)
STANDS_OUT = 20.0  # of χ²: one too many costs little
EVERY = 5  # rows between the middles of ramps that are tried instead
RAMPS_S = (0.004, 0.008, 0.015, 0.03, 0.06, 0.12)
SMOOTH = 5  # degree of the course that is tried instead
# Of χ²: how much better a ramp, or a smooth course, must be, since each has more to fit.
RAMP_BEHIND, SMOOTH_BEHIND = 6.0, 6.0
ALIKE = 40  # rows to either side that a jump may have been at instead
FEWEST = 30  # rows to either side


class SmallJump(NamedTuple):
    """A jump after a row, and the standard deviation of its instant."""

    row: int
    deviation_rows: float


class _Sight(NamedTuple):
    """What looks for jumps, all of it whitened and free of level and slope."""

    jump: Vector
    ramps: Vector  # of norm 1, one a column
    smooth: Vector  # orthonormal


def small_jumps(pieces: Sequence[Vector], white: NoiseFilter, period_s: float) -> list[SmallJump]:
    """Return the jumps of a load, which large ones cut to pieces, in order; `white` makes its noise white."""
    halves = [half for half in (round(reach_s / period_s) for reach_s in REACHES_S) if half >= FEWEST]
    longest = max(piece.size for piece in pieces)
    sights = [_sight(half, white, period_s) for half in halves if longest >= 2 * half]
    found: list[SmallJump] = []
    start = 0
    for piece in pieces:
        found += [jump._replace(row=start + jump.row) for jump in _of_piece(piece, white, sights)]
        start += piece.size
    return found


def _of_piece(piece: Vector, white: NoiseFilter, sights: Sequence[_Sight]) -> list[SmallJump]:
    values = whitened(piece, white) / white.deviation_N_m
    found: list[SmallJump] = []
    for sight in sights:
        half = sight.jump.size // 2
        if piece.size >= 2 * half:
            others = [jump.row for jump in found]
            found += [jump for jump in _seen(values, sight) if not _near(jump.row, others, half)]
    return sorted(found)


def _near(row: int, others: Sequence[int], apart: int) -> bool:
    return any(abs(row - other) < apart for other in others)


def _seen(values: Vector, sight: _Sight) -> list[SmallJump]:
    """Return the jumps that whitened values show."""
    half = sight.jump.size // 2
    gains = np.correlate(values, sight.jump, "valid") ** 2 / float(sight.jump @ sight.jump)
    found = []
    for first in _peaks(gains, half):
        if _is_jump(values[first : first + 2 * half], gains[first], sight):
            near = np.arange(max(0, first - ALIKE), min(gains.size, first + ALIKE + 1))
            chance = np.exp(0.5 * (gains[near] - gains[first]))
            variance = float(chance @ (near - first) ** 2 / chance.sum()) + 1.0 / 12.0
            found.append(SmallJump(first + half - 1, float(np.sqrt(variance))))
    return found


def _peaks(gains: Vector, apart: int) -> list[int]:
    """Return where gains are highest for as far as `apart` to both sides, in order."""
    high = np.flatnonzero(gains > STANDS_OUT)
    return [int(k) for k in high if gains[k] >= gains[max(0, k - apart) : k + apart + 1].max()]


def _is_jump(values: Vector, gain: float, sight: _Sight) -> bool:
    """Tell whether nothing else explains a window better."""
    ramp = float(np.max((sight.ramps.T @ values) ** 2))
    smooth = float(np.sum((sight.smooth.T @ values) ** 2))
    return gain > ramp - RAMP_BEHIND and gain > smooth - SMOOTH_BEHIND


def _ramps(rows: Vector, middles: Vector, width: int) -> Vector:
    """Return ramps from 0 to 1 over a width, those that begin within the window."""
    whole = middles[middles - 0.5 * width >= rows[0]]
    return np.asarray(np.clip((rows[:, None] - whole) / width + 0.5, 0.0, 1.0))


def _sight(half: int, white: NoiseFilter, period_s: float) -> _Sight:
    rows: Vector = np.arange(2 * half, dtype=np.float64) - half + 0.5
    straight, _ = np.linalg.qr(np.column_stack((np.ones_like(rows), rows)))

    def free(columns: Vector) -> Vector:
        """Whiten columns that are 0 before the window, and take level and slope out of them."""
        seen = lfilter(white.taps, np.ones(1), columns, axis=0) / white.deviation_N_m
        return np.asarray(seen - straight @ (straight.T @ seen))

    middles = rows[EVERY:-EVERY:EVERY]
    widths = [max(2, round(width / period_s)) for width in RAMPS_S]
    ramps = free(np.column_stack([_ramps(rows, middles, width) for width in widths]))
    powers = (rows / half)[:, None] ** np.arange(2, SMOOTH + 1)
    smooth, _ = np.linalg.qr(powers - straight @ (straight.T @ powers))
    jump = free((rows > 0.0).astype(np.float64)[:, None])[:, 0]
    return _Sight(jump, ramps / np.linalg.norm(ramps, axis=0), smooth)
