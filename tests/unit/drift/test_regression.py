"""The regression over sessions against the same by dense matrices."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from hil_forceps.drift.change_test import design
from hil_forceps.drift.outliers import auxiliary_residuals
from hil_forceps.drift.regression import beside, likelihoods
from hil_forceps.drift.scatter import Scatter, drawn, scatters, whitened

Vector = NDArray[np.float64]
SCATTERS = [Scatter(0.0, 0.0), Scatter(0.0, 0.5), Scatter(0.8, 0.5), Scatter(1.0, 0.3)]


def covariance_of(deviations: Vector, scatter: Scatter) -> Vector:
    """Return the covariance of estimates without drift (n × n), by its formula."""
    place = np.arange(deviations.size)
    if scatter.correlation < 1.0:
        apart = np.abs(place[:, np.newaxis] - place)
        shared = scatter.deviation**2 / (1.0 - scatter.correlation**2) * scatter.correlation**apart
    else:
        shared = scatter.deviation**2 * np.minimum(place[:, np.newaxis], place)
    return np.asarray(shared + np.diag(deviations**2))


@pytest.mark.parametrize("scatter", SCATTERS, ids=str)
def test_whitened_columns_have_the_products_of_the_inverse_covariance(scatter: Scatter) -> None:
    rng = np.random.default_rng(1)
    deviations, columns = rng.uniform(0.5, 2.0, 9), rng.standard_normal((9, 3))
    covariance = covariance_of(deviations, scatter)
    white, half = whitened(columns, deviations, scatter)
    np.testing.assert_allclose(white.T @ white, columns.T @ np.linalg.solve(covariance, columns), rtol=1e-10)
    assert half == pytest.approx(0.5 * np.linalg.slogdet(covariance)[1])


@pytest.mark.parametrize("scatter", SCATTERS, ids=str)
def test_drawn_series_have_the_covariance(scatter: Scatter) -> None:
    deviations = np.array([0.5, 1.0, 2.0, 0.7])
    series = drawn(np.random.default_rng(2), deviations, scatter, 200_000)
    np.testing.assert_allclose(np.cov(series), covariance_of(deviations, scatter), atol=0.04)


@pytest.mark.parametrize("scatter", SCATTERS, ids=str)
def test_the_gain_of_a_further_column_is_that_of_the_whole_likelihood(scatter: Scatter) -> None:
    rng = np.random.default_rng(3)
    deviations, series = rng.uniform(0.5, 2.0, 12), rng.standard_normal(12)
    columns, further = design([], 12), rng.standard_normal((12, 4))
    told = likelihoods(series[:, np.newaxis], deviations, beside(columns, further, deviations, [scatter]))
    covariance = covariance_of(deviations, scatter)

    def likelihood(x: NDArray[np.float64]) -> float:
        inverse = np.linalg.inv(covariance)
        mean = x @ np.linalg.solve(x.T @ inverse @ x, x.T @ inverse @ series)
        return float(stats.multivariate_normal(mean, covariance).logpdf(series) + 6.0 * np.log(2.0 * np.pi))

    alone = likelihood(columns)
    assert told.model[0, 0] == pytest.approx(alone)
    each = [likelihood(np.column_stack((columns, further[:, [place]]))) - alone for place in range(4)]
    assert told.gains[0, 0] == pytest.approx(max(each))
    assert told.best[0, 0] == np.argmax(each)


def test_an_auxiliary_residual_is_what_the_others_do_not_foretell() -> None:
    rng = np.random.default_rng(4)
    deviations, series = rng.uniform(0.5, 2.0, 8), rng.standard_normal(8)
    scatter, columns = Scatter(0.6, 1.0), design([], 8)
    covariance = covariance_of(deviations, scatter)
    others = np.arange(8) != 3
    inverse = np.linalg.inv(covariance[np.ix_(others, others)])
    level = np.linalg.solve(columns[others].T @ inverse @ columns[others], columns[others].T @ inverse @ series[others])
    share = covariance[3, others] @ inverse
    foretold = columns[3] @ level + share @ (series[others] - columns[others] @ level)
    left = columns[3] - share @ columns[others]
    variance = covariance[3, 3] - share @ covariance[others, 3]
    variance += left @ np.linalg.solve(columns[others].T @ inverse @ columns[others], left)
    found = auxiliary_residuals(series, columns, deviations, scatter)[3]
    assert found == pytest.approx((series[3] - foretold) / np.sqrt(variance))


def test_the_scatters_are_dense_enough() -> None:
    """Between two of them the likelihood of a scatter between is less than 2 below its best."""
    rng = np.random.default_rng(5)
    deviations = np.full(100, 1.0)
    truth = Scatter(0.45, 3.3)
    series = drawn(rng, deviations, truth, 20)
    columns, nothing = design([], 100), np.empty((100, 0))
    models = beside(columns, nothing, deviations, scatters(deviations))
    at_grid = likelihoods(series, deviations, models).model.max(axis=0)
    at_truth = likelihoods(series, deviations, beside(columns, nothing, deviations, [truth])).model[0]
    assert np.all(at_truth - at_grid < 2.0)
