"""The estimators' FMUs against the estimators of the service, sample by sample."""

import numpy as np
import pytest

from hil_forceps.estimation import batch
from hil_forceps.estimation.registry import make_estimator
from hil_forceps.fmu.estimator_unit import estimator_unit
from hil_forceps.rig import Rig
from hil_forceps.rig.schema import ALGORITHM_IDS, AlgorithmId
from tests.unit.fmu.conftest import Made, Make, Run

pytestmark = pytest.mark.xdist_group("fmu")  # what they look at is made once, for all

ROWS, SAMPLE_S = 300, 1e-3
AGREES = 1e-9
TIME = np.arange(ROWS) * SAMPLE_S
ANGLE = 0.4 * (1.0 - np.cos(2.0 * np.pi * 2.1 * TIME)) + 1e-4 * np.sin(1e3 * TIME)
CURRENT = 0.05 * np.sin(2.0 * np.pi * 3.0 * TIME) + np.where(TIME < 0.15, 0.0, 0.03)
EFFECTS = {
    "wire_hardening": {"beta_per_m2": 1e6},
    "wire_hysteresis": {"force_N": 0.1, "stretch_m": 1e-4},
    "cogging": {"sine_N_m": 1e-4, "cosine_N_m": 5e-5, "harmonic": 6.0},
    "jaw_gravity": {"sine_N_m": 1e-4, "cosine_N_m": 2e-4},
    "encoder_scale": {"relative_error": 0.01},
    "electrical_lag": {"time_constant_s": 1e-3},
}


def apart(made: Made, running: Run, rig: Rig, algorithm: AlgorithmId) -> tuple[float, float]:
    """Return how far torque [N m] and elongation [m] are from the service's: estimates come a step later."""
    unit = running(made)
    rows = unit.run(SAMPLE_S, {"theta_m_rad": ANGLE, "current_A": CURRENT}, ("tau_w_N_m", "elongation_m"))
    estimator = make_estimator(algorithm, rig, SAMPLE_S, over_wire=False)
    time_ns = np.round(TIME * 1e9).astype(np.int64)
    tau_w, elongation = batch.run(estimator, time_ns, ANGLE, rig.plant().torque_constant_N_m_per_A * CURRENT)
    scale = max(1.0, float(np.abs(tau_w[np.isfinite(tau_w)]).max()))  # as published it leaves the range of numbers
    return (
        float(np.abs(rows["tau_w_N_m"][1:] - tau_w).max()) / scale,
        float(np.abs(rows["elongation_m"][1:] - elongation).max()),
    )


@pytest.mark.parametrize("algorithm", ALGORITHM_IDS)
def test_every_algorithm_is_as_in_the_service(algorithm: AlgorithmId, make: Make, running: Run, rig: Rig) -> None:
    made = make(estimator_unit(rig, algorithm, SAMPLE_S), 2)
    assert max(apart(made, running, rig, algorithm)) <= AGREES


def test_effects_of_the_rig_are_corrected_as_in_the_service(make: Make, running: Run, rig: Rig) -> None:
    known = rig.with_changes({"effects": EFFECTS})
    made = make(estimator_unit(known, "kalman", SAMPLE_S), 2)
    assert max(apart(made, running, known, "kalman")) <= AGREES
    assert max(apart(made, running, rig, "kalman")) > 1e3 * AGREES


def test_fmi_3_is_as_the_service_too(kalman_fmu_3: Made, running: Run, rig: Rig) -> None:
    assert max(apart(kalman_fmu_3, running, rig, "kalman")) <= AGREES


def test_samples_need_not_come_evenly_and_the_reference_makes_up_for_the_elongation(
    kalman_fmu_3: Made, running: Run, rig: Rig
) -> None:
    unit = running(kalman_fmu_3)
    steps_s = np.array([1e-3, 2e-3, 5e-4, 1e-3, 1e-2, 1e-3])
    told = []
    for row, step_s in enumerate(steps_s.tolist()):
        unit.set({"theta_m_rad": float(ANGLE[row]), "current_A": float(CURRENT[row]), "theta_j_ref_rad": 0.5})
        unit.step(step_s)
        told.append(unit.get("tau_w_N_m", "elongation_m", "theta_m_ref_rad"))
    estimator = make_estimator("kalman", rig, SAMPLE_S, over_wire=False)
    time_ns = np.round(np.concatenate(([0.0], np.cumsum(steps_s)[:-1])) * 1e9).astype(np.int64)
    plant = rig.plant()
    rows = slice(steps_s.size)
    tau_w, elongation = batch.run(estimator, time_ns, ANGLE[rows], plant.torque_constant_N_m_per_A * CURRENT[rows])
    reference = (plant.jaw_pulley_radius_m * 0.5 + elongation) / plant.motor_pulley_radius_m
    assert np.abs(np.array(told) - np.array([tau_w, elongation, reference]).T).max() <= AGREES
