"""Scores of places: what they gain, which sign they may have, and how often chance exceeds the threshold."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.score import COST_PER_COLUMN, Group, Scores, gains_alone, project, score

ROWS, FITTED, CANDIDATES = 600, 3, 12
Matrix = NDArray[np.float32]


def columns(seed: int, count: int) -> Matrix:
    return np.random.default_rng(seed).standard_normal((ROWS, count)).astype(np.float32)


def scored(residual: NDArray[np.float64], groups: list[Group], chance: float = 0.05, seed: int = 0) -> Scores:
    return score(
        columns(1, FITTED),
        np.zeros(FITTED),
        np.zeros(FITTED),
        columns(2, CANDIDATES),
        groups,
        residual.astype(np.float32),
        chance,
        seed,
    )


def singles(one_sided: bool) -> list[Group]:
    return [Group(k, k + 1, one_sided) for k in range(CANDIDATES)]


def test_a_hidden_column_gains_what_it_put_in_and_gets_its_amplitude() -> None:
    column = columns(2, CANDIDATES)[:, 4].astype(float)
    found = scored(0.7 * column, singles(False))
    fitted = columns(1, FITTED).astype(float)
    alone = column - fitted @ np.linalg.lstsq(fitted, column, rcond=None)[0]
    assert int(np.argmax(found.gains)) == 4
    assert found.gains[4] == pytest.approx(0.49 * float(alone @ alone), rel=1e-3)
    assert found.amplitudes[4][0] == pytest.approx(0.7, rel=1e-3)


def test_gains_alone_are_those_of_a_score() -> None:
    groups = [Group(2 * k, 2 * k + 2, k % 2 == 1) for k in range(CANDIDATES // 2)]
    weights, u = np.array([0.0, 5.0, 500.0]), np.array([0.1, -0.2, 0.3])
    residual = columns(4, 1)[:, 0] + 0.2 * columns(2, CANDIDATES)[:, 5]
    told = score(columns(1, FITTED), weights, u, columns(2, CANDIDATES), groups, residual, 0.05, 0)
    alone = gains_alone(columns(1, FITTED), weights, u, columns(2, CANDIDATES), groups, residual)
    assert np.ptp(alone) > 10.0
    assert alone == pytest.approx(told.gains, rel=1e-9, abs=1e-9)


def test_what_the_known_parameters_explain_gains_nothing() -> None:
    found = scored(5.0 * columns(1, FITTED)[:, 0].astype(float), singles(False))
    assert found.gains == pytest.approx(np.zeros(CANDIDATES), abs=1e-2)


def test_a_place_that_is_a_known_parameter_in_disguise_holds_nothing() -> None:
    fitted = columns(1, FITTED)
    disguised = np.column_stack((fitted @ np.ones((FITTED, 1), dtype=np.float32), columns(2, 1)))
    groups = [Group(0, 1, False), Group(1, 2, False)]
    nothing = np.zeros(FITTED)
    found = score(fitted, nothing, nothing, disguised, groups, columns(3, 1)[:, 0], 0.05, 0)
    assert found.informative.tolist() == [False, True]
    assert found.gains[0] == 0.0


def test_what_only_a_prior_holds_against_a_nuisance_counts() -> None:
    """A stretched wire moves the jaw as the sensor's zeros do: what is known of these, run by run, tells of it."""
    runs, rows = 4, ROWS // 4
    zeros = np.kron(np.eye(runs), np.ones((rows, 1))).astype(np.float32)  # of each run, at the size of its prior ...
    zeros *= np.float32(np.sqrt(3e6 / rows))  # ... which rows of a real run know 3e6 times better
    stretch = zeros.sum(axis=1, keepdims=True)
    weights, u = np.ones(runs), np.full(runs, 4.0)  # the fit has put every zero four deviations off
    residual = columns(3, 1)[:, 0]
    found = score(zeros, weights, u, stretch, [Group(0, 1, False)], residual, 0.05, 0)
    assert found.informative.tolist() == [True]
    assert found.gains[0] == pytest.approx(runs * 4.0**2, rel=0.05)


def test_a_one_sided_place_gains_nothing_from_the_other_side() -> None:
    column = columns(2, CANDIDATES)[:, 4].astype(float)
    assert scored(-0.7 * column, singles(True)).gains[4] == 0.0
    assert scored(-0.7 * column, singles(False)).gains[4] > 100.0
    assert scored(0.7 * column, singles(True)).gains[4] > 100.0


def test_more_columns_cost() -> None:
    column = columns(2, CANDIDATES)[:, 0].astype(float)
    one = scored(column, [Group(0, 1, False)]).gains[0]
    two = scored(column, [Group(0, 2, False)]).gains[0]
    assert two == pytest.approx(one - COST_PER_COLUMN, abs=0.01)


def test_a_prior_lets_a_known_parameter_explain_less() -> None:
    fitted, candidates = columns(1, FITTED), columns(1, FITTED)[:, :1]
    free, _ = project(fitted, np.zeros(FITTED), np.zeros(FITTED), candidates, columns(3, 1)[:, 0])
    held, _ = project(fitted, np.full(FITTED, 1e6), np.zeros(FITTED), candidates, columns(3, 1)[:, 0])
    assert free[0, 0] < 1e-2 * held[0, 0]


@pytest.mark.parametrize("one_sided", [False, True])
def test_chance_exceeds_the_threshold_as_often_as_it_may(one_sided: bool) -> None:
    """Family-wise: noise alone, whole data sets anew, highest of all places."""
    groups = [*singles(one_sided)[:8], Group(8, 10, False), Group(10, 12, False)]
    chance, count = 0.1, 400
    rng = np.random.default_rng(8)
    above = sum(
        found.gains.max() > found.threshold
        for found in (scored(rng.standard_normal(ROWS), groups, chance, seed) for seed in range(count))
    )
    # 40 of 400 wanted; 4 deviations of a binomial either side.
    assert 16 <= above <= 64


def test_a_smaller_chance_asks_for_more_and_the_seed_decides_the_draws() -> None:
    noise = np.random.default_rng(9).standard_normal(ROWS)
    thresholds = [scored(noise, singles(False), chance).threshold for chance in (0.5, 0.1, 0.01, 0.001)]
    assert thresholds == sorted(thresholds)
    assert thresholds[-1] - thresholds[-2] == pytest.approx(2.0 * np.log(5.0) + 0.0, abs=3.0)
    assert scored(noise, singles(False)).threshold == scored(noise, singles(False)).threshold
