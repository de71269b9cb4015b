"""Loads that ramp and hold: their corners, how far noise leaves these open, and loads that only look like it."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.smoothing import LoadNoise, drawn_noise
from hil_forceps.diagnosis.straight import BLOCKS, PieceCourse, straight_course
from tests.hidden_effects.generator import RIG, run_seed, simulate
from tests.hidden_effects.generator_scenarios import SCENARIOS

Vector = NDArray[np.float64]

ROWS, PERIOD_S = 6000, 1e-3
TIME_S: Vector = PERIOD_S * np.arange(ROWS, dtype=np.float64)
SD_N_M = 1e-5
WHITE = LoadNoise(np.array([0.0, 500.0]), np.full(2, SD_N_M**2))
COLOURED = LoadNoise(np.array([0.0, 5.0, 50.0, 500.0]), SD_N_M**2 * np.array([9.0, 9.0, 1.0, 0.3]))
SLOW = LoadNoise(np.geomspace(0.1, 500.0, 60), SD_N_M**2 * 19.0 / (1.0 + (np.geomspace(0.1, 500.0, 60) / 16.8) ** 2))
CORNERS_S = (0.4003, 1.1007, 1.6502, 2.3009, 3.2001, 3.9004, 4.6666, 5.3331)
LEVELS_N_M = (0.0, 2e-3, 2e-3, -1e-3, -1e-3, 1.5e-3, 1.5e-3, 0.5e-3)
LOAD_N_M: Vector = np.interp(TIME_S, CORNERS_S, LEVELS_N_M)


def course(load: Vector, noise: LoadNoise = WHITE, seed: int = 0) -> PieceCourse | None:
    noisy = load + drawn_noise(np.random.default_rng(seed), load.size, PERIOD_S, noise)
    return straight_course(noisy, max(1, load.size // BLOCKS), PERIOD_S, noise)


def rounded(width_s: float) -> Vector:
    """The load with each corner bent evenly over a width."""
    shifts = np.linspace(-0.5, 0.5, 101) * width_s
    return np.asarray(np.mean([np.interp(TIME_S + shift, CORNERS_S, LEVELS_N_M) for shift in shifts], axis=0))


@pytest.mark.parametrize("noise", [WHITE, COLOURED], ids=["white", "coloured"])
def test_ramps_and_holds_are_known_as_well_as_foretold(noise: LoadNoise) -> None:
    found = [course(LOAD_N_M, noise, seed) for seed in range(40)]
    straight = [one for one in found if one is not None]
    assert len(straight) >= 38
    errors = np.array([one.load - LOAD_N_M for one in straight])
    foretold = np.sum(straight[0].error ** 2, axis=1)
    near = np.min(np.abs(TIME_S[:, None] - CORNERS_S), axis=1) < 0.01
    away = np.min(np.abs(TIME_S[:, None] - CORNERS_S), axis=1) > 0.02
    assert np.sqrt(np.mean(errors[:, away] ** 2) / np.mean(foretold[away])) == pytest.approx(1.0, abs=0.2)
    # At a corner its instant and its rounding are open as well.
    assert np.mean(foretold[near]) > 1.5 * np.mean(foretold[away])
    assert np.std(errors.mean(axis=0)) < 0.4 * np.std(errors)
    assert max(one.fitted for one in straight) <= 2 + 3 * (len(CORNERS_S) + 1)
    if noise is WHITE:
        assert np.std(errors) < 0.1 * SD_N_M


def distance(off: Vector, error: Vector) -> float:
    """χ² of a load that is off, by what its course leaves open and what a motor shows of it beside that."""
    seen_N_m = 2e-6
    size = np.concatenate((error / seen_N_m, np.eye(error.shape[1])))
    wanted = np.concatenate((off / seen_N_m, np.zeros(error.shape[1])))
    return float(np.sum((wanted - size @ np.linalg.lstsq(size, wanted, rcond=None)[0]) ** 2))


def test_a_ramp_that_slow_noise_hides_is_within_what_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    weak = LOAD_N_M + np.interp(TIME_S, (2.6, 2.8), (0.0, 1.2e-5))
    found = course(weak, COLOURED, 5)
    monkeypatch.setattr("hil_forceps.diagnosis.straight.HIDES", np.inf)
    bare = course(weak, COLOURED, 5)
    assert found is not None
    assert bare is not None
    assert found.fitted == bare.fitted == 2 + 3 * len(CORNERS_S)  # it isn't seen
    assert np.array_equal(found.load, bare.load)
    told, missed = distance(found.load - weak, found.error), distance(bare.load - weak, bare.error)
    assert missed > 2.0 * bare.error.shape[1]
    assert told < 0.6 * missed


def test_noise_makes_no_bends() -> None:
    found = [course(LOAD_N_M, SLOW, seed) for seed in range(40)]
    assert [one.fitted for one in found if one is not None] == [2 + 3 * len(CORNERS_S)] * 40


def test_a_hold_has_level_and_slope() -> None:
    found = course(np.full(ROWS, 1e-3))
    assert found is not None
    assert found.error.shape == (ROWS, 2)
    assert np.abs(found.load - 1e-3).max() < SD_N_M * 5.0 / np.sqrt(ROWS)


@pytest.mark.parametrize("width_s", [0.1, 0.3])
def test_round_corners_are_no_corners(width_s: float) -> None:
    assert course(rounded(width_s)) is None


def test_a_corner_too_little_rounded_to_be_seen_is_within_what_is_told() -> None:
    load = rounded(6e-3)
    found = course(load)
    assert found is not None
    # What is left of the load's difference when the error's columns take what they can: fast parts, as a wire rings.
    missed = np.fft.rfft(load - LOAD_N_M)
    seen = np.fft.rfft(found.error, axis=0)
    ringing = slice(round(100.0 * ROWS * PERIOD_S), round(150.0 * ROWS * PERIOD_S))
    of_all = np.concatenate((missed[ringing].real, missed[ringing].imag))
    columns = np.concatenate((seen[ringing].real, seen[ringing].imag))
    normal = np.linalg.lstsq(columns, of_all, rcond=1e-3)[0]
    assert np.sum((of_all - columns @ normal) ** 2) < 0.1 * np.sum(of_all**2)
    assert np.sum(normal**2) < 3.0 * len(CORNERS_S)  # by so many standard normal numbers


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("scenario", ["teleoperation", "grasp", "chirp", "spin"])
def test_loads_that_bend_otherwise_have_no_corners(scenario: str, seed: int) -> None:
    assert course(load_of(scenario, seed)) is None


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("scenario", ["multisine", "slow"])
def test_ramps_of_a_whole_run_are_found(scenario: str, seed: int) -> None:
    load = load_of(scenario, seed)
    found = course(load)
    assert found is not None
    assert np.std(found.load - load) < 0.12 * SD_N_M


def load_of(scenario: str, seed: int) -> Vector:
    return np.asarray(simulate(RIG, SCENARIOS[scenario], run_seed(20_000 + seed, 1))[1].tau_w_N_m)


def test_a_vibration_that_means_of_blocks_hide_is_seen() -> None:
    assert course(LOAD_N_M + 20.0 * SD_N_M * np.sin(2.0 * np.pi * 100.0 * TIME_S)) is None


def test_few_rows_have_no_course() -> None:
    assert straight_course(np.zeros(7), 1, PERIOD_S, WHITE) is None


def test_too_few_rows_to_seek_bends_in_are_one_line() -> None:
    short = straight_course(LOAD_N_M[1800:1870], 10, PERIOD_S, WHITE)
    assert short is not None
    assert np.abs(short.load - LOAD_N_M[1800:1870]).max() < 1e-3 * SD_N_M
    assert short.error.shape == (70, 2)


def test_corners_close_to_each_other_are_a_bend() -> None:
    assert course(np.interp(TIME_S, (2.0, 2.06, 3.0), (0.0, 6e-4, 8e-4))) is None
