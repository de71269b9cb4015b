"""The load cell's noise, drawn anew: it comes through where the load bends, and sums over such instants scatter."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import fft

from hil_forceps.diagnosis.assemble import assemble
from hil_forceps.diagnosis.diagnose import Options, without_load_noise
from hil_forceps.diagnosis.echoes import ECHOES, load_echoes
from hil_forceps.diagnosis.experiment import Record, prepare
from hil_forceps.diagnosis.predict import ClosedLoop
from hil_forceps.diagnosis.problem import Matrix, Problem
from hil_forceps.diagnosis.robust import inflations, widenings
from hil_forceps.diagnosis.score import Group
from hil_forceps.diagnosis.smoothing import LoadNoise
from hil_forceps.diagnosis.spectrum import MOTOR, Layout, fill, make_layout
from tests.hidden_effects.generator import make_case

BEND_S, NEAR_S = 6.0, 0.2


def problem_of() -> Problem:
    case = make_case({}, 11100, scenarios=(("slow",), ()))
    records, _ = prepare(case.fit, case.true)
    records, _ = without_load_noise(records, [], case.true, Options())
    return assemble(records, case.true, map).problem


def with_loads(problem: Problem, changed: Callable[[Record], Record]) -> Problem:
    loop = problem.simulate_runs
    assert isinstance(loop, ClosedLoop)
    return replace(problem, simulate_runs=replace(loop, records=tuple(changed(record) for record in loop.records)))


def bent(record: Record) -> Record:
    """Return a record whose load is steady but for some quick swings."""
    away = record.time_s - BEND_S
    return record._replace(tau_w_N_m=1e-3 + 5e-4 * np.sin(2.0 * np.pi * 12.0 * away) * np.exp(-((away / NEAR_S) ** 4)))


def test_noise_comes_through_where_the_load_bends() -> None:
    problem = with_loads(problem_of(), bent)
    echoes = load_echoes(problem, np.zeros(problem.size))
    assert echoes is not None
    assert echoes.shape == (problem.layout.size, ECHOES)
    part = next(part for part in problem.layout.parts if part.channel == MOTOR)
    bins = echoes[part.start : part.stop].T.copy().view(np.complex64)
    time_s = problem.records[0].time_s
    bins[:, np.arange(bins.shape[1]) / time_s[-1] < 10.0] = 0.0
    power = np.mean(fft.irfft(bins, part.rows, axis=1) ** 2, axis=0)
    near = np.abs(time_s - BEND_S) < NEAR_S
    inside = np.abs(time_s - BEND_S) < 4.0
    assert power[near].mean() > 10.0 * power[inside & ~near].mean()


def test_no_noise_has_no_echo_and_draws_are_the_same_each_time() -> None:
    problem = problem_of()
    none = LoadNoise(np.array([0.0, 500.0]), np.zeros(2))
    quiet = load_echoes(with_loads(problem, lambda r: r._replace(load_noise=none)), np.zeros(problem.size))
    assert quiet is not None
    assert not quiet.any()
    assert load_echoes(with_loads(problem, lambda r: r._replace(load_noise=None)), np.zeros(problem.size)) is None
    first, again = (load_echoes(problem, np.zeros(problem.size)) for _ in range(2))
    assert first is not None
    assert again is not None
    assert np.array_equal(first, again)
    assert len({float(column.sum()) for column in first.T}) == ECHOES


ROWS, RUNS, SETS = 3000, 3, 400


def bursts(where: Layout, rng: np.random.Generator) -> Matrix:
    """Return whitened noise of power 1: 0.7 of it even, 0.3 in bursts of one form at two instants."""
    flat = np.zeros(where.size, dtype=np.float32)
    for part in where.parts:
        values = np.sqrt(0.7) * rng.standard_normal(ROWS)
        fill(flat, part, values + burst(rng.standard_normal(2)))
    return flat


def burst(sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    course = np.zeros(ROWS)
    for size, start in zip(sizes, (800, 1900), strict=True):
        course[start : start + 300] += size * np.sqrt(0.3 * ROWS / 2 / 300) * np.sign(np.sin(np.arange(300) / 20.0))
    return course


def test_the_variance_of_a_sum_with_bursts_is_foretold() -> None:
    where = make_layout([("theta_j_rad",)] * RUNS, [np.ones(ROWS)] * RUNS, [1e-3] * RUNS)
    rng = np.random.default_rng(5)
    columns = np.zeros((where.size, 2), dtype=np.float32)
    for part in where.parts:
        fill(columns[:, 0], part, burst(np.array([1.0, 0.3])))
        fill(columns[:, 1], part, np.cos(np.arange(ROWS) / 7.0))
    columns /= np.linalg.norm(columns, axis=0)
    loads = []
    for _ in range(64):
        flat = np.zeros(where.size, dtype=np.float32)
        for part in where.parts:
            fill(flat, part, burst(rng.standard_normal(2)))
        loads.append(flat)
    groups = [Group(0, 1, one_sided=False), Group(1, 2, one_sided=False)]
    nothing = np.zeros((where.size, 1), dtype=np.float32)
    foretold = inflations(where, nothing, columns, groups, np.zeros(where.size, np.float32), np.stack(loads, axis=1))
    seen = np.var([columns.T @ bursts(where, rng) for _ in range(SETS)], axis=0)
    assert seen[0] > 20.0
    assert foretold[0] == pytest.approx(seen[0], rel=0.35)
    assert foretold[1] == pytest.approx(max(seen[1], 1.0), rel=0.2)
    wider = widenings(where, columns, np.zeros(2), np.stack(loads, axis=1))
    assert wider**2 == pytest.approx(foretold, rel=0.2)
