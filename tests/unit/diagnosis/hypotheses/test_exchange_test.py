"""Exchanges as predicted are what least squares say with the amplitudes that leave held at zero."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.diagnosis.evidence import Gram, Passes
from hil_forceps.diagnosis.hypotheses.exchange_test import Exchange, exchanges
from hil_forceps.diagnosis.hypotheses.places import Place
from hil_forceps.diagnosis.inference.fit import Fit
from hil_forceps.diagnosis.inference.parameters import effect_parameters, values_of, with_effect
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.model import parameters
from tests.hidden_effects.generator import RIG

ROWS, THRESHOLD = 400, 16.0
AMPLITUDES = {"jaw_gravity": {"sine_N_m": 3e-5, "cosine_N_m": -2e-5}, "wire_damping": {"damping_N_s_per_m": 0.5}}


def model() -> Fit:
    """Return a fit that holds two entries."""
    theta = parameters.vector(RIG)
    for name, values in AMPLITUDES.items():
        theta = with_effect(theta, name, values)
    free = tuple(f for name in AMPLITUDES for f in effect_parameters(name, values_of(theta, name)))
    return Fit(free, Passes(theta, physics_of(theta), ()), np.eye(len(free)))


def place(effect_id: str, at: int, *, one_sided: bool = False) -> Place:
    return Place(effect_id, {}, {"amplitude": 1.0}, at, at + 1, one_sided)


def least_squares(
    columns: NDArray[np.float64], residual: NDArray[np.float64], fixed: NDArray[np.float64], at: Sequence[int]
) -> tuple[float, NDArray[np.float64]]:
    """Return χ² with the columns `at` moved by `fixed` and all others free, and how all move."""
    free = [i for i in range(columns.shape[1]) if i not in at]
    moved = np.zeros(columns.shape[1])
    moved[list(at)] = fixed
    moved[free] = np.linalg.lstsq(columns[:, free], -(residual + columns @ moved), rcond=None)[0]
    return float(np.sum((residual + columns @ moved) ** 2)), moved


@pytest.fixture(name="runs")
def columns_and_residual() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the answers of three amplitudes and four columns, and residuals that they explain nothing of yet."""
    rng = np.random.default_rng(8)
    columns = rng.standard_normal((ROWS, 7))
    columns[:, 4] = columns[:, 0] + 0.1 * columns[:, 4]  # nearly what the weight does
    residual = rng.standard_normal(ROWS)
    residual -= columns[:, :3] @ np.linalg.lstsq(columns[:, :3], residual, rcond=None)[0]
    return columns, residual


def exchanges_among(
    columns: NDArray[np.float64], residual: NDArray[np.float64], places: Sequence[Place]
) -> list[Exchange]:
    found = Gram(columns.T @ columns, columns.T @ residual)
    return exchanges(model(), tuple(AMPLITUDES), places, found, THRESHOLD)


def test_gains_sizes_and_shifts_are_those_of_constrained_least_squares(
    runs: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    columns, residual = runs
    places = [place("cogging", 0), place("wire_creep", 1), place("wire_slack", 2), place("torque_ripple", 3)]
    fitted = model()
    values = fitted.values / np.array([f.scale for f in fitted.free])
    rows = {"jaw_gravity": [0, 1], "wire_damping": [2]}
    before = float(residual @ residual)
    every = exchanges_among(columns, residual, places)
    assert {len(e.leaving) for e in every} == {1, 2}
    assert {len(e.joining) for e in every if len(e.leaving) == 1} == {1, 2}
    for e in every:
        at = [i for name in e.leaving for i in rows[name]]
        joining = [3 + q.first for q in e.joining]
        used = [0, 1, 2, *joining]
        after, moved = least_squares(columns[:, used], residual, -values[at], at)
        more = THRESHOLD * (len(e.joining) - len(e.leaving)) - 2.0 * (len(at) - len(e.leaving))
        assert e.gain == pytest.approx(before - after - more, rel=1e-6)
        assert e.shifts == pytest.approx(moved[:3], abs=1e-9)
        assert [float(v[0]) for v in e.sizes] == pytest.approx(moved[3:].tolist(), abs=1e-9)
        assert e.explained == pytest.approx(least_squares(columns[:, :3], residual, -values[at], at)[0] - before)
    assert every == sorted(every, key=lambda e: -e.gain)


def test_a_size_with_the_wrong_sign_takes_no_place(runs: tuple[NDArray[np.float64], NDArray[np.float64]]) -> None:
    columns, residual = runs
    sign = next(np.sign(e.sizes[0][0]) for e in exchanges_among(columns, residual, [place("wire_creep", 1)]))
    columns[:, 4] *= sign
    assert exchanges_among(columns, residual, [place("wire_creep", 1, one_sided=True)])
    columns[:, 4] *= -1.0
    found = exchanges_among(columns, residual, [place("wire_creep", 1, one_sided=True)])
    assert ("jaw_gravity",) not in {e.leaving for e in found}


def test_an_exact_alias_takes_the_place_of_what_it_is_an_alias_of(
    runs: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    """Beside the entry that is to leave, nothing of its column is left."""
    columns, residual = runs
    columns[:, 5] = 0.5 * columns[:, 2]
    (found,) = [e for e in exchanges_among(columns, residual, [place("wire_slack", 2)]) if len(e.leaving) == 1]
    fitted = model()
    assert found.leaving == ("wire_damping",)
    assert found.gain == pytest.approx(0.0, abs=1e-6)
    assert float(found.sizes[0][0]) == pytest.approx(2.0 * fitted.values[2] / fitted.free[2].scale)
