"""The likelihood of a level with changes over sessions, maximised over all scatters between sessions.

For one scatter the covariance V of the estimates is known. With everything whitened by V, the level and the changes so
far are a regression, and what a further change gains of the log likelihood is half the square of its projection.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from hil_forceps.drift.scatter import Scatter, whitened

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

ALIASED = 1e-8  # of a column's square: what is left of it beside the others is rounding


class Beside(NamedTuple):
    """One scatter, with columns whitened by it."""

    scatter: Scatter
    half_log_determinant: float  # of V
    half_log_information: float  # of XᵀV⁻¹X, for the restricted likelihood
    basis: Matrix  # n × q: orthonormal, of the columns that the model has
    further: Matrix  # n × c: of each further column, what is orthogonal to these, of length 1; 0 where nothing is left


class Likelihoods(NamedTuple):
    """Log likelihoods of m series, each scatters × m."""

    model: Matrix
    restricted: Matrix  # for the choice of the scatter: its maximum is less biased (Patterson and Thompson, 1971)
    gains: Matrix  # by the best further column
    best: NDArray[np.int64]  # which that is


def beside(columns: Matrix, further: Matrix, deviations: Vector, scatters: Sequence[Scatter]) -> list[Beside]:
    """Return columns of a model (n × q) and further ones (n × c), whitened by each scatter."""
    found = []
    for scatter in scatters:
        both, half = whitened(np.hstack((columns, further)), deviations, scatter)
        own, others = both[:, : columns.shape[1]], both[:, columns.shape[1] :]
        basis, upper = linalg.qr(own, mode="economic")
        before = np.sum(others**2, axis=0)
        others -= basis @ (basis.T @ others)
        left = np.sum(others**2, axis=0)
        scale = np.where(left > ALIASED * before, 1.0 / np.sqrt(np.maximum(left, 1e-300)), 0.0)
        half_information = float(np.sum(np.log(np.abs(np.diag(upper)))))
        found.append(Beside(scatter, half, half_information, basis, others * scale))
    return found


def likelihoods(series: Matrix, deviations: Vector, models: Sequence[Beside]) -> Likelihoods:
    """Return the likelihoods of series (n × m) under each model."""
    shape = (len(models), series.shape[1])
    model, restricted, gains, best = np.empty(shape), np.empty(shape), np.zeros(shape), np.zeros(shape, np.int64)
    for place, one in enumerate(models):
        white, _ = whitened(series, deviations, one.scatter)
        misfit = np.sum(white**2, axis=0) - np.sum((one.basis.T @ white) ** 2, axis=0)
        model[place] = -one.half_log_determinant - 0.5 * misfit
        restricted[place] = model[place] - one.half_log_information
        if one.further.shape[1]:
            squares = (one.further.T @ white) ** 2
            best[place] = np.argmax(squares, axis=0)
            gains[place] = 0.5 * np.take_along_axis(squares, best[place][np.newaxis], axis=0)[0]
    return Likelihoods(model, restricted, gains, best)


class Fitted(NamedTuple):
    """A regression at its likeliest scatter."""

    scatter: Scatter
    coefficients: Vector
    covariance: Matrix


def fitted(series: Vector, columns: Matrix, deviations: Vector, scatters: Sequence[Scatter]) -> Fitted:
    """Return the coefficients of columns by generalised least squares, at the scatter of the restricted likelihood."""
    models = beside(columns, np.empty((series.size, 0)), deviations, scatters)
    told = likelihoods(series[:, np.newaxis], deviations, models)
    scatter = scatters[int(np.argmax(told.restricted[:, 0]))]
    white, _ = whitened(np.column_stack((columns, series)), deviations, scatter)
    own = white[:, :-1]
    covariance = linalg.pinvh(own.T @ own)
    return Fitted(scatter, covariance @ (own.T @ white[:, -1]), covariance)
