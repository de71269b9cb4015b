"""Gauss-Newton on a regression whose answer is known, and where a fit that can't be of use ends."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.evidence import Direction, Passes, Values, pass_all
from hil_forceps.diagnosis.inference.fit import Fit, RequiredGain, chi2_above, fit, fit_from
from hil_forceps.diagnosis.inference.parameters import Free
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.model import parameters
from hil_forceps.model.composition import Physics
from tests.hidden_effects.generator import RIG

Vector = NDArray[np.float64]

THETA = parameters.vector(RIG)
PLACE = parameters.index("forceps.motor_viscous_N_m_s_per_rad")
SCALE = 0.1 * float(THETA[PLACE])
FREE = (Free("forceps.motor_viscous_N_m_s_per_rad", 0.0, SCALE, 0.0, np.inf, False, False),)
TIMES = np.linspace(0.0, 3.0, 60)


class Decay:
    """Measurements y of exp(−x t), x the viscosity over its value in the rig; deviation 0.01."""

    name = "decay"
    load_measured = True
    block_rows = 1

    def __init__(self, y: Vector, passes: list[float], theta: Vector | None = None) -> None:
        """`passes`: takes down each x whose derivatives were asked for."""
        self.y, self.asked = y, passes
        self.x = 1.0 if theta is None else float(theta[PLACE] / THETA[PLACE])
        self.counts = np.ones((y.size, 1), dtype=np.bool_)
        self.influence = np.ones((y.size, 1))
        self.residual = ((y - np.exp(-self.x * TIMES)) / 0.01)[:, np.newaxis]
        self.log_likelihood = -0.5 * self.residual**2

    def passed(self, theta: Vector, plant: Physics) -> "Decay":
        """Return it beside a model."""
        del plant
        return Decay(self.y, self.asked, theta)

    def with_rows_of(self, plant: Physics) -> "Decay":
        """Return it: no channel of it is moved."""
        del plant
        return self

    def as_recorded(self, values: Values) -> Values:
        """Return values as they are."""
        return values

    def answers(self, base: Physics, directions: Sequence[Direction], waves: Sequence[Any] = ()) -> NDArray[np.float32]:
        """Return how residuals answer."""
        del base, waves
        self.asked.append(self.x)
        there = [self.passed(d.theta, physics_of(d.theta)) for d in directions]
        columns = [d.per * (other.residual - self.residual) for d, other in zip(directions, there, strict=True)]
        return np.hstack(columns).astype(np.float32)

    def curves(self, base: Physics, columns: Sequence[tuple[str, Vector]]) -> NDArray[np.float32]:
        """Not asked for."""
        raise NotImplementedError

    def course(self, base: Physics, *, before: bool) -> Course:
        """Not asked for."""
        raise NotImplementedError


def decay(x: float) -> tuple[Decay, list[float]]:
    asked: list[float] = []
    return Decay(np.exp(-x * TIMES), asked), asked


def at(x: float) -> Vector:
    theta = THETA.copy()
    theta[PLACE] *= x
    return theta


def value(found: Fit) -> float:
    return float(found.values[0] / THETA[PLACE])


def test_a_fit_finds_what_made_the_data() -> None:
    run, asked = decay(1.7)
    found = fit([run], at(0.6), FREE, map)
    assert value(found) == pytest.approx(1.7, rel=1e-4)
    assert len(asked) >= 4  # it isn't linear that far
    sensitivity = TIMES * np.exp(-1.7 * TIMES) / 0.01 * 0.1
    assert found.deviations[0] / SCALE == pytest.approx(1.0 / np.linalg.norm(sensitivity), rel=1e-3)


def start(run: Decay, x: float) -> Passes:
    return pass_all([run], at(x), map)


def test_a_fit_that_can_t_reach_the_bar_ends_early() -> None:
    run, asked = decay(1.7)
    base = Fit(FREE, start(run, 1.7), np.eye(1))
    run_off, asked_off = decay(1.7)
    run_off.y += 0.05 * np.sin(40.0 * TIMES)  # which no viscosity explains
    free_fit = fit_from([run_off], start(run_off, 0.6), FREE, map)
    unreached = chi2_above(base, free_fit.passes, FREE)
    assert unreached < -100.0
    before = len(asked_off)
    ended = fit_from([run_off], start(run_off, 0.6), FREE, map, required=RequiredGain(base, 1.0))
    assert 2 <= len(asked_off) - before < before
    assert chi2_above(base, ended.passes, FREE) <= unreached + 1.0
    assert asked == []


@pytest.mark.parametrize("x", [0.3, 0.6, 1.0, 3.0])
def test_a_fit_that_reaches_the_bar_goes_on(x: float) -> None:
    run, _ = decay(1.7)
    base = Fit(FREE, start(run, 1.7), np.eye(1))
    found = fit_from([run], start(run, x), FREE, map, required=RequiredGain(base, -8.9))
    assert value(found) == pytest.approx(value(fit_from([run], start(run, x), FREE, map)), rel=1e-12)


def test_dry_friction_is_never_fitted_as_none() -> None:
    """A plant without any is stepped otherwise: a difference to it isn't the answer to friction."""
    free = Free("forceps.motor_coulomb_N_m", 1e-6, 1e-6, 0.0, np.inf, True, False)
    assert 0.0 < free.least < 1e-4 * free.scale
    theta = THETA.copy()
    theta[free.place] = 0.0
    found = fit([Decay(np.exp(-TIMES), [])], theta, (free, *FREE), map)
    assert found.values[0] >= free.least
    assert FREE[0].least == FREE[0].low
