"""The inverse model: least squares of the force on the motion, processed as published for EMPS.

The position goes forth and back through a Butterworth low pass, its derivatives are central differences, and both
sides go through the same decimation (Chebyshev, forth and back), which keeps what lies below twice the loop's
bandwidth of 20 Hz. All rows count. Source: Janot, Gautier and Brunot, section 3 and `Script_IDIM_LS`.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import shift
from scipy.optimize import minimize
from scipy.signal import butter, cheby1, filtfilt

from hil_forceps.identification.axis.force_terms import Law, Motion, Shape, Vector, column, terms

LOW_PASS_Hz = 100.0
FILTER_ORDER = 4
MIN_KEPT_BANDWIDTH_Hz = 40.0
BORDER_SAMPLES = 49  # samples at the start that the differences spoil
MAX_DEAD_TIME_s = 2e-3
LOW_SPEED_BOUNDS_m_per_s = (2e-3, 0.1)
_START_DEAD_TIME_s = 5e-4
_NEAR_BOUND_RATIO = 1.02  # a number nearer to its bound than this sits there


class Fit(NamedTuple):
    """A law with its numbers."""

    law: Law
    shape: Shape
    coefficients: dict[str, float]


class Rows:
    """One run ready for least squares: its motion and force at the rows' own rate; columns are decimated once."""

    def __init__(self, position_m: Vector, force_N: Vector, sample_time_s: float) -> None:
        self.sample_time_s = sample_time_s
        self.motion = Motion(*(values[BORDER_SAMPLES:] for values in moved(position_m, sample_time_s)))
        self.factor = max(1, round(0.8 * 0.5 / sample_time_s / MIN_KEPT_BANDWIDTH_Hz))
        self._force_N = force_N
        self._columns: dict[tuple[str, Shape], Vector] = {}

    def column(self, name: str, shape: Shape) -> Vector:
        """Return a term's decimated column [rows]."""
        key = name, shape._replace(dead_time_s=0.0)
        if key not in self._columns:
            self._columns[key] = decimated(column(name, self.motion, shape), self.factor)
        return self._columns[key]

    def matrix(self, law: Law, shape: Shape) -> Vector:
        """Return the decimated columns of a law [rows, terms]."""
        usual = shape if law.low_speed else shape._replace(low_speed_m_per_s=1.0)
        return np.column_stack(
            [self.column(name, shape if name == "low_speed_N" else _without_low(usual)) for name in terms(law)]
        )

    def force_N(self, dead_time_s: float) -> Vector:
        """Return the decimated force, that much later [rows]."""
        return decimated(delayed(self._force_N, dead_time_s / self.sample_time_s)[BORDER_SAMPLES:], self.factor)


def _without_low(shape: Shape) -> Shape:
    return shape._replace(low_speed_m_per_s=1.0)  # one key for all columns that don't hang on it


def moved(position_m: Vector, sample_time_s: float, low_pass_Hz: float = LOW_PASS_Hz) -> Motion:
    """Return low-passed position, speed and acceleration [samples]."""
    smooth = _both_ways(butter(FILTER_ORDER, 2.0 * low_pass_Hz * sample_time_s), position_m)
    speed = np.gradient(smooth, sample_time_s)
    return Motion(smooth, speed, np.gradient(speed, sample_time_s))


def decimated(values: Vector, factor: int) -> Vector:
    """Low-pass forth and back and keep every `factor`-th value, the last one among them."""
    if factor == 1:
        return values
    smooth = _both_ways(cheby1(8, 0.05, 0.8 / factor), values)
    return smooth[(len(values) - 1) % factor :: factor]


def delayed(values: Vector, samples: float) -> Vector:
    """Return the values that many samples later, by a cubic in between; the first one is held before the start."""
    return values if samples == 0.0 else np.asarray(shift(values, samples, order=3, mode="nearest"))


def _both_ways(low_pass: tuple[Vector, Vector], values: Vector) -> Vector:
    numerator, denominator = low_pass
    padding = min(3 * (max(len(numerator), len(denominator)) - 1), len(values) - 1)
    return np.asarray(filtfilt(numerator, denominator, values, padlen=padding))


def solve(rows: Rows, law: Law, shape: Shape, kept: Vector | None = None) -> Fit:
    """Fit the coefficients alone; `kept` [rows] is 1 where a row counts, 0 where not."""
    matrix, force = rows.matrix(law, shape), rows.force_N(shape.dead_time_s)
    if kept is not None:
        here = kept > 0.0
        matrix, force = matrix[here], force[here]
    values = np.linalg.lstsq(matrix, force, rcond=None)[0]
    return Fit(law, shape, dict(zip(terms(law), map(float, values), strict=True)))


def fit(rows: Rows, law: Law, shape: Shape, kept: Vector | None = None) -> Fit:
    """Fit coefficients, and dead time and low speed where the law has them; they start at `shape`'s."""
    has = {"dead_time_s": law.dead_time, "low_speed_m_per_s": law.low_speed}
    free = [name for name, there in has.items() if there]
    if not free:
        return solve(rows, law, shape._replace(dead_time_s=0.0), kept)
    units = {"dead_time_s": 1e-4, "low_speed_m_per_s": 2e-3}
    bounds = {"dead_time_s": (0.0, MAX_DEAD_TIME_s), "low_speed_m_per_s": LOW_SPEED_BOUNDS_m_per_s}
    start = shape if shape.dead_time_s or not law.dead_time else shape._replace(dead_time_s=_START_DEAD_TIME_s)
    first = np.array([getattr(start, name) / units[name] for name in free])

    def at(point: Vector) -> Shape:
        return start._replace(**{name: float(x) * units[name] for name, x in zip(free, point, strict=True)})

    def cost(point: Vector) -> float:
        return float(np.sum(residual(rows, solve(rows, law, at(point), kept), kept) ** 2))

    limits = [tuple(edge / units[name] for edge in bounds[name]) for name in free]
    simplex = np.vstack([first, first + np.eye(len(free))])
    options = {"xatol": 5e-3, "fatol": 1e-6 * cost(first), "initial_simplex": simplex}
    best = minimize(cost, first, method="Nelder-Mead", bounds=limits, options=options)
    return solve(rows, law, at(best.x), kept)


def at_bound(found: Fit) -> bool:
    """Say whether dead time or low speed ended where the search does; no dead time at all is none of that."""
    low, high = LOW_SPEED_BOUNDS_m_per_s
    speed, late = found.shape.low_speed_m_per_s, found.shape.dead_time_s
    at_speed = found.law.low_speed and not (_NEAR_BOUND_RATIO * low < speed < high / _NEAR_BOUND_RATIO)
    return at_speed or (found.law.dead_time and late > MAX_DEAD_TIME_s / _NEAR_BOUND_RATIO)


def predicted(rows: Rows, found: Fit) -> Vector:
    """Return the force that a model takes for the motion of `rows` [rows]."""
    weights = np.array([found.coefficients[name] for name in terms(found.law)])
    return np.asarray(rows.matrix(found.law, found.shape) @ weights)


def residual(rows: Rows, found: Fit, kept: Vector | None = None) -> Vector:
    """Return measured minus predicted force [rows], 0 where a row doesn't count."""
    left = rows.force_N(found.shape.dead_time_s) - predicted(rows, found)
    return left if kept is None else left * (kept > 0.0)


def relative_error(rows: Rows, found: Fit) -> float:
    """Return ‖residual‖ over ‖force‖ (eq. 11 as published, as a share)."""
    return float(np.linalg.norm(residual(rows, found)) / np.linalg.norm(rows.force_N(found.shape.dead_time_s)))
