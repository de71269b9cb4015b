"""Estimators that know of an effect are nearer to the truth than those that don't, on runs with the effect in them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.estimation import batch
from hil_forceps.estimation.interface import Sample
from hil_forceps.estimation.registry import ESTIMATOR_IDS, effects_passed_over, make_estimator
from hil_forceps.model import closed_loop, parameters
from hil_forceps.model.closed_loop import Channels, Inputs
from hil_forceps.rig import load_rig
from hil_forceps.rig.catalogue import EFFECTS, effect
from hil_forceps.rig.schema import Rig
from hil_forceps.rig.sections import DriveLaw

Vector = NDArray[np.float64]
RIG = load_rig(Path(__file__).parents[3] / "configs" / "paper.yaml").with_changes({"encoder.counts_per_rev": 1_000_000})
DRIVE = DriveLaw(
    sample_time_s=1e-3,
    kp_A_per_rad=1.2,
    ki_A_per_rad_s=15.0,
    kd_A_s_per_rad=0.006,
    derivative_cutoff_Hz=150.0,
    current_limit_A=1.0,
)
TIME_S = np.linspace(0.0, 2.999, 3000)
ROWS = slice(500, None)
# Sizes at which the estimate is off by more than it is anyway.
SIZES: dict[str, dict[str, float]] = {
    "presliding_friction": {},
    "load_dependent_friction": {"mu": 0.1},
    "coulomb_asymmetry": {},
    "viscous_drift": {"relative_change": 1.0},
    "jaw_position_friction": {"slope_N_m_per_rad": 1e-4, "curvature_N_m_per_rad2": 0.0},
    "jaw_gravity": {"cosine_N_m": 2e-4},
    "torque_constant_drift": {"relative_change": -0.1},
    "cogging": {},
    "torque_ripple": {"sine": 0.1},
    "current_offset": {"offset_A": 2e-2},
    "current_gain": {"relative_error": 0.1},
    "pulley_eccentricity": {"sine": 0.1},
    "spool_radius_change": {"pitch_m_per_turn": 4e-4},
    "transmission_curve": {"sine": 0.1, "cosine": 0.1},
    "jaw_coupling": {"stiffness_N_m_per_rad": 2e-4},
    "loaded_presliding": {"mu": 0.1},
    "viscous_asymmetry": {},
    "film_friction": {"level_N_m": 1e-4},
    "jaw_presliding": {"level_N_m": 1e-4, "mu": 0.1},
    "jaw_viscous_friction": {"viscosity_N_m_s_per_rad": 1e-4},
}
ELONGATION_SIZES: dict[str, dict[str, float]] = {
    "wire_slack": {"half_width_m": 1e-5},
    "wire_hardening": {"beta_per_m2": 1e9},
    "wire_hysteresis": {"force_N": 0.2},
    "wire_creep": {"share": 0.3},
    "wire_permanent_stretch": {"stretch_m": 1e-5},
    "encoder_eccentricity": {},
    "encoder_scale": {"relative_error": 1e-2},
    "pulley_eccentricity": {"sine": 0.05},
    "transmission_play": {"half_width_rad": 1e-2},
    "transmission_curve": {"sine": 0.05},
}


def rig_of(effect_id: str, sizes: dict[str, float]) -> Rig:
    values = {item.name: sizes.get(item.name, item.typical) for item in effect(effect_id).parameters}
    return RIG.with_changes({"effects": {effect_id: values}})


# What shows in the wire when the load steps.
STEP_SIZES: dict[str, dict[str, float]] = {
    "wire_damping": {"damping_N_s_per_m": 8.0},
    "electrical_lag": {"time_constant_s": 6e-4},
    "actuation_delay": {"delay_s": 5e-4},
}


def measured(rig: Rig) -> Channels:
    theta = parameters.vector(rig)
    reference = 0.8 + 0.5 * np.sin(2.0 * np.pi * 1.0 * TIME_S)
    load = 1e-3 * (0.2 + np.sin(2.0 * np.pi * 0.66 * TIME_S))
    inputs = Inputs(TIME_S, reference, load, np.array([], dtype=np.int64), np.array([]))
    start = closed_loop.rest(theta, 0.8)
    return closed_loop.simulate(theta, closed_loop.law_vector(DRIVE), 2.0 * np.pi / 1e6, inputs, start, 4)


def estimates(name: str, rig: Rig, c: Channels) -> tuple[Vector, Vector]:
    estimator = make_estimator(name, rig, 1e-3, over_wire=False)
    torque = rig.plant().torque_constant_N_m_per_A * c.current_A
    return batch.run(estimator, np.rint(TIME_S * 1e9).astype(np.int64), c.theta_m_rad, torque)


def rms(values: Vector) -> float:
    return float(np.sqrt(np.mean(values[ROWS] ** 2)))


@pytest.mark.parametrize("name", ["improved", "kalman"])
@pytest.mark.parametrize("effect_id", SIZES)
def test_load_is_told_better_by_who_knows_the_effect(name: str, effect_id: str) -> None:
    rig = rig_of(effect_id, SIZES[effect_id])
    c = measured(rig)
    knows, does_not = (rms(estimates(name, which, c)[0] - c.tau_w_N_m) for which in (rig, RIG))
    assert knows < 0.75 * does_not, (knows, does_not)


@pytest.mark.parametrize("name", ["improved", "kalman"])
@pytest.mark.parametrize("effect_id", ELONGATION_SIZES)
def test_compensation_is_told_better_by_who_knows_the_effect(name: str, effect_id: str) -> None:
    """x̂ of (10): what r_m times the angle that the encoder shows is beyond r_j θ_j."""
    rig = rig_of(effect_id, ELONGATION_SIZES[effect_id])
    c = measured(rig)
    needed = rig.plant().motor_pulley_radius_m * c.theta_m_rad - rig.plant().jaw_pulley_radius_m * c.theta_j_rad
    knows, does_not = (rms(estimates(name, which, c)[1] - needed) for which in (rig, RIG))
    assert knows < 0.75 * does_not, (knows, does_not)


@pytest.mark.parametrize("effect_id", STEP_SIZES)
def test_filter_that_knows_the_effect_tells_the_wire_better_when_the_load_steps(effect_id: str) -> None:
    rig = rig_of(effect_id, STEP_SIZES[effect_id])
    theta = parameters.vector(rig)
    load = 1e-3 * np.sign(np.sin(2.0 * np.pi * 3.3 * TIME_S))
    edges = np.flatnonzero(np.diff(load)).astype(np.int64)
    inputs = Inputs(TIME_S, 0.8 + 0.5 * np.sin(2.0 * np.pi * TIME_S), load, edges, np.full(edges.size, 0.5))
    c = closed_loop.simulate(
        theta, closed_loop.law_vector(DRIVE), 2.0 * np.pi / 1e6, inputs, closed_loop.rest(theta, 0.8), 8
    )
    needed = rig.plant().motor_pulley_radius_m * c.theta_m_rad - rig.plant().jaw_pulley_radius_m * c.theta_j_rad
    knows, does_not = (rms(estimates("kalman", which, c)[1] - needed) for which in (rig, RIG))
    assert knows < 0.6 * does_not, (knows, does_not)


def test_a_lagging_or_late_current_is_not_corrected_where_holds_are_not_seen() -> None:
    """A drive twice as fast as its samples: the current at the last sample says nothing of the last hold's begin."""
    rig = rig_of("electrical_lag", STEP_SIZES["electrical_lag"]).with_changes({"drive.sample_time_s": 5e-4})
    plain = RIG.with_changes({"drive.sample_time_s": 5e-4})
    c = measured(RIG)
    for one, two in zip(estimates("improved", rig, c), estimates("improved", plain, c), strict=True):
        assert np.allclose(one, two, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("name", ["improved", "kalman"])
def test_record_is_bit_for_bit_the_stepped_samples(name: str) -> None:
    effects = {entry.id: {item.name: item.typical for item in entry.parameters} for entry in EFFECTS}
    rig = RIG.with_changes({"effects": effects})
    c = measured(rig)
    estimator = make_estimator(name, rig, 1e-3, over_wire=False)
    assert estimator.record is not None
    times = np.rint(TIME_S * 1e9).astype(np.int64)
    times[[700, 1500]] = times[[699, 1400]]  # stamps that aren't later
    torque = rig.plant().torque_constant_N_m_per_A * c.current_A
    at_once = batch.run(estimator, times, c.theta_m_rad, torque)
    stepped = batch.run(replace(estimator, record=None), times, c.theta_m_rad, torque)
    assert all(np.array_equal(a, b) for a, b in zip(at_once, stepped, strict=True))


@pytest.mark.parametrize("name", ESTIMATOR_IDS)
def test_without_effects_not_a_bit_changes(name: str) -> None:
    c = measured(RIG)
    timing = RIG.with_changes({"effects": {"amplifier_deadband": {"half_width_A": 1e-3}}})
    off = RIG.with_changes({"effects": {"jaw_gravity": {}}})
    plain = estimates(name, RIG, c)
    assert make_estimator(name, RIG, 1e-3).compiled is not None
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(plain, estimates(name, timing, c), strict=True))
    # Corrected by nothing, a hundredth of the resolution of what the wire carries.
    assert all(
        np.allclose(a, b, rtol=0.0, atol=1e-9, equal_nan=True)
        for a, b in zip(plain, estimates(name, off, c), strict=True)
    )


@pytest.mark.parametrize("name", ["improved", "kalman"])
def test_a_stamp_that_is_not_later_changes_nothing_and_all_effects_at_once_stay_finite(name: str) -> None:
    effects = {entry.id: {item.name: item.typical for item in entry.parameters} for entry in EFFECTS}
    rig = RIG.with_changes({"effects": effects})
    c = measured(rig)
    tau_w, elongation = estimates(name, rig, c)
    assert np.isfinite(tau_w).all()
    assert np.isfinite(elongation).all()
    estimator = make_estimator(name, rig, 1e-3)
    state = estimator.step(estimator.start(Sample(0, 0.8, 0.0)), Sample(1_000_000, 0.81, 1e-3))
    assert np.array_equal(estimator.step(state, Sample(1_000_000, 0.9, 0.0)), state)


def test_what_an_estimator_passes_over_can_be_told() -> None:
    rig = RIG.with_changes({"effects": {"jaw_gravity": {}, "amplifier_deadband": {}, "wire_damping": {}}})
    assert effects_passed_over("kalman", rig) == ("amplifier_deadband",)
    assert effects_passed_over("improved", rig) == ("amplifier_deadband", "wire_damping")
    assert effects_passed_over("previous", rig) == ("jaw_gravity", "amplifier_deadband", "wire_damping")
