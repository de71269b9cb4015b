"""Newton steps within bounds."""

import numpy as np
import pytest

from hil_forceps.diagnosis.inference.fit import bounded_step, reach_of
from hil_forceps.diagnosis.inference.parameters import LEAST_FRICTION_SHARE, Free
from hil_forceps.model import parameters


@pytest.mark.parametrize("seed", range(20))
def test_no_other_step_within_the_bounds_is_better(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = 6
    root = rng.standard_normal((size, size)) * 10.0 ** rng.uniform(-4.0, 4.0, size)  # scales apart, as parameters have
    curvature, downhill = root.T @ root, root.T @ rng.standard_normal(size) * 3.0
    unbounded = np.linalg.solve(curvature, downhill)
    low, high = -np.abs(unbounded) * rng.uniform(0.2, 2.0, size), np.abs(unbounded) * rng.uniform(0.2, 2.0, size)
    step = bounded_step(curvature, downhill, low, high)
    assert np.all(step >= low - 1e-9 * np.abs(low))
    assert np.all(step <= high + 1e-9 * np.abs(high))
    below, above = step <= low + 1e-9 * np.abs(low), step >= high - 1e-9 * np.abs(high)
    assert np.any(below | above) or np.allclose(step, unbounded, rtol=1e-4)
    # Where a parameter is not at its bound the slope is none; where it is, the slope points beyond.
    slope = (downhill - curvature @ step) / np.sqrt(np.diag(curvature))
    scale = np.abs(downhill / np.sqrt(np.diag(curvature))).max()
    assert np.all(np.abs(slope[~below & ~above]) < 1e-5 * scale)
    assert np.all(slope[below] < 1e-5 * scale)
    assert np.all(slope[above] > -1e-5 * scale)


def test_a_neighbour_of_a_parameter_at_its_bound_does_not_follow_where_that_may_not_go() -> None:
    """Two frictions that do nearly the same, the smaller one at 0: the other takes what both together should."""
    curvature = np.array([[1.0, 0.9], [0.9, 1.0]])
    downhill = np.array([0.5, 0.0])  # unbounded: 2.6 and −2.4
    step = bounded_step(curvature, downhill, np.array([-10.0, 0.0]), np.array([10.0, 10.0]))
    np.testing.assert_allclose(step, [0.5, 0.0], atol=1e-9)


def test_a_positive_parameter_at_most_doubles_or_halves_and_friction_may_nearly_vanish() -> None:
    names = ("forceps.motor_inertia_kg_m2", "forceps.jaw_coulomb_N_m")
    free = [Free(name, 1.0, 0.1, 0.0, 10.0, True, False) for name in names]
    theta = np.zeros(len(parameters.NAMES))
    theta[[f.place for f in free]] = 1.0
    low, high = reach_of(free, theta)
    np.testing.assert_allclose(low, [-5.0, -10.0 + LEAST_FRICTION_SHARE])
    np.testing.assert_allclose(high, [10.0, 10.0])
