"""The axis by a network, fitted as published, from several seeds: what a black box tells of a test run, and how surely.

One fit ends at one number. How far it lies from another seed's, and how far it moves while the fit goes on, say what it
is worth.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.identification.axis.axis import AxisRun
from hil_forceps.identification.axis.force_terms import Vector
from hil_forceps.identification.axis.network import STRETCH_ROWS, STRETCHES, descend, first_weights, play
from hil_forceps.rig.errors import UserError

ROW_s = 5e-3  # as published: every fifth sample of a millisecond
INPUT_RMS = 1.54  # of the network's input: that of EMPS's control signal in volts, which it was published with
STEPS, TOLD_EVERY, SEEDS = 10_000, 500, 5
MAX_ERROR_m = 1e3

Mapper = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
Rows = NDArray[np.int64]


class Told(NamedTuple):
    """Errors of the position in open loop after so many steps of a fit, RMS over a run; infinite where it runs away."""

    steps: int
    train_rmse_m: float
    test_rmse_m: tuple[float, ...]  # one per test run


class NetworkFit(NamedTuple):
    """One fit, told every `TOLD_EVERY` steps; the last is its end."""

    seed: int
    told: tuple[Told, ...]


class _Scaled(NamedTuple):
    """Rows of a run as the network sees them, without units."""

    position: Vector
    speed: Vector
    force: Vector
    step_s: float
    half_m: float


def fit_networks(
    train: AxisRun, tests: Sequence[AxisRun], seeds: int = SEEDS, steps: int = STEPS, mapper: Mapper = map
) -> tuple[NetworkFit, ...]:
    """Fit to the training run from several seeds, tests only looked at; UserError where the run is too short."""
    middle, half = 0.5 * float(train.position_m.min() + train.position_m.max()), 0.5 * float(np.ptp(train.position_m))
    unit = float(np.sqrt(np.mean(train.force_N**2))) / INPUT_RMS
    runs = [_scaled(run, middle, half, unit) for run in (train, *tests)]
    if len(runs[0].position) < 2 * STRETCH_ROWS + STRETCHES:
        raise UserError(f"run {train.name}: too short for a network; leave --black-boxes out")
    return tuple(mapper(lambda seed: _fit(seed, runs, steps), range(seeds)))


def _scaled(run: AxisRun, middle_m: float, half_m: float, unit_N: float) -> _Scaled:
    kept = slice(None, None, max(1, round(ROW_s / run.sample_time_s)))
    position = (run.position_m - middle_m) / half_m
    speed = np.diff(position, prepend=position[0]) / run.sample_time_s
    step_s = run.sample_time_s * float(kept.step)
    return _Scaled(position[kept].copy(), speed[kept].copy(), run.force_N[kept] / unit_N, step_s, half_m)


def _fit(seed: int, runs: Sequence[_Scaled], steps: int) -> NetworkFit:
    rng, train = np.random.default_rng(seed), runs[0]
    unknowns = first_weights(rng)
    states = np.column_stack((train.position, train.speed))
    last = len(train.position) - STRETCH_ROWS

    def drawn(count: int) -> Rows:
        return np.array([rng.choice(last, STRETCHES, replace=False) for _ in range(count)], dtype=np.int64)

    sizes = _first_errors(drawn(1)[0], train, states, unknowns)
    moments = [np.zeros_like(values) for values in (unknowns, unknowns, states, states)]
    told = []
    for done in range(0, steps, TOLD_EVERY):
        starts = drawn(min(TOLD_EVERY, steps - done))
        descend(starts, done, train.force, train.position, states, train.step_s, sizes, unknowns, *moments)
        train_rmse, *test_rmse = (_error_m(run, unknowns) for run in runs)
        told.append(Told(done + len(starts), train_rmse, tuple(test_rmse)))
    return NetworkFit(seed, tuple(told))


def _first_errors(rows: Rows, train: _Scaled, states: Vector, unknowns: Vector) -> Vector:
    """Return what errors are measured in: those of stretches before the fit, RMS.

    That of the speed is its distance from the position, as in the published fit.
    """
    squares = np.zeros(2)
    for row in rows:
        here = slice(int(row), int(row) + STRETCH_ROWS)
        played = play(unknowns, train.force[here], states[row], train.step_s)
        off = np.stack((played, np.gradient(played, train.step_s))) - train.position[here]
        squares += np.mean(off**2, axis=1)
    return np.asarray(np.sqrt(squares / len(rows)))


def _error_m(run: _Scaled, unknowns: Vector) -> float:
    """Return the RMS error over a whole run, from rest at its first position, as published."""
    off = run.half_m * (play(unknowns, run.force, np.array([run.position[0], 0.0]), run.step_s) - run.position)
    return float(np.sqrt(np.mean(off**2))) if np.max(np.abs(off)) < MAX_ERROR_m else float("inf")
