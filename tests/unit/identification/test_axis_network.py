"""The network of an axis: its slopes, its fit, and that test runs have no say in it."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.data.run import Run
from hil_forceps.identification.axis.network import HIDDEN, STRETCH_ROWS, first_weights, loss, play
from hil_forceps.identification.axis.network_fit import NetworkFit, fit_networks
from hil_forceps.rig.errors import UserError
from tests.unit.identification.test_axis import STEP_s, axis, made

pytestmark = pytest.mark.xdist_group("axis network")  # what they look at is made once, for all

Vector = NDArray[np.float64]
STEP = 5e-3


def test_its_slopes_are_those_of_differences() -> None:
    rng = np.random.default_rng(1)
    unknowns = 100.0 * first_weights(rng)
    rows = 3 * STRETCH_ROWS
    force, measured, states = rng.standard_normal(rows), rng.standard_normal(rows), rng.standard_normal((rows, 2))
    starts, sizes = np.arange(0, 2 * STRETCH_ROWS, 7, dtype=np.int64), np.array([1.0, 2.0])

    def at(unknowns: Vector, states: Vector) -> float:
        return loss(starts, force, measured, states, STEP, sizes, unknowns)[0]

    _, slope, states_slope = loss(starts, force, measured, states, STEP, sizes, unknowns)
    step = 1e-7
    for k in (0, HIDDEN + 3, 2 * HIDDEN + 5, 3 * HIDDEN + 7, 4 * HIDDEN + 9, 5 * HIDDEN):
        away = np.zeros_like(unknowns)
        away[k] = step
        difference = (at(unknowns + away, states) - at(unknowns - away, states)) / (2.0 * step)
        assert slope[k] == pytest.approx(difference, rel=2e-3)  # a rectifier bends in between
    for place in ((7, 0), (7, 1), (70, 0), (70, 1)):
        away = np.zeros_like(states)
        away[place] = step
        difference = (at(unknowns, states + away) - at(unknowns, states - away)) / (2.0 * step)
        assert states_slope[place] == pytest.approx(difference, rel=1e-4)


def test_a_network_without_weights_goes_on_as_its_offset_says() -> None:
    unknowns = np.zeros(5 * HIDDEN + 1)
    unknowns[-1] = 2.0 * STEP  # an acceleration of 2
    time = STEP * np.arange(50)
    positions = play(unknowns, np.zeros(50), np.array([0.1, 0.3]), STEP)
    np.testing.assert_allclose(positions, 0.1 + 0.3 * time + time**2, rtol=1e-12)


@pytest.fixture(scope="module")
def fitted() -> tuple[NetworkFit, ...]:
    return fit_networks(axis(made()), [axis(made("more", friction=1.2))], seeds=2, steps=1000)


def test_a_fit_goes_on_from_where_nothing_is_known(fitted: tuple[NetworkFit, ...]) -> None:
    for network in fitted:
        assert [told.steps for told in network.told] == [500, 1000]
        assert min(told.train_rmse_m for told in network.told) < 0.03  # the path is 0.2 m long
    assert fitted[0].told != fitted[1].told


def test_the_same_seed_gives_the_same_and_a_test_run_has_no_say(fitted: tuple[NetworkFit, ...]) -> None:
    (again,) = fit_networks(axis(made()), [], seeds=1, steps=500)
    assert [told.train_rmse_m for told in again.told] == [told.train_rmse_m for told in fitted[0].told[:1]]


def test_what_runs_away_is_infinite_and_what_is_short_refused() -> None:
    run = made(duration_s=4.0)
    columns = run.columns | {"tau_m_N_m": 1e200 * run.columns["tau_m_N_m"]}
    (network,) = fit_networks(axis(run), [axis(Run("wild", columns))], seeds=1, steps=1)
    assert math.isinf(network.told[-1].test_rmse_m[0])
    rows = round(0.7 / STEP_s)
    with pytest.raises(UserError, match="too short"):
        fit_networks(axis(Run("short", {name: values[:rows] for name, values in run.columns.items()})), [])
