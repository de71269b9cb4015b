"""An algorithm is one file: what it lists is found, and its kernels run step by step, in records and in closed loop."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.estimation import batch
from hil_forceps.estimation.direct import plant_steps, run_direct
from hil_forceps.estimation.interface import Algorithm, Estimator, Sample, State, estimator_of_kernels
from hil_forceps.estimation.kernel import kernel
from hil_forceps.estimation.registry import ALGORITHMS, effects_passed_over, make_estimator
from hil_forceps.rig import Rig
from hil_forceps.rig.schema import ALGORITHM_IDS
from tests.unit.estimation.test_interface import RIG

Vector = NDArray[np.float64]


@kernel
def start(c: Vector, time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """At rest the motor's torque is the load's, through both pulleys."""
    tension = motor_torque_N_m / c[0]
    return np.array([float(time_ns), theta_m_rad, 0.0, tension * c[1], tension / c[2]])


@kernel
def step(state: State, c: Vector, time_ns: int, theta_m_rad: float, motor_torque_N_m: float) -> State:
    """The same at every sample: an estimator without inertia and friction."""
    if time_ns <= state[0]:
        return state
    return start(c, time_ns, theta_m_rad, motor_torque_N_m)


def _make(rig: Rig, sample_time_s: float, over_wire: bool) -> Estimator:  # noqa: ARG001 - what `make` takes
    plant = rig.plant()
    numbers = [plant.motor_pulley_radius_m, plant.jaw_pulley_radius_m, plant.wire_stiffness_N_per_m]
    return estimator_of_kernels("quasi_static", start, step, np.array(numbers))


QUASI_STATIC = Algorithm("quasi_static", _make)


@pytest.fixture(name="rig")
def rig_with_one_more_algorithm(monkeypatch: pytest.MonkeyPatch) -> Rig:
    monkeypatch.setitem(ALGORITHMS, QUASI_STATIC.id, QUASI_STATIC)
    return RIG


def test_what_files_may_name_is_what_is_found() -> None:
    assert set(ALGORITHMS) == set(ALGORITHM_IDS)


def test_a_further_algorithm_steps_as_it_runs(rig: Rig) -> None:
    estimator = make_estimator("quasi_static", rig, 1e-3)
    rng = np.random.default_rng(1)
    time_ns = np.cumsum(rng.integers(900_000, 1_100_000, 300))
    angle, torque = np.cumsum(rng.normal(size=300)) * 1e-3, rng.normal(size=300) * 1e-3
    tau_w, elongation = batch.run(estimator, time_ns, angle, torque)
    state = estimator.start(Sample(int(time_ns[0]), float(angle[0]), float(torque[0])))
    for n in range(300):
        if n:
            state = estimator.step(state, Sample(int(time_ns[n]), float(angle[n]), float(torque[n])))
        assert estimator.estimate(state) == (tau_w[n], elongation[n])
    plant = rig.plant()
    assert tau_w == pytest.approx(torque * plant.jaw_pulley_radius_m / plant.motor_pulley_radius_m)


def test_a_further_algorithm_compensates_in_closed_loop(rig: Rig) -> None:
    samples = 3000
    reference = np.full(samples, 0.5)
    load = np.full(samples * plant_steps(rig), 1e-3)
    runs = {
        compensated: run_direct(
            rig, make_estimator("quasi_static", rig, 1e-3), reference, load, compensated=compensated
        )
        for compensated in (True, False)
    }
    off = {each: abs(float(run.theta_j_rad[-1]) - 0.5) for each, run in runs.items()}
    assert off[False] > 0.01
    assert off[True] < 0.1 * off[False]
    assert runs[True].tau_w_estimate_N_m[-1] == pytest.approx(1e-3, rel=0.05)


def test_effects_are_passed_over_unless_the_algorithm_says_otherwise(rig: Rig) -> None:
    effects = {"wire_damping": {"damping_N_s_per_m": 1.0}, "cogging": {"sine_N_m": 1e-5, "harmonic": 6.0}}
    with_effects = rig.with_changes({"effects": effects})
    assert effects_passed_over("quasi_static", with_effects) == ("wire_damping", "cogging")
    assert effects_passed_over("improved", with_effects) == ("wire_damping",)
    assert effects_passed_over("kalman", with_effects) == ()
