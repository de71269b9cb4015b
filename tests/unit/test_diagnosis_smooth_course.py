"""Courses of smooth loads: known better than a spline by least squares knows them, and as well as they say."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis import smooth_course as module
from hil_forceps.diagnosis.smooth_course import _differences, _log_determinant, knot_count, smooth_course
from hil_forceps.diagnosis.smoothing import LoadNoise, drawn_noise, local_cutoff, noise_filter

Vector = NDArray[np.float64]

ROWS, PERIOD_S, SD_N_M = 6000, 1e-3, 1e-5
TIME_S: Vector = PERIOD_S * np.arange(ROWS, dtype=np.float64)
WHITE = LoadNoise(np.array([0.0, 500.0]), np.full(2, SD_N_M**2))
SLOW_N_M: Vector = 1e-3 * np.sin(2.0 * math.pi * 0.7 * TIME_S) + 5e-4 * np.sin(2.0 * math.pi * 1.9 * TIME_S)
CORNERS_N_M: Vector = 1e-3 * np.abs(TIME_S % 1.5 - 0.75)


def course_of(load: Vector, seed: int, noise: LoadNoise = WHITE) -> tuple[Vector, module.SmoothCourse]:
    noisy = load + drawn_noise(np.random.default_rng(seed), load.size, PERIOD_S, noise)
    white = noise_filter(noise, PERIOD_S)
    return noisy, smooth_course(noisy, local_cutoff(noisy, white), white)


def by_band(signals: Vector) -> Vector:
    """Power of all columns from 0 to 3 Hz, 5 to 10 and 15 to 30."""
    power = np.sum(np.abs(np.fft.rfft(np.hanning(ROWS)[:, None] * signals, axis=0)) ** 2, axis=1)
    frequency = np.fft.rfftfreq(ROWS, PERIOD_S)
    bands = ((0.0, 3.0), (5.0, 10.0), (15.0, 30.0))
    return np.array([power[(frequency >= low) & (frequency < high)].mean() for low, high in bands])


def test_noise_where_a_smooth_load_has_nothing_is_known_to_be_noise() -> None:
    _, course = course_of(SLOW_N_M, 1)
    noise = by_band(SD_N_M * np.random.default_rng(2).standard_normal((ROWS, 1)))
    told = by_band(course.error)
    assert told[0] == pytest.approx(noise[0], rel=0.6)  # where the load is, it is known as well as it was measured
    assert told[1] < 0.2 * noise[1]
    assert told[2] < 1e-6 * noise[2]


@pytest.mark.parametrize("load", [SLOW_N_M, CORNERS_N_M], ids=["smooth", "corners"])
def test_the_error_is_as_large_as_it_says(load: Vector) -> None:
    runs = [course_of(load, seed)[1] for seed in range(6)]
    errors = np.stack([course.load - load for course in runs], axis=1)
    share = by_band(errors) / 6.0 / np.mean([by_band(course.error) for course in runs], axis=0)
    assert share[0] == pytest.approx(1.0, abs=0.3)
    assert 0.3 < share[1] < 1.3  # a load of two sines has less there than anything smooth has by its course


def test_a_load_with_corners_is_not_taken_to_be_smooth(monkeypatch: pytest.MonkeyPatch) -> None:
    noisy, course = course_of(CORNERS_N_M, 3)
    assert course.chi2 + course.freedom == pytest.approx(ROWS, rel=0.05)
    monkeypatch.setattr(module, "ORDERS", (6,))
    monkeypatch.setattr(module, "FOLLOWS", (0.0,))
    white = noise_filter(WHITE, PERIOD_S)
    forced = smooth_course(noisy, local_cutoff(noisy, white), white)
    assert np.std(forced.load - CORNERS_N_M) > 1.3 * np.std(course.load - CORNERS_N_M)


def test_the_unit_of_a_load_changes_nothing() -> None:
    noisy, course = course_of(CORNERS_N_M, 4)
    noise = LoadNoise(WHITE.frequency_Hz, 1e6 * WHITE.power)
    white = noise_filter(noise, PERIOD_S)
    larger = smooth_course(1e3 * noisy, local_cutoff(1e3 * noisy, white), white)
    assert larger.load == pytest.approx(1e3 * course.load, rel=1e-6, abs=1e-9)
    assert larger.freedom == pytest.approx(course.freedom, rel=1e-6)


@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_determinant_of_differences(order: int) -> None:
    differences = _differences(12, order).toarray()
    assert differences @ np.arange(12.0) ** (order - 1) == pytest.approx(np.zeros(12 - order), abs=1e-9)
    assert _log_determinant(12, order) == pytest.approx(np.linalg.slogdet(differences @ differences.T)[1], rel=1e-9)


@pytest.mark.parametrize("rows", [1, 5, 6, 9, 40])
def test_short_pieces_have_a_course_and_an_error(rows: int) -> None:
    noisy = SD_N_M * np.random.default_rng(5).standard_normal(rows)
    course = smooth_course(noisy, np.full(rows, 1.0 / rows), noise_filter(WHITE, PERIOD_S))
    assert course.load.shape == (rows,)
    assert course.error.shape[0] == rows
    assert np.all(np.sum(course.error**2, axis=1) < 1.01 * SD_N_M**2)
    assert 0.0 < course.freedom <= rows


def test_the_count_of_knots_is_no_less_than_a_course_has() -> None:
    noisy, course = course_of(CORNERS_N_M, 6)
    assert course.error.shape[1] <= knot_count(local_cutoff(noisy, noise_filter(WHITE, PERIOD_S))) + module.DEGREE + 2
