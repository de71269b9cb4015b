"""Jumps of a load below what a row shows: found, not found where there are none, and their instants as open as told."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.load_course import load_course
from hil_forceps.diagnosis.small_jumps import SmallJump, small_jumps
from hil_forceps.diagnosis.smoothing import LoadNoise, drawn_noise, noise_filter

Vector = NDArray[np.float64]

PERIOD_S = 1e-3
SD_N_M = 1e-5
ROWS, AT = 1000, 499
_HZ: Vector = np.concatenate(([0.0], np.geomspace(2.0, 500.0, 40)))
WHITE = LoadNoise(_HZ, np.full(_HZ.size, SD_N_M**2))
# What hangs on the row before by 0.9.
COLOURED = LoadNoise(_HZ, SD_N_M**2 * 0.19 / np.abs(1.0 - 0.9 * np.exp(-2j * np.pi * _HZ * PERIOD_S)) ** 2)
SEEDS = range(40)


def jump(size: float) -> Vector:
    return np.where(np.arange(ROWS) > AT, size * SD_N_M, 0.0)


def found(load: Vector, noise: LoadNoise, seed: int) -> list[SmallJump]:
    noisy = load + drawn_noise(np.random.default_rng(seed), load.size, PERIOD_S, noise)
    return small_jumps([noisy], noise_filter(noise, PERIOD_S), PERIOD_S)


@pytest.mark.parametrize(("noise", "size"), [(WHITE, 1.4), (WHITE, 4.0), (COLOURED, 3.0)])
def test_small_jumps_are_found_and_their_instants_are_as_open_as_told(noise: LoadNoise, size: float) -> None:
    each = [found(jump(size), noise, seed) for seed in SEEDS]
    once = [jumps[0] for jumps in each if len(jumps) == 1]
    assert len(once) >= 0.9 * len(SEEDS)
    away = np.array([one.row - AT for one in once])
    told = np.sqrt(np.mean([one.deviation_rows**2 for one in once]))
    assert np.sqrt(np.mean(away**2) + 1.0 / 12.0) == pytest.approx(told, rel=0.5)


@pytest.mark.parametrize("noise", [WHITE, COLOURED], ids=["white", "coloured"])
@pytest.mark.parametrize(
    "load",
    [
        np.zeros(ROWS),
        np.interp(np.arange(ROWS), [400, 700], [0.0, 100.0 * SD_N_M]),
        np.interp(np.arange(ROWS), [450, 600], [0.0, 6.0 * SD_N_M]),
        np.interp(np.arange(ROWS), [490, 510], [0.0, 8.0 * SD_N_M]),
        np.interp(np.arange(ROWS), [500, ROWS], [0.0, 200.0 * SD_N_M]),
        10.0 * SD_N_M * np.sin(2.0 * np.pi * 2.0 * PERIOD_S * np.arange(ROWS)),
        100.0 * SD_N_M * np.sin(2.0 * np.pi * 0.5 * PERIOD_S * np.arange(ROWS)),
    ],
    ids=["hold", "ramp", "low ramp", "short ramp", "corner", "smooth", "slow"],
)
def test_what_holds_ramps_or_bends_has_none(load: Vector, noise: LoadNoise) -> None:
    assert sum(len(found(load, noise, seed)) for seed in SEEDS) <= 0.1 * len(SEEDS)


def test_a_weak_wave_has_none() -> None:
    phases = np.linspace(0.0, 2.0 * np.pi, 12)
    waves = [3.0 * SD_N_M * np.sin(2.0 * np.pi * 6.0 * PERIOD_S * np.arange(ROWS) + phase) for phase in phases]
    assert sum(len(found(wave, WHITE, seed)) for seed, wave in enumerate(waves)) <= 1


def test_a_short_or_coarse_piece_has_none() -> None:
    assert found(jump(5.0)[: AT + 100], WHITE, 0) == []
    coarse = small_jumps([jump(5.0)], noise_filter(WHITE, 0.05), 0.05)
    assert coarse == []


def both(size: float, seed: int) -> tuple[Vector, Vector, Vector]:
    """A load with a large and a small jump, its course and the course's error."""
    load = np.concatenate((np.full(800, 200.0 * SD_N_M), jump(size)))
    noisy = load + drawn_noise(np.random.default_rng(seed), load.size, PERIOD_S, WHITE)
    course = load_course(noisy, np.array([799], dtype=np.intp), PERIOD_S, WHITE)
    assert course.error is not None
    return load, course.load, course.error.astype(np.float64)


def test_a_load_s_course_jumps_by_little_too() -> None:
    for seed in SEEDS:
        load, course, _ = both(1.4, seed)
        left = (course - load)[800 + AT + 40 : 800 + AT + 140]
        assert np.abs(left).max() < 0.5 * SD_N_M  # a ramp of 140 ms would be off by 0.7 at the jump


def test_its_error_holds_the_instant() -> None:
    near = slice(800 + AT - 3, 800 + AT + 5)
    left, told = [], []
    for seed in range(100):
        load, course, error = both(3.0, seed)
        left.append(float((course - load)[near].sum()))
        told.append(float(np.sum(error[near].sum(axis=0) ** 2)))
    # The small jump is put in the middle between two rows, and the load has it in the first of them.
    assert np.sqrt(np.mean(np.square(left))) == pytest.approx(np.sqrt(np.mean(told)), rel=0.4)


def test_a_load_without_a_large_jump_is_taken_to_have_no_small_one() -> None:
    noisy = jump(2.0) + drawn_noise(np.random.default_rng(1), ROWS, PERIOD_S, WHITE)
    course = load_course(noisy, np.empty(0, dtype=np.intp), PERIOD_S, WHITE)
    assert np.abs(np.diff(course.load)).max() < 0.5 * SD_N_M
