"""Estimates by the likelihood alone: the rig's share of a fit is taken out again."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.inference.fit import Fit
from hil_forceps.diagnosis.inference.parameters import Free
from hil_forceps.drift.likelihood import by_likelihood
from hil_forceps.model import parameters
from tests.trend.simulated_sessions import ASSUMED, FRICTION, STIFFNESS

CENTRES, SCALES = np.array([1e-4, 2.6e4]), np.array([3e-4, 2.6e3])
NAMES = (FRICTION, STIFFNESS)


def fit_of(information: NDArray[np.float64], mean: NDArray[np.float64], low: float = 0.0) -> Fit:
    """Return the fit of a Gaussian likelihood, in units of the scales, beside a prior of 1."""
    posterior: NDArray[np.float64] = np.linalg.inv(information + np.eye(2)).astype(np.float64)
    values = CENTRES + SCALES * (posterior @ (information @ mean))
    theta = parameters.vector(ASSUMED)
    free = []
    for name, centre, scale, value in zip(NAMES, CENTRES, SCALES, values, strict=True):
        free.append(Free(name, float(centre), float(scale), low, np.inf, True, False))
        theta[parameters.index(name)] = max(float(value), low)
    return Fit(tuple(free), cast(Any, SimpleNamespace(theta=theta)), posterior)


def test_the_rig_has_no_share_in_an_estimate() -> None:
    information = np.array([[4.0, 1.5], [1.5, 30.0]])
    mean = np.array([0.8, -0.5])
    found = by_likelihood(fit_of(information, mean))
    np.testing.assert_allclose([p.value for p in found], CENTRES + SCALES * mean, rtol=1e-9)
    np.testing.assert_allclose([p.sd for p in found], SCALES * np.sqrt(np.diag(np.linalg.inv(information))), rtol=1e-9)
    assert [p.assumed for p in found] == pytest.approx(list(CENTRES))


def test_what_says_less_than_the_rig_is_not_measured() -> None:
    friction, stiffness = by_likelihood(fit_of(np.diag([0.9, 30.0]), np.array([0.2, 0.1])))
    assert np.isnan(friction.value)
    assert friction.reason == "this session says less of it than the rig"
    assert stiffness.reason == ""


def test_what_ended_at_a_bound_is_not_measured() -> None:
    friction, _ = by_likelihood(fit_of(np.diag([100.0, 30.0]), np.array([-0.9, 0.1])))
    assert friction.reason == "the fit ended at its bound 0"
