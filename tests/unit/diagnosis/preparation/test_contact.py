import numpy as np
import pytest

from hil_forceps.diagnosis.inference.fit import fit
from hil_forceps.diagnosis.preparation.contact import contact
from hil_forceps.model import parameters
from tests.hidden_effects.generator import RIG
from tests.unit.diagnosis.simulated_runs import POOL, known_of, records_of, runs_of

ANGLE_SD, LOAD_SD = 2e-4, 1e-5


def passing(seed: int = 0, rows: int = 8000) -> tuple[np.ndarray, np.random.Generator]:
    return 0.4 * np.sin(2.0 * np.pi * 0.6 * np.arange(rows) * 1e-3), np.random.default_rng(seed)


@pytest.mark.parametrize("upward", [True, False])
def test_a_spring_that_the_jaw_touches_is_found(upward: bool) -> None:
    angle, rng = passing()
    way = np.maximum(angle - 0.13, 0.0) if upward else np.minimum(angle - 0.13, 0.0)
    load = 6e-3 * way + LOAD_SD * rng.standard_normal(angle.size)
    found = contact(load, angle + ANGLE_SD * rng.standard_normal(angle.size), LOAD_SD**2, ANGLE_SD**2)
    assert found is not None
    assert found.upward is upward
    assert found.stiffness_N_m_per_rad == pytest.approx(6e-3, rel=2e-3)
    assert found.angle_rad == pytest.approx(0.13, abs=1e-3)


@pytest.mark.parametrize("kind", ["multisine", "trapezoid", "chirp", "slow", "spin", "teleoperation"])
def test_a_load_from_outside_is_no_contact(kind: str) -> None:
    for run in runs_of(RIG, (kind,) * 3, 8500):
        columns = run.columns
        assert contact(columns["tau_w_N_m"], columns["theta_j_rad"], LOAD_SD**2, ANGLE_SD**2) is None


def test_a_jaw_that_closes_once_shows_no_contact() -> None:
    angle, rng = np.linspace(-0.3, 0.4, 6000), np.random.default_rng(1)
    load = 6e-3 * np.maximum(angle, 0.0) + LOAD_SD * rng.standard_normal(angle.size)
    assert contact(load, angle, LOAD_SD**2, ANGLE_SD**2) is None


def test_what_the_jaw_touches_is_not_taken_for_another_inertia() -> None:
    """A spring stiffens the jaw: taken for a load from outside, it made its inertia 12 deviations too light."""
    runs = runs_of(RIG, ("grasp",) * 4, 5000)
    found = fit(records_of(runs, RIG), parameters.vector(RIG), known_of(RIG), POOL.map)
    place = next(i for i, f in enumerate(found.free) if "jaw_inertia" in f.name)
    assert found.values[place] == pytest.approx(6.85e-8, rel=0.02)
    assert abs(found.values[place] - 6.85e-8) < 4.0 * found.deviations[place]
