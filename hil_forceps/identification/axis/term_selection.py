"""Which terms an axis needs, by one run alone: each is judged on parts of it that were left out in turn.

The rungs are the same for every axis and stand in a fixed order. A rung stays where the squared error on blocks of a
second, each predicted from all others, falls by more than `MIN_GAIN_SD` times the standard error of that fall over
blocks, and where no number of it sits at a bound: friction at a low speed that the low pass can't resolve is the low
pass.
"""

from typing import NamedTuple

import numpy as np

from hil_forceps.identification.axis.axis import AxisRun
from hil_forceps.identification.axis.force_terms import Law, Shape, Vector, terms
from hil_forceps.identification.axis.inverse_model import Fit, Rows, at_bound, fit, relative_error, residual, solve
from hil_forceps.identification.axis.ripple import period_m

BLOCK_S = 1.0
MIN_GAIN_SD = 2.0
RUNGS = ("asymmetric", "dead_time", "low_speed", "ripple", "position")
_T_95 = 2.07  # Student's t for 23 degrees of freedom: 24 blocks


class Rung(NamedTuple):
    """One step of the ladder, all from the training run."""

    term: str  # "" for the published law with one friction for both directions
    fit: Fit
    error: float  # share of the force
    left_out_error: float  # on blocks left out in turn
    gain_sigmas: float  # fall of the left-out squared error against the rung below, over its standard error
    kept: bool


class Interval(NamedTuple):
    """A number and its 95 % interval, from leaving out blocks in turn."""

    value: float
    low: float
    high: float


def blocks(run: AxisRun) -> Vector:
    """Number the rows by blocks [rows]; what is left at the end belongs to the last whole one."""
    time_s = run.row_time_s
    count = max(4, int((time_s[-1] - time_s[0]) / BLOCK_S))
    return np.minimum(np.arange(len(time_s)) * count // len(time_s), count - 1).astype(np.float64)


def climb(run: AxisRun) -> tuple[Rung, ...]:
    """Fit every rung to a run and judge it there."""
    rows, where = run.rows, blocks(run)
    middle = 0.5 * float(run.position_m.min() + run.position_m.max())
    shape = Shape(middle_m=middle, half_path_m=0.5 * float(np.ptp(run.position_m)))
    found = fit(rows, Law(), shape)
    errors = left_out(rows, found, where)
    rungs = [_rung(rows, "", found, errors, float("inf"), kept=True)]
    for term in RUNGS:
        base = found
        if term == "ripple":
            base = base._replace(shape=base.shape._replace(ripple_period_m=period_m(run, base)))
        tried = fit(rows, base.law._replace(**{term: True}), base.shape)
        there = left_out(rows, tried, where)
        fall = errors - there
        sigmas = float(fall.mean() / (fall.std(ddof=1) / np.sqrt(len(fall))))
        kept = sigmas > MIN_GAIN_SD and not at_bound(tried)
        rungs.append(_rung(rows, term, tried, there, sigmas, kept=kept))
        if kept:
            found, errors = tried, there
    return tuple(rungs)


def _rung(rows: Rows, term: str, found: Fit, errors: Vector, sigmas: float, *, kept: bool) -> Rung:
    force = rows.force_N(found.shape.dead_time_s)
    return Rung(
        term, found, relative_error(rows, found), float(np.sqrt(errors.mean() / np.mean(force**2))), sigmas, kept
    )


def left_out(rows: Rows, found: Fit, where: Vector) -> Vector:
    """Return the mean squared error of every block, its coefficients fitted to the others [blocks].

    Dead time and low speed stay those of the whole run: two numbers among some ten.
    """
    numbers = range(int(where[-1]) + 1)
    fits = [solve(rows, found.law, found.shape, np.asarray(where != number, np.float64)) for number in numbers]
    left = [residual(rows, other)[where == number] for number, other in zip(numbers, fits, strict=True)]
    return np.array([float(np.mean(part**2)) for part in left])


def chosen(rungs: tuple[Rung, ...]) -> Rung:
    """Return the highest rung that stayed."""
    return [rung for rung in rungs if rung.kept][-1]


def jackknife(run: AxisRun, found: Fit) -> list[Fit]:
    """Return the fits without each block in turn, dead time and low speed fitted again."""
    where = blocks(run)
    numbers = range(int(where[-1]) + 1)
    return [fit(run.rows, found.law, found.shape, np.asarray(where != number, np.float64)) for number in numbers]


def numbers_of(found: Fit) -> dict[str, float]:
    """Return coefficients, and what else was fitted, by name."""
    law, shape = found.law, found.shape
    extra = {"dead_time_s": shape.dead_time_s} if law.dead_time else {}
    low = {"low_speed_m_per_s": shape.low_speed_m_per_s} if law.low_speed else {}
    return {name: found.coefficients[name] for name in terms(law)} | extra | low


def intervals(found: Fit, others: list[Fit]) -> dict[str, Interval]:
    """Return every fitted number with its interval (delete-a-block jackknife)."""
    told = {}
    for name, value in numbers_of(found).items():
        values = np.array([numbers_of(other)[name] for other in others])
        count = len(values)
        error = float(np.sqrt((count - 1) / count * np.sum((values - values.mean()) ** 2)))
        told[name] = Interval(value, value - _T_95 * error, value + _T_95 * error)
    return told
