"""Zeros of series of runs: hidden ones are found, chance makes none, and runs that are held out say nothing of them."""

import math

import numpy as np
import pytest

from hil_forceps.data.run import Run
from hil_forceps.identification.instrument.comparison import EXTENDED, Comparison, compare
from hil_forceps.identification.instrument.report import WHOLE, RunInfo
from hil_forceps.identification.instrument.series_zeros import Means, series_zeros
from hil_forceps.identification.instrument.splits import EXTREMES, ODD_LOADS

FREQUENCIES_Hz = (0.2, 0.3, 0.4, 0.5)
LEVELS = 6
HIDDEN_RAD = (8e-3, -6e-3, 7e-3, -9e-3)
NOISE_RAD = 1e-3


def means(zeros: tuple[float, ...], within: float, seed: int, runs: int = 5) -> tuple[list[Means], dict[str, int]]:
    rng = np.random.default_rng(seed)
    made, series = [], {}
    for number, zero in enumerate(zeros):
        for at in range(runs):
            name = f"{number}{at}"
            made.append(Means(name, float(rng.normal(0.0, within)), zero + float(rng.normal(0.0, within))))
            series[name] = number
    return made, series


def test_zeros_that_stand_out_are_found() -> None:
    found = series_zeros(*means((0.01, -0.02, 0.015), 1e-3, 1))

    assert found.theta_j_chance < 1e-6
    for series, zero in enumerate((0.01, -0.02, 0.015)):
        assert found.of(series)[1] == pytest.approx(zero, abs=2e-3)


def test_zeros_that_are_chance_come_out_smaller_than_the_means_they_come_from() -> None:
    raw, kept, chances = 0.0, 0.0, []
    for seed in range(200):
        train, series = means((0.0, 0.0, 0.0, 0.0), 1e-3, seed)
        found = series_zeros(train, series)
        for number in range(4):
            own = [m.theta_j_rad for m in train if series[m.run] == number]
            raw += float(np.mean(own)) ** 2
            kept += found.of(number)[1] ** 2
        chances.append(found.theta_j_chance)

    assert kept < 0.4 * raw
    assert 0.01 <= float(np.mean(np.array(chances) < 0.05)) <= 0.1


def test_a_series_without_training_runs_and_too_few_runs_have_no_zero() -> None:
    train, series = means((0.01, -0.02), 1e-3, 1)
    assert series_zeros(train, series).of(7) == (0.0, 0.0)

    single = series_zeros(train[:1], series)
    assert single.of(0) == (0.0, 0.0)
    assert math.isnan(single.theta_j_chance)


def instrument(zeros: tuple[float, ...]) -> tuple[list[Run], list[RunInfo]]:
    """Runs of a rigid transmission, θ_j = 0.9 θ_m and τ_w = τ_m, whose jaw sensor has a zero in each series."""
    rng = np.random.default_rng(5)
    time_s = np.arange(6000) * 2e-3
    runs, infos = [], []
    for number, (frequency, zero) in enumerate(zip(FREQUENCIES_Hz, zeros, strict=True)):
        for level in range(LEVELS):
            theta = 0.6 * np.sin(2.0 * np.pi * frequency * time_s + rng.uniform(0.0, 6.0))
            load = 0.01 * level * (1.0 + 0.1 * np.sin(theta))
            columns = {
                "time_s": time_s,
                "theta_m_rad": theta,
                "tau_m_N_m": load + rng.normal(0.0, 1e-5, time_s.size),
                "theta_j_rad": 0.9 * theta + zero + rng.normal(0.0, NOISE_RAD, time_s.size),
                "tau_w_N_m": load,
            }
            runs.append(Run(f"{number}{level}", columns))
            infos.append(RunInfo(f"{number}{level}", frequency, float(np.mean(load)), time_s.size, ()))
    return runs, infos


def compared(runs: list[Run], infos: list[RunInfo]) -> Comparison:
    return compare(runs, infos, ["tau_m_N_m"], lambda *_: {}, with_learned=False)


def errors_of(comparison: Comparison, split: str) -> tuple[float, float]:
    """Return the transmission estimator's error of the angle with one zero for all, and with one for each series."""
    first, second = (
        next(s.theta_j_rmse_rad for s in scores if (s.split, s.method, s.part) == (split, EXTENDED, WHOLE))
        for scores in (comparison.overall, comparison.by_series)
    )
    return first, second


def test_hidden_zeros_are_found_by_the_comparison() -> None:
    found = compared(*instrument(HIDDEN_RAD))

    before, after = errors_of(found, ODD_LOADS)
    assert before > 6.0 * NOISE_RAD
    assert after < 0.35 * before  # the model's own terms have bent to the zeros a little
    zeros = found.zeros[f"{ODD_LOADS}/tau_m_N_m/{WHOLE}"]
    assert zeros.theta_j_chance < 1e-6
    # Errors are estimated minus measured.
    assert [-zeros.of(n)[1] for n in range(4)] == pytest.approx(list(HIDDEN_RAD), abs=2.5e-3)
    # The highest frequency has no training run in the other split: its zero stays, and so does most of the error.
    before, after = errors_of(found, EXTREMES)
    assert 0.5 * before < after < before


def test_without_hidden_zeros_the_second_score_is_the_first() -> None:
    before, after = errors_of(compared(*instrument((0.0, 0.0, 0.0, 0.0))), ODD_LOADS)
    assert after == pytest.approx(before, rel=0.02)


def test_runs_held_out_say_nothing_of_the_zeros() -> None:
    runs, infos = instrument(HIDDEN_RAD)
    before = compared(runs, infos).zeros[f"{ODD_LOADS}/tau_m_N_m/{WHOLE}"]
    others = [
        Run(r.name, {**r.columns, "theta_j_rad": r.columns["theta_j_rad"] + 0.1 * (int(r.name[1]) % 2)}) for r in runs
    ]
    after = compared(others, infos).zeros[f"{ODD_LOADS}/tau_m_N_m/{WHOLE}"]
    assert after == before
