"""The driven simulation against the closed loop's: two ways through the same equations."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.model import closed_loop, driven, parameters
from hil_forceps.model.closed_loop import Channels, Inputs
from hil_forceps.model.smoothing import smooth
from hil_forceps.rig import load_rig
from hil_forceps.rig.catalogue import EFFECTS
from hil_forceps.rig.sections import DriveLaw

Vector = NDArray[np.float64]
RIG = load_rig(Path(__file__).parents[3] / "configs" / "paper.yaml")
DRIVE = DriveLaw(
    sample_time_s=1e-3,
    kp_A_per_rad=1.2,
    ki_A_per_rad_s=15.0,
    kd_A_s_per_rad=0.006,
    derivative_cutoff_Hz=150.0,
    current_limit_A=1.0,
)
TIME_S = np.linspace(0.0, 2.999, 3000)
ROWS = slice(300, -100)  # without the ends of the smoothing


def theta_of(effect_id: str | None = None) -> Vector:
    theta = parameters.vector(RIG)
    for entry in EFFECTS:
        for item in entry.parameters if entry.id == effect_id else ():
            theta[parameters.index(f"effects.{entry.id}.{item.name}")] = item.typical
    return theta


def closed(theta: Vector, quantum_rad: float = 0.0) -> Channels:
    reference = 0.6 + 0.4 * np.sin(2.0 * np.pi * 0.7 * TIME_S) + 0.1 * np.sin(2.0 * np.pi * 3.1 * TIME_S)
    load = 1e-3 * (1.0 + np.sin(2.0 * np.pi * 0.4 * TIME_S))
    inputs = Inputs(TIME_S, reference, load, np.array([], dtype=np.int64), np.array([]))
    law = closed_loop.law_vector(DRIVE)
    return closed_loop.simulate(theta, law, quantum_rad, inputs, closed_loop.rest(theta, 0.6), 8)


SMOOTH = {
    None, "jaw_gravity", "wire_hardening", "wire_creep", "torque_ripple", "pulley_eccentricity",
    "transmission_curve", "jaw_coupling", "loaded_presliding", "viscous_asymmetry", "jaw_presliding",
}  # fmt: skip


def off(a: Vector, b: Vector) -> float:
    return float(np.sqrt(np.mean((a - b)[ROWS] ** 2)))


# Stick and slip is faster than any smoothed motion; its own test below.
@pytest.mark.parametrize("effect_id", [None, *(entry.id for entry in EFFECTS if entry.id != "stribeck_friction")])
def test_predicts_what_the_closed_loop_did(effect_id: str | None) -> None:
    theta = theta_of(effect_id)
    theta[parameters.index("effects.channel_skew.current_s")] = 0.0
    # A row's current was held over the sample before it; dead time of half a sample centres it on the row.
    theta[parameters.index("effects.actuation_delay.delay_s")] = 5e-4
    c = closed(theta)
    given = driven.Inputs(TIME_S, c.theta_m_rad, c.tau_w_N_m, None)
    loaded = driven.simulate(theta, given, bandwidth_Hz=100.0)
    assert off(loaded.current_A, c.current_A) < 1.5e-3
    assert off(loaded.theta_j_rad, c.theta_j_rad) < 1e-4
    seen = driven.simulate(theta, given._replace(tau_w_N_m=None, theta_j_rad=c.theta_j_rad), bandwidth_Hz=100.0)
    assert off(seen.current_A, c.current_A) < 1.5e-3
    assert off(seen.tau_w_N_m, c.tau_w_N_m) < 1e-5
    if effect_id in SMOOTH:
        assert off(loaded.current_A, c.current_A) < 5e-5
        assert off(loaded.theta_j_rad, c.theta_j_rad) < 3e-6
        assert off(seen.tau_w_N_m, c.tau_w_N_m) < 1e-7


SEEN = [
    "cogging", "load_dependent_friction", "presliding_friction", "jaw_gravity", "jaw_coupling", "loaded_presliding",
    "viscous_asymmetry", "jaw_presliding", "jaw_viscous_friction",
]  # fmt: skip


@pytest.mark.parametrize("effect_id", SEEN)
def test_an_effect_left_out_is_seen_in_the_current(effect_id: str) -> None:
    c = closed(theta_of(effect_id), 2.0 * np.pi / 16384)
    given = driven.Inputs(TIME_S, c.theta_m_rad, c.tau_w_N_m, None)
    with_it = off(driven.simulate(theta_of(effect_id), given).current_A, c.current_A)
    without = off(driven.simulate(theta_of(), given).current_A, c.current_A)
    assert with_it < 0.6 * without


def test_play_left_out_is_seen_at_the_jaw() -> None:
    c = closed(theta_of("transmission_play"), 2.0 * np.pi / 16384)
    given = driven.Inputs(TIME_S, c.theta_m_rad, c.tau_w_N_m, None)
    with_it = off(driven.simulate(theta_of("transmission_play"), given).theta_j_rad, c.theta_j_rad)
    without = off(driven.simulate(theta_of(), given).theta_j_rad, c.theta_j_rad)
    assert with_it < 0.1 * without


def test_encoder_errors_and_skew_are_taken_out_of_the_measured_angle() -> None:
    theta = theta_of("encoder_eccentricity")
    theta[parameters.index("effects.encoder_scale.relative_error")] = 0.01
    true = np.sin(2.0 * np.pi * 0.5 * TIME_S)
    shown = 1.01 * true + 2e-3 * np.sin(true) + 2e-3 * np.cos(true)
    assert np.abs(driven.motor_angle_rad(theta, shown, 1e-3) - true).max() < 1e-12


def test_smoothing_keeps_a_cubic_and_its_derivatives() -> None:
    t = np.linspace(0.0, 1.0, 101)
    motion = smooth(1.0 + 2.0 * t - t**2 + 0.5 * t**3, 0.01, 10.0)
    assert motion.speed_rad_per_s == pytest.approx(2.0 - 2.0 * t + 1.5 * t**2, abs=1e-9)
    assert motion.acceleration_rad_per_s2 == pytest.approx(-2.0 + 3.0 * t, abs=1e-6)


def test_smoothing_is_3_dB_down_at_its_bandwidth() -> None:
    t = np.linspace(0.0, 1.999, 2000)
    for bandwidth_Hz in (10.0, 30.0, 80.0):
        wave = np.sin(2.0 * np.pi * bandwidth_Hz * t)
        gain = np.abs(smooth(wave, 1e-3, bandwidth_Hz).angle_rad[500:-500]).max()
        assert gain == pytest.approx(np.sqrt(0.5), abs=0.05)


def test_neither_load_nor_jaw_is_a_wrong_call() -> None:
    with pytest.raises(ValueError, match="neither"):
        driven.simulate(theta_of(), driven.Inputs(TIME_S, TIME_S, None, None))
    with pytest.raises(ValueError, match="length"):
        driven.simulate(theta_of(), driven.Inputs(TIME_S, TIME_S[1:], TIME_S, None))
    with pytest.raises(ValueError, match="bandwidth_Hz"):
        smooth(TIME_S, 1e-3, 0.0)
    with pytest.raises(ValueError, match="too few"):
        smooth(TIME_S[:3], 1e-3, 30.0)


def test_a_late_encoder_makes_no_blow_at_the_ends() -> None:
    theta = theta_of()
    theta[parameters.index("effects.channel_skew.theta_m_s")] = 1.7e-3
    shown = 2.0 * TIME_S
    assert driven.motor_angle_rad(theta, shown, 1e-3) == pytest.approx(shown + 2.0 * 1.7e-3, abs=1e-9)
