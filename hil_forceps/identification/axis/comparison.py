"""An axis diagnosed by its inverse model: terms chosen on the first run alone, then held against the others.

Nothing of a test run is used but its force and motion, to be compared with. Where one number of it is fitted all the
same (the ripple's zero, what an open loop would have needed), it stands apart and says so.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from hil_forceps.identification.axis import evidence
from hil_forceps.identification.axis.axis import AxisRun
from hil_forceps.identification.axis.force_terms import Vector, terms
from hil_forceps.identification.axis.inverse_model import Fit, fit, relative_error, residual
from hil_forceps.identification.axis.network_fit import NetworkFit
from hil_forceps.identification.axis.open_loop_runs import (
    Needed,
    OpenLoop,
    compare_open_loop,
    needed,
    position_error,
    rms,
)
from hil_forceps.identification.axis.ripple import Spectrum, period_m, spectrum, zero_m
from hil_forceps.identification.axis.term_selection import Interval, Rung, blocks, chosen, climb, intervals, jackknife
from hil_forceps.rig.errors import UserError

SEED = 20
_DRAWS = 200
_PUBLISHED_TERM = "asymmetric"

Note = Callable[[int, int, str], None]


class TestError(NamedTuple):
    """Force error of one rung on one test run, as a share of the force, with its 95 % interval over blocks."""

    run: str
    term: str
    error: Interval
    with_zero: float | None  # the ripple's zero fitted to this run; None without a ripple


class RunEvidence(NamedTuple):
    """What one run shows, with the chosen model's friction taken out."""

    run: str
    bands: tuple[evidence.Band, ...]
    stiffness: evidence.Stiffness | None
    roll_off_decades: float
    ripple: Spectrum
    ripple_period_m: float
    ripple_zero_m: float  # against the training run, within a period
    strokes: tuple[evidence.Stroke, ...]  # beside the training run's; empty for that one itself


class AxisComparison(NamedTuple):
    """Everything that was found."""

    train: AxisRun
    tests: tuple[AxisRun, ...]
    rungs: tuple[Rung, ...]
    chosen: Rung
    intervals: dict[str, Interval]
    errors: tuple[TestError, ...]
    open_loops: tuple[OpenLoop, ...]
    open_loop_chosen: OpenLoop  # least error on the training run's second half
    open_loop_range_m: tuple[Interval, ...]  # chosen inverse model, per test run, by its coefficients' errors
    needed: tuple[Needed, ...]  # per test run
    profiles: dict[str, Vector]  # term -> force error over `axis_evidence.DEAD_TIMES_s`, training run
    evidence: tuple[RunEvidence, ...]
    networks: tuple[NetworkFit, ...] = ()  # where they were asked for


def compare_axis(runs: Sequence[AxisRun], note: Note | None = None) -> AxisComparison:
    """Fit to the first run, hold against the others; UserError with fewer than two."""
    if len(runs) < 2:
        raise UserError("an axis is compared on runs that were not fitted; give two sources or more, the first trains")
    say = note or (lambda _done, _total, _what: None)
    train, tests = runs[0], tuple(runs[1:])
    say(0, 4, f"terms, by {train.name} alone")
    rungs = climb(train)
    best = chosen(rungs)
    say(1, 4, "intervals")
    others = jackknife(train, best.fit)
    errors = tuple(_test_error(run, rung) for run in tests for rung in rungs)
    say(2, 4, "open loop")
    open_loops = tuple(told for rung in rungs if rung.kept for told in _open_loops(rung, train, tests))
    driven = min(open_loops, key=lambda told: told.second_half_rmse_m)
    say(3, 4, "evidence")
    ranges = tuple(_open_loop_range(run, best.fit, others) for run in tests)
    lacking = tuple(needed(run, driven.fit) for run in tests)
    shown = tuple(_evidence(run, train, rungs, best.fit) for run in runs)
    return AxisComparison(
        train, tests, rungs, best, intervals(best.fit, others), errors, open_loops, driven, ranges, lacking,
        _profiles(train, rungs), shown,
    )  # fmt: skip


def _test_error(run: AxisRun, rung: Rung) -> TestError:
    left = residual(run.rows, rung.fit)
    force = run.rows.force_N(rung.fit.shape.dead_time_s)
    where = blocks(run)
    numbers = range(int(where[-1]) + 1)
    sums = np.array([[np.sum(part[where == number] ** 2) for number in numbers] for part in (left, force)])
    drawn = np.random.default_rng(SEED).integers(0, len(numbers), (2000, len(numbers)))
    low, high = np.quantile(np.sqrt(sums[0][drawn].sum(1) / sums[1][drawn].sum(1)), (0.025, 0.975))
    zero = zero_m(run, rung.fit)[1] if rung.fit.law.ripple else None
    return TestError(run.name, rung.term, Interval(relative_error(run.rows, rung.fit), float(low), float(high)), zero)


def _open_loops(rung: Rung, train: AxisRun, tests: tuple[AxisRun, ...]) -> tuple[OpenLoop, ...]:
    count = len(train.row_time_s)
    first = (np.arange(count) < count // 2).astype(np.float64)
    half = fit(train.rows, rung.fit.law, rung.fit.shape, first)
    return compare_open_loop(rung.term, rung.fit, half, train, list(tests))


def _open_loop_range(run: AxisRun, found: Fit, others: list[Fit]) -> Interval:
    """Return the position's error with coefficients drawn from their errors (delete-a-block, normal)."""
    names = terms(found.law)
    values = np.array([[other.coefficients[name] for name in names] for other in others])
    count = len(values)
    away = (values - values.mean(axis=0)) * np.sqrt((count - 1) / count)
    middle = np.array([found.coefficients[name] for name in names])
    draws = middle + np.random.default_rng(SEED).normal(size=(_DRAWS, count)) @ away
    fits = [found._replace(coefficients=dict(zip(names, map(float, draw), strict=True))) for draw in draws]
    low, high = np.quantile([rms(position_error(run, drawn)) for drawn in fits], (0.025, 0.975))
    return Interval(rms(position_error(run, found)), float(low), float(high))


def _profiles(train: AxisRun, rungs: tuple[Rung, ...]) -> dict[str, Vector]:
    shown = [rung for rung in rungs if rung.term in ("", _PUBLISHED_TERM)] + [chosen(rungs)]
    return {rung.term: evidence.dead_time_profile(train, rung.fit.law, rung.fit.shape) for rung in shown}


def _evidence(run: AxisRun, train: AxisRun, rungs: tuple[Rung, ...], best: Fit) -> RunEvidence:
    """Look at one run; the ripple is looked for with the chosen model refitted to the run and its ripple left out."""
    bands = evidence.response(run, best)
    smooth = fit(run.rows, best.law._replace(ripple=False), best.shape)
    zero = zero_m(run, best)[0] if best.law.ripple else 0.0
    beside = () if run is train else evidence.strokes(train, run, rungs[0].fit)
    stiff = evidence.stiffness(bands, run.sample_time_s)
    found, rate = spectrum(run, smooth), evidence.roll_off(run)
    return RunEvidence(run.name, bands, stiff, rate, found, period_m(run, smooth), zero, beside)
