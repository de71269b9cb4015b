"""How much a measured load may change from row to row, as process noise of the filter.

An integrated random walk of the likeliest size; beside it breaks of slope and jumps, where their χ² is beyond chance. A
break's variance is spread over the rows where it may be, by how likely each is.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.preparation.load_kernel import Shocks, empty_filtering, empty_shocks, load_pass
from hil_forceps.diagnosis.state_space.layout import Series

Vector = NDArray[np.float64]

# 3.5 deviations: by chance one in a run or two of 12 000 rows. A break that is none costs a few rows of evidence; one
# that is overlooked leaves a torque of 5 µN m, which a fine encoder sees with 6 deviations.
BREAK_CHI2 = 12.0
MIN_SEPARATION_S = 0.12  # of two breaks found in one pass: nearer, one is the other's echo
_REACH_S = 0.04  # of a break's possible rows
_LEAST_LIKELY = 1e-3  # of the likeliest row: what is less likely gets no variance
_ROUNDS = 8
_LOWEST, _HIGHEST = (
    -12.5,
    -2.0,
)  # decimal logarithm of the slope's variance [(N m/s)²] at a load of 1 mN m and rows of 1 ms


class LoadPrior(NamedTuple):
    """Process noise of a load, and the load as smoothed with it."""

    slope_variance: Vector  # n [(N m/s)²]
    jump_variance: Vector  # n [(N m)²]
    course_N_m: Vector  # n
    open_sd_N_m: float  # what is left open of the load as filtered, in the median


class _Break(NamedTuple):
    jump: bool  # else a change of slope
    first: int
    variances: Vector

    @property
    def row(self) -> int:
        return self.first + int(np.argmax(self.variances))


class _Fit:
    """A load with its breaks so far."""

    def __init__(self, load: Vector, noise: float, period_s: float) -> None:
        self.load, self.noise, self.period_s = load, noise, period_s
        self.breaks: list[_Break] = []
        self.shocks: Shocks = empty_shocks(load.size)
        self._filtering = empty_filtering(load.size)
        self.log_variance = 0.0

    def variances(self, but: int = -1) -> tuple[Vector, Vector]:
        slope, jump = np.zeros(self.load.size), np.zeros(self.load.size)
        for i, found in enumerate(self.breaks):
            if i != but:
                into = jump if found.jump else slope
                into[found.first : found.first + found.variances.size] += found.variances
        return slope, jump

    def run(self, log_variance: float, but: int = -1) -> float:
        slope, jump = self.variances(but)
        slope += 10.0**log_variance
        return load_pass(self.load, self.noise, slope, jump, self.period_s, self._filtering, self.shocks)

    def settle(self, low: float, high: float) -> None:
        """Take the likeliest stationary variance: by decades, then by quarters of one."""
        for step in (1.0, 0.25):
            grid = np.arange(low, high + 0.5 * step, step)
            self.log_variance = float(grid[int(np.argmax([self.run(float(g)) for g in grid]))])
            low, high = self.log_variance - 0.75, self.log_variance + 0.75

    def at(self, row: int) -> _Break:
        """Return a break at a row, spread over where else it may be."""
        reach = max(3, round(_REACH_S / self.period_s))
        first, last = max(0, row - reach), min(self.load.size, row + reach + 1)
        s = self.shocks
        jump = bool(s.jump_chi2[row] >= s.slope_chi2[row])
        chi2, size = (s.jump_chi2, s.jump) if jump else (s.slope_chi2, s.slope)
        likely = np.exp(0.5 * (chi2[first:last] - chi2[first:last].max()))
        # A break between rows shows as two, one at each.
        likely[np.abs(np.arange(first, last) - row) <= (1 if jump else 2)] += 0.05
        likely[likely < _LEAST_LIKELY] = 0.0
        return _Break(jump, first, float(size[row]) ** 2 * likely / likely.sum())

    def strongest(self) -> Vector:
        best = np.maximum(self.shocks.slope_chi2, self.shocks.jump_chi2)
        best[:3] = best[-3:] = 0.0
        return best


def load_prior(load: Vector, noise_variance: float, period_s: float, reach_N_m: float = 0.0) -> LoadPrior:
    """Return the process noise of a load measured with white noise of `noise_variance` at equally spaced rows.

    `reach_N_m`: of the load that this is a part of; what is known of that part is no better than in proportion to it.
    """
    fit = _Fit(load, noise_variance, period_s)
    scale = max(float(np.std(load)), reach_N_m, math.sqrt(noise_variance)) / 1e-3
    shift = 2.0 * math.log10(scale) + math.log10(period_s / 1e-3)
    low, high = _LOWEST + shift, _HIGHEST + shift
    fit.settle(low, high)
    apart = max(3, round(MIN_SEPARATION_S / period_s))
    for _ in range(_ROUNDS):
        fit.run(fit.log_variance)
        found = _peaks(fit.strongest(), apart)
        fit.breaks += [fit.at(row) for row in found]
        if not found:
            break
        fit.settle(low, fit.log_variance + 0.5)
        _relocate(fit, apart)
    fit.run(fit.log_variance)
    slope, jump = fit.variances()
    open_sd = math.sqrt(float(np.median(fit.shocks.open_variance)))
    return LoadPrior(slope + 10.0**fit.log_variance, jump, fit.shocks.course.copy(), open_sd)


def posterior_draw(rng: np.random.Generator, d: Series, noise_variance: float) -> Vector:
    """Return a draw of what a load cell of this noise leaves open of a load (n).

    A load is drawn from the prior and measured; what the smoother misses of it is such a draw (Durbin and Koopman,
    Biometrika 89, 2002).
    """
    n = d.encoder_rad.size
    slope = np.cumsum(np.sqrt(d.load_slope_variance) * rng.standard_normal(n))
    jumps = np.sqrt(d.load_jump_variance) * rng.standard_normal(n)
    load = np.concatenate(([0.0], np.cumsum(d.period_s * slope + jumps)[:-1]))
    shown = load + math.sqrt(noise_variance) * rng.standard_normal(n)
    shocks = empty_shocks(n)
    filtering = empty_filtering(n)
    load_pass(shown, noise_variance, d.load_slope_variance, d.load_jump_variance, d.period_s, filtering, shocks)
    return np.asarray(shocks.course - load)


def _peaks(chi2: Vector, apart: int) -> list[int]:
    """Return the rows of the highest values beyond `BREAK_CHI2`, no two nearer than `apart`."""
    left, found = chi2.copy(), []
    while (row := int(np.argmax(left))) >= 0 and left[row] >= BREAK_CHI2:
        found.append(row)
        left[max(0, row - apart) : row + apart + 1] = 0.0
    return found


def _relocate(fit: _Fit, apart: int) -> None:
    """Move each break to where it is likeliest beside all others; drop those that aren't needed any more."""
    i = 0
    while i < len(fit.breaks):
        fit.run(fit.log_variance, but=i)
        row, best = fit.breaks[i].row, fit.strongest()
        first, last = max(3, row - apart // 2), min(fit.load.size - 3, row + apart // 2 + 1)
        at = first + int(np.argmax(best[first:last]))
        if best[at] < BREAK_CHI2:
            fit.breaks.pop(i)
        else:
            fit.breaks[i] = fit.at(at)
            i += 1
