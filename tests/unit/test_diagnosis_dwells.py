"""A motor that dwells within a count: when it goes on is told as an error, and made white with all others."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.dwells import FASTEST_HZ, STANDS_OUT, dwell_errors
from hil_forceps.diagnosis.load_errors import with_dwells
from hil_forceps.diagnosis.low_rank import LoadErrors
from hil_forceps.diagnosis.predict import low_pass
from hil_forceps.diagnosis.spectrum import Layout, make_layout, transform, white_noise, whitening

Vector = NDArray[np.float64]

ROWS, PERIOD_S = 6000, 1e-3
TIME_S: Vector = PERIOD_S * np.arange(ROWS, dtype=np.float64)
SENSORS = {"theta_m_rad": 1e-4, "theta_j_rad": 1e-4}
DEVIATIONS = tuple(SENSORS.values())
COUNT_RAD = 4e-4
ENDS_S = (3.05, 3.1, 3.15, 3.2, 3.3, 3.35)  # of the dwell, in simulations alike but for the load's error


def jaw_off(end_s: float) -> Vector:
    """The jaw of a motor that dwells from 2.8 s on."""
    dwells = np.asarray(np.where((TIME_S > 2.8) & (end_s > TIME_S), -0.7 * COUNT_RAD, 0.0))
    return low_pass(dwells, round(1.0 / (FASTEST_HZ * PERIOD_S)))


def spread_of(jaws: list[Vector]) -> Vector:
    jaw = np.array(jaws)
    spread = np.stack((0.1 * jaw, jaw), axis=1)
    return np.asarray((spread - spread.mean(axis=0)) / np.sqrt(len(jaws) - 1))


def test_when_a_dwell_ends_is_left_open_where_it_is_and_nowhere_else() -> None:
    spread = spread_of([jaw_off(end_s) for end_s in ENDS_S])
    errors = dwell_errors(spread, DEVIATIONS, PERIOD_S, 0.0)
    assert errors.shape[0] == 2
    assert 2 <= errors.shape[1] <= 3 * (len(ENDS_S) - 1)  # it lies in three windows
    away = (TIME_S < 2.4) | (TIME_S > 3.6)
    assert not errors[1][:, (TIME_S < 2.0) | (TIME_S > 4.0)].any()
    told, wanted = np.sum(errors[1] ** 2, axis=0), np.sum(spread[:, 1] ** 2, axis=0)
    assert np.sum(np.abs(told - wanted)) < 0.1 * np.sum(wanted)
    assert np.sum(told[away]) < 0.01 * np.sum(told)


def test_the_motor_s_error_holds_its_integral() -> None:
    spread = spread_of([jaw_off(end_s) for end_s in ENDS_S])
    plain = dwell_errors(spread, DEVIATIONS, PERIOD_S, 0.0)
    added = dwell_errors(spread, DEVIATIONS, PERIOD_S, 20.0)
    after = slice(3400, 3480)  # the dwell is over, its integral stays
    assert np.abs(plain[0][:, after]).max() < 1e-3 * np.abs(plain[0]).max()
    assert np.abs(added[0][:, after]).max() > 0.3 * np.abs(added[0]).max()


def test_simulations_that_differ_less_than_noise_leave_nothing_open() -> None:
    spread = spread_of([jaw_off(end_s) for end_s in ENDS_S])
    errors = dwell_errors(spread, DEVIATIONS, PERIOD_S, 0.0)
    strength = float(np.sum((spread / np.reshape(DEVIATIONS, (2, 1))) ** 2))
    weaker = spread * np.sqrt(0.9 * STANDS_OUT / strength)
    assert errors.shape[1] > 0
    assert dwell_errors(weaker, DEVIATIONS, PERIOD_S, 0.0).shape == (2, 0, ROWS)
    assert dwell_errors(spread, (np.inf, np.inf), PERIOD_S, 0.0).shape == (2, 0, ROWS)


def laid_out() -> Layout:
    layout = make_layout([list(SENSORS)], [np.ones(ROWS)], [PERIOD_S])
    none = np.zeros((layout.size, 1), dtype=np.float32)
    return layout._replace(load=(LoadErrors(np.arange(layout.size), none),))


def test_a_dwell_that_ends_at_another_time_is_noise() -> None:
    errors = dwell_errors(spread_of([jaw_off(end_s) for end_s in ENDS_S]), DEVIATIONS, PERIOD_S, 0.0)
    plain = laid_out()
    aware = with_dwells(plain, [dict(zip(SENSORS, errors, strict=True))])
    noise = white_noise(plain, np.array([SENSORS[name] ** 2 for name in plain.band_channel]))
    mean = np.mean([jaw_off(end_s) for end_s in ENDS_S], axis=0)
    left = jaw_off(3.25) - mean
    flat = transform(plain, [{"theta_m_rad": 0.1 * left, "theta_j_rad": left}])
    without, beside = (float(np.sum(whitening(one, noise).apply(flat) ** 2)) for one in (plain, aware))
    assert without > 200.0
    assert beside < 0.25 * without  # of 6000 rows; what is faster than simulations differ by is left


def test_without_errors_of_the_load_there_are_none_of_dwells() -> None:
    layout = laid_out()._replace(load=())
    errors = dwell_errors(spread_of([jaw_off(end_s) for end_s in ENDS_S]), DEVIATIONS, PERIOD_S, 0.0)
    assert with_dwells(layout, [dict(zip(SENSORS, errors, strict=True))]).dwells == ()


@pytest.mark.parametrize("first", [0, ROWS - 700])
def test_a_dwell_at_an_end_of_the_run_is_told_too(first: int) -> None:
    jaws = [np.roll(jaw_off(end_s), first - 2801) for end_s in ENDS_S]
    assert dwell_errors(spread_of(jaws), DEVIATIONS, PERIOD_S, 0.0).shape[1] > 0
