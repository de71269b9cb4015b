"""Each effect against its equation in the catalogue: the balances of a finely sampled run close with it, not without.

The equations are written down here a second time, over whole columns.
"""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.model import closed_loop, parameters
from hil_forceps.model.closed_loop import Channels, Inputs
from hil_forceps.rig import load_rig
from hil_forceps.rig.catalogue import EFFECTS, effect
from hil_forceps.rig.sections import DriveLaw

Vector = NDArray[np.float64]
RIG = load_rig(Path(__file__).parents[3] / "configs" / "paper.yaml")
P = RIG.plant()
ROW_S = 2.5e-5
ROWS = 12_000
OFF = {name: parameters.off_value(name) for name in parameters.NAMES if name.startswith("effects.")}


def law_of(sample_time_s: float) -> Vector:
    drive = DriveLaw(
        sample_time_s=sample_time_s,
        kp_A_per_rad=1.2,
        ki_A_per_rad_s=15.0,
        kd_A_s_per_rad=0.006,
        derivative_cutoff_Hz=150.0,
        current_limit_A=1.0,
    )
    return closed_loop.law_vector(drive)


def inputs_of(rows: int, row_s: float) -> Inputs:
    t = np.linspace(0.0, (rows - 1) * row_s, rows)
    reference = 0.6 + 0.3 * (1.0 - np.cos(2.0 * np.pi * 2.5 * t)) + 0.05 * np.sin(2.0 * np.pi * 9.0 * t) ** 2
    load = 6e-4 * np.sin(2.0 * np.pi * 4.0 * t) ** 3 + 3e-4 * np.sin(2.0 * np.pi * 1.7 * t)
    return Inputs(t, reference, load, np.array([], dtype=np.int64), np.array([]))


def theta_of(effect_id: str | None, **values: float) -> Vector:
    """The paper's plant with an effect at its typical size, or with given values."""
    theta = parameters.vector(RIG)
    if effect_id is not None:
        for item in effect(effect_id).parameters:
            theta[parameters.index(f"effects.{effect_id}.{item.name}")] = values.get(item.name, item.typical)
    return theta


def run(theta: Vector, rows: int = ROWS, row_s: float = ROW_S, substeps: int = 1, quantum_rad: float = 0.0) -> Channels:
    start = closed_loop.rest(theta, 0.6)
    return closed_loop.simulate(theta, law_of(row_s), quantum_rad, inputs_of(rows, row_s), start, substeps)


def slid(way: Vector, length: float) -> Vector:
    z = np.zeros(way.size + 1)
    for n, step in enumerate(way):
        z[n + 1] = np.sign(step) + (z[n] - np.sign(step)) * np.exp(-abs(step) / length)
    return z


def lost(theta_m: Vector, half_width: float) -> Vector:
    """What the play takes off the motor's angle."""
    p = np.zeros(theta_m.size)
    for n, way in enumerate(np.diff(theta_m)):
        p[n + 1] = min(half_width, max(-half_width, p[n] + way))
    return p


def wire_residual_N(theta: Vector, c: Channels, theta_m: Vector) -> Vector:
    """Tension less the wire's law."""
    e = {name.removeprefix("effects."): theta[parameters.index(name)] for name in OFF}
    theta_m = theta_m - lost(theta_m, e["transmission_play.half_width_rad"])
    p_c, p_s = e["pulley_eccentricity.cosine"], e["pulley_eccentricity.sine"]
    wound = P.motor_pulley_radius_m * (theta_m + p_c * np.sin(theta_m) + p_s * (1.0 - np.cos(theta_m)))
    wound += e["spool_radius_change.pitch_m_per_turn"] * theta_m**2 / (4.0 * np.pi)
    l_c, l_s, angle = e["transmission_curve.cosine"], e["transmission_curve.sine"], c.theta_j_rad
    x = wound - P.jaw_pulley_radius_m * (angle + l_c * np.sin(angle) + l_s * (1.0 - np.cos(angle)))
    creep = np.zeros(x.size)
    kept = np.exp(-ROW_S / e["wire_creep.time_constant_s"])
    for n in range(x.size - 1):
        goal = e["wire_creep.share"] * 0.5 * (c.tension_N[n] + c.tension_N[n + 1]) / P.wire_stiffness_N_per_m
        creep[n + 1] = kept * creep[n] + (1.0 - kept) * goal
    stretch = x - e["wire_permanent_stretch.stretch_m"] - creep
    half = e["wire_slack.half_width_m"]
    d = np.sign(stretch) * np.maximum(np.abs(stretch) - half, 0.0)
    tension = P.wire_stiffness_N_per_m * d * (1.0 + e["wire_hardening.beta_per_m2"] * d**2)
    tension += e["wire_hysteresis.force_N"] * slid(np.diff(x), e["wire_hysteresis.stretch_m"])
    ways = P.motor_pulley_radius_m * c.omega_m_rad_per_s - P.jaw_pulley_radius_m * c.omega_j_rad_per_s
    tension += e["wire_damping.damping_N_s_per_m"] * ways
    return np.asarray(c.tension_N - tension)


def motor_residual_N_m(theta: Vector, c: Channels, theta_m: Vector) -> Vector:
    """Inertia less all torques on the motor pulley, between rows; c.current_A the true current."""
    e = {name.removeprefix("effects."): theta[parameters.index(name)] for name in OFF}
    t, omega = np.arange(theta_m.size) * ROW_S, c.omega_m_rad_per_s
    r_m = P.motor_pulley_radius_m
    radius = r_m * (
        1.0 + e["pulley_eccentricity.cosine"] * np.cos(theta_m) + e["pulley_eccentricity.sine"] * np.sin(theta_m)
    )
    radius += e["spool_radius_change.pitch_m_per_turn"] * theta_m / (2.0 * np.pi)
    level = P.motor_coulomb_N_m + e["load_dependent_friction.mu"] * r_m * np.abs(c.tension_N)
    level += e["stribeck_friction.rise_N_m"] * np.exp(-((omega / e["stribeck_friction.speed_rad_per_s"]) ** 2))
    level += e["film_friction.level_N_m"] * (1.0 - np.exp(-np.abs(omega) / e["film_friction.speed_rad_per_s"]))
    a = e["coulomb_asymmetry.difference_N_m"]
    level += np.where(omega > 0.0, max(a, 0.0), max(-a, 0.0))
    friction = level * np.sign(omega)
    friction += e["presliding_friction.level_N_m"] * slid(np.diff(theta_m), e["presliding_friction.angle_rad"])
    z = slid(np.diff(theta_m), e["loaded_presliding.angle_rad"])
    friction += e["loaded_presliding.mu"] * r_m * np.abs(c.tension_N) * z
    v = e["viscous_asymmetry.difference_N_m_s_per_rad"]
    friction += np.where(omega * v > 0.0, abs(v), 0.0) * omega
    h = e["cogging.harmonic"]
    cogging = e["cogging.sine_N_m"] * np.sin(h * theta_m) + e["cogging.cosine_N_m"] * np.cos(h * theta_m)
    h = e["torque_ripple.harmonic"]
    ripple = e["torque_ripple.sine"] * np.sin(h * theta_m) + e["torque_ripple.cosine"] * np.cos(h * theta_m)
    change = e["viscous_drift.relative_change"]
    viscosity = P.motor_viscous_N_m_s_per_rad * (1.0 + change * (1.0 - np.exp(-t / e["viscous_drift.time_constant_s"])))
    change = e["torque_constant_drift.relative_change"]
    constant = P.torque_constant_N_m_per_A * (
        1.0 + change * (1.0 - np.exp(-t / e["torque_constant_drift.time_constant_s"]))
    )
    other = cogging - viscosity * omega - friction - radius * c.tension_N
    per_ampere = constant * (1.0 + ripple)
    torque = 0.5 * (other[1:] + other[:-1]) + 0.5 * (per_ampere[1:] + per_ampere[:-1]) * c.current_A[1:]
    return np.asarray(P.motor_inertia_kg_m2 * np.diff(omega) / ROW_S - torque)


def jaw_residual_N_m(theta: Vector, c: Channels) -> Vector:
    e = {name.removeprefix("effects."): theta[parameters.index(name)] for name in OFF}
    angle = c.theta_j_rad
    level = P.jaw_coulomb_N_m + e["jaw_position_friction.slope_N_m_per_rad"] * angle
    level = np.maximum(0.0, level + e["jaw_position_friction.curvature_N_m_per_rad2"] * angle**2)
    weight = e["jaw_gravity.sine_N_m"] * np.sin(angle) + e["jaw_gravity.cosine_N_m"] * np.cos(angle)
    weight += e["jaw_coupling.stiffness_N_m_per_rad"] * angle + e["jaw_coupling.torque_N_m"]
    grip = e["jaw_presliding.level_N_m"] + e["jaw_presliding.mu"] * P.jaw_pulley_radius_m * np.abs(c.tension_N)
    weight += grip * slid(np.diff(angle), e["jaw_presliding.angle_rad"])
    weight += e["jaw_viscous_friction.viscosity_N_m_s_per_rad"] * c.omega_j_rad_per_s
    curve = e["transmission_curve.cosine"] * np.cos(angle) + e["transmission_curve.sine"] * np.sin(angle)
    lever = P.jaw_pulley_radius_m * (1.0 + curve)
    torque = lever * c.tension_N - level * np.sign(c.omega_j_rad_per_s) - weight - c.tau_w_N_m
    return np.asarray(P.jaw_inertia_kg_m2 * np.diff(c.omega_j_rad_per_s) / ROW_S - 0.5 * (torque[1:] + torque[:-1]))


def moving(*speeds: Vector) -> NDArray[np.bool_]:
    """Intervals in which no speed changes its sign or is zero."""
    steady = np.ones(speeds[0].size - 1, dtype=bool)
    for speed in speeds:
        steady &= speed[1:] * speed[:-1] > 0.0
    return steady


def rms(values: Vector) -> float:
    return float(np.sqrt(np.mean(values**2)))


SHOWN_BY = {"pulley_eccentricity": "motor", "spool_radius_change": "motor", "transmission_play": "wire"}
IN_THE_PLANT = [entry.id for entry in EFFECTS if entry.location in {"motor", "wire", "jaw"}]
IN_THE_PLANT = [name for name in IN_THE_PLANT if name not in {"amplifier_deadband", "current_saturation"}]


@pytest.mark.parametrize("effect_id", IN_THE_PLANT)
def test_balances_close_with_the_effect_and_not_without(effect_id: str) -> None:
    theta, without = theta_of(effect_id), theta_of(None)
    if effect_id == "wire_creep":
        theta[parameters.index("effects.wire_creep.time_constant_s")] = 0.2
    c = run(theta)
    theta_m = c.theta_m_rad
    rows = moving(c.omega_m_rad_per_s, c.omega_j_rad_per_s)
    assert rows.mean() > 0.5
    near = {
        "wire": (rms(wire_residual_N(theta, c, theta_m)), rms(wire_residual_N(without, c, theta_m))),
        "motor": (
            rms(motor_residual_N_m(theta, c, theta_m)[rows]),
            rms(motor_residual_N_m(without, c, theta_m)[rows]),
        ),
        "jaw": (rms(jaw_residual_N_m(theta, c)[rows]), rms(jaw_residual_N_m(without, c)[rows])),
    }
    location = SHOWN_BY.get(effect_id, effect(effect_id).location)
    for balance, (closed, bare) in near.items():
        assert closed < 2e-6 if balance != "wire" else closed < 2e-5, (balance, closed)
        if balance == location:
            assert closed < 0.03 * bare, (balance, closed, bare)


@pytest.mark.parametrize("effect_id", [entry.id for entry in EFFECTS])
def test_neutral_values_are_the_plant_without_it_bit_for_bit(effect_id: str) -> None:
    shapes_moved = theta_of(None)
    for item in effect(effect_id).parameters:
        if item.neutral is None and item.name != "limit_A":
            shapes_moved[parameters.index(f"effects.{effect_id}.{item.name}")] = 1.5 * item.typical
    for ours, theirs in zip(run(shapes_moved, 200, 1e-3, 4), run(theta_of(None), 200, 1e-3, 4), strict=True):
        assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("effect_id", [entry.id for entry in EFFECTS])
def test_extremes_of_the_range_stay_finite(effect_id: str) -> None:
    for pick in ("minimum", "maximum"):
        values = {item.name: getattr(item, pick) for item in effect(effect_id).parameters}
        for sharp in (False, True):  # and with the shape at its other end
            for item in effect(effect_id).parameters:
                if item.neutral is None and sharp:
                    values[item.name] = item.minimum if pick == "maximum" else item.maximum
            c = run(theta_of(effect_id, **values), 600, 1e-3, 4)
            assert all(np.isfinite(column).all() for column in c), (effect_id, values)
            assert np.abs(c.theta_j_rad).max() < 1e4
