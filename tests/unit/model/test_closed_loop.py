"""The rollout: the drive's law, timing and sensors, convergence, sticking, and sensitivities."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.model import closed_loop, drive_law, linear_loop, parameters
from hil_forceps.model.closed_loop import Channels, DriveState, Inputs
from hil_forceps.model.current import current_over, current_step
from hil_forceps.model.sensors import late, late_load
from hil_forceps.rig import load_rig
from hil_forceps.rig.catalogue import EFFECTS, Effect
from hil_forceps.rig.sections import DriveLaw
from virtual_bus.logs import law_step
from virtual_bus.plant.position_loop import LoopParameters

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
LAW = closed_loop.law_vector(DRIVE)
NO_ROWS = np.array([], dtype=np.int64)


def inputs_of(rows: int = 1500, edges: Sequence[tuple[int, float]] = ()) -> Inputs:
    t = np.linspace(0.0, (rows - 1) * 1e-3, rows)
    reference = 0.6 + 0.4 * (1.0 - np.cos(2.0 * np.pi * 0.9 * t))
    load = 1e-3 * np.sin(2.0 * np.pi * 0.7 * t) ** 2
    return Inputs(t, reference, load, np.array([k for k, _ in edges], dtype=np.int64), np.array([s for _, s in edges]))


def theta_of(**values: float) -> Vector:
    """`wire_slack__half_width_m=…`; an effect's other parameters are at their typical size when they are shapes."""
    theta = parameters.vector(RIG)
    for name, value in values.items():
        prefix = "" if name.startswith(("forceps", "motor")) else "effects."
        theta[parameters.index(prefix + name.replace("__", "."))] = value
    return theta


CASCADE = DRIVE.model_copy(update={"cascade_time_s": 0.0125})


def run(theta: Vector, inputs: Inputs | None = None, substeps: int = 4, quantum_rad: float = 0.0) -> Channels:
    return closed_loop.simulate(theta, LAW, quantum_rad, inputs or inputs_of(), closed_loop.rest(theta, 0.6), substeps)


def worst(a: Vector, b: Vector) -> float:
    return float(np.abs(a - b).max())


@pytest.mark.parametrize("law", [DRIVE, CASCADE], ids=["PID", "cascade"])
def test_without_effects_it_is_the_linear_loop_with_its_exact_steps(law: DriveLaw) -> None:
    inputs = inputs_of()
    drive = linear_loop.DriveParameters(*(getattr(law, name) for name in linear_loop.DriveParameters._fields))
    loop = linear_loop.make_loop(RIG.plant(), drive, None, 5e-6)
    fine = np.interp((np.arange(1500 * 200) + 0.5) * 5e-6, inputs.time_s, inputs.tau_w_N_m)
    old = linear_loop.rollout(loop, linear_loop.rest_state(RIG.plant(), 0.6 / 0.7), inputs.reference_rad, fine)
    start = closed_loop.rest(theta_of(), 0.6)
    c = closed_loop.simulate(theta_of(), closed_loop.law_vector(law), 0.0, inputs, start, 4)
    assert worst(c.theta_m_rad, old.theta_m_rad) < 1e-6
    assert worst(c.current_A, old.current_A) < 3e-6


def test_converges_as_the_steps_shrink_for_every_effect_at_once_and_one_by_one() -> None:
    for entry in EFFECTS:
        theta = theta_of(**{f"{entry.id}__{item.name}": item.typical for item in entry.parameters})
        exact, four = run(theta, substeps=128), run(theta)
        # Falling friction is stiffer than the plant: its breakaway wants shorter steps.
        loose = 50.0 if entry.id == "stribeck_friction" else 1.0
        rows = slice(100, None)
        assert worst(four.theta_m_rad[rows], exact.theta_m_rad[rows]) < 3e-6 * loose, entry.id
        assert worst(four.theta_j_rad[rows], exact.theta_j_rad[rows]) < 1e-5 * loose, entry.id
        finer = worst(run(theta, substeps=32).theta_m_rad, exact.theta_m_rad)
        assert finer < 0.5 * worst(four.theta_m_rad, exact.theta_m_rad), entry.id


def test_a_motor_held_by_its_friction_stays_exactly_and_slips_at_its_level() -> None:
    theta = theta_of(forceps__motor_coulomb_N_m=2e-4)
    inputs = inputs_of(400)
    ramp = np.linspace(0.0, 0.03, 400)
    inputs = inputs._replace(reference_rad=0.6 + ramp, tau_w_N_m=np.zeros(400))
    c = run(theta, inputs)
    stuck = c.omega_m_rad_per_s == 0.0
    first = int(np.argmin(stuck))
    assert 20 < first < 200
    assert np.array_equal(c.theta_m_rad[:first], np.full(first, 0.6))
    level_A = 2e-4 / RIG.plant().torque_constant_N_m_per_A
    assert c.current_A[first - 1] < level_A < c.current_A[first + 1]


def test_a_motor_that_coasts_stops_where_constant_braking_stops_it() -> None:
    theta = theta_of(forceps__motor_coulomb_N_m=3e-4, forceps__motor_viscous_N_m_s_per_rad=0.0)
    theta[parameters.index("forceps.wire_stiffness_N_per_m")] = 1.0  # as good as no wire
    law = LAW.copy()
    law[[drive_law.KP, drive_law.KI, drive_law.KD]] = 0.0
    start = closed_loop.rest(theta, 0.0)
    start = start._replace(plant=start.plant._replace(omega_m_rad_per_s=5.0))
    inputs = Inputs(np.linspace(0.0, 9e-3, 10), np.zeros(10), np.zeros(10), NO_ROWS, np.array([]))
    c = closed_loop.simulate(theta, law, 0.0, inputs, start, 4)
    inertia = RIG.plant().motor_inertia_kg_m2
    assert c.omega_m_rad_per_s[-1] == 0.0
    assert c.theta_m_rad[-1] == pytest.approx(0.5 * inertia * 25.0 / 3e-4, rel=1e-3)


def test_the_law_of_recorded_angles_is_what_the_next_rows_measured() -> None:
    c = run(theta_of(), quantum_rad=3.8e-4)
    start = closed_loop.rest(theta_of(), 0.6).drive
    commands = closed_loop.law_current(LAW, inputs_of().reference_rad, c.theta_m_rad, start)
    assert worst(commands[:-1], c.current_A[1:]) < 1e-12
    with pytest.raises(ValueError, match="references"):
        closed_loop.law_current(LAW, np.zeros(3), np.zeros(4), start)


def test_variants_of_the_law() -> None:
    angle = 2.0 * math.pi * 150.0 * 1e-3
    assert LAW[4] == pytest.approx(1.0 - math.exp(-angle))
    assert closed_loop.law_vector(DRIVE, backward_euler=True)[4] == pytest.approx(angle / (1.0 + angle))
    rest = DriveState(0.0, math.nan, 0.0, 0.0)  # no angle before: no velocity
    one = np.array([0.1])
    first = closed_loop.law_current(LAW, one, 0.5 * one, rest)
    after = closed_loop.law_current(closed_loop.law_vector(DRIVE, error_first=False), one, 0.5 * one, rest)
    assert first[0] == pytest.approx(1.2 * 0.05 + 15.0 * 0.05e-3)
    assert after[0] == pytest.approx(1.2 * 0.05)


def test_a_cascade_integrates_the_error_of_speed() -> None:
    time_s = np.arange(600) * 1e-3
    reference, angle = 0.3 * np.sin(20.0 * time_s), 0.28 * np.sin(20.0 * time_s - 0.4)
    law = closed_loop.law_vector(CASCADE)
    rest = DriveState(0.0, float(angle[0]), 0.0, 0.0)
    memory = np.array([0.0, angle[0], 0.0])
    loop = LoopParameters(*(getattr(CASCADE, name) for name in LoopParameters._fields))
    world = [law_step(memory, r - a, a, loop) for r, a in zip(reference, angle, strict=True)]
    assert worst(closed_loop.law_current(law, reference, angle, rest), np.array(world)) < 1e-12
    assert worst(closed_loop.law_current(LAW, reference, angle, rest), np.array(world)) > 1e-2
    assert drive_law.integral_without_limit(law, reference, angle)[-1] == pytest.approx(memory[0], abs=1e-12)


@pytest.mark.parametrize("delay_s", [0.0, 0.3e-3, 1e-3, 2.65e-3])
@pytest.mark.parametrize("lag_s", [0.0, 1e-5, 2e-4, 3e-3])
def test_current_between_samples_is_that_of_the_delayed_and_lagged_steps(delay_s: float, lag_s: float) -> None:
    commands = np.array([0.0, 0.0, 0.0, 0.0, 1.0, -0.5, 0.2, 0.2, 0.0])
    c = current_step(2.5e-4, 4, delay_s, lag_s)
    fine = 4000  # points a step
    tau = (np.arange(fine) + 0.5) / fine
    now, exact = 0.0, 0.0
    for n in range(4, commands.size):
        for step in range(4):
            mean, slope, now = current_over(
                c, step, now, commands[n - c.whole_samples - 1], commands[n - c.whole_samples]
            )
            t = (n + (step + tau) / 4.0) * 1e-3
            wanted = commands[np.floor((t - delay_s) / 1e-3 + 1e-9).astype(int)]
            course = np.empty(fine)
            kept = math.exp(-2.5e-4 / fine / lag_s) if lag_s > 0.0 else 0.0
            for k in range(fine):
                exact = wanted[k] + (exact - wanted[k]) * kept
                course[k] = exact
            assert mean == pytest.approx(course.mean(), abs=5e-4)
            assert slope == pytest.approx(12.0 * ((tau - 0.5) * course).mean(), abs=3e-3)
            assert now == pytest.approx(exact, abs=5e-4)


def test_amplifier_cuts_small_and_large_commands() -> None:
    inputs = inputs_of()
    plain = run(theta_of(), inputs)
    cut = run(theta_of(amplifier_deadband__half_width_A=3e-3, current_saturation__limit_A=0.05), inputs)
    assert np.abs(plain.current_A).max() > 0.06
    assert np.abs(cut.current_A).max() == 0.05
    commands = closed_loop.law_current(
        LAW, inputs.reference_rad, cut.theta_m_rad, closed_loop.rest(theta_of(), 0.6).drive
    )
    dead = np.sign(commands) * np.maximum(np.abs(commands) - 3e-3, 0.0)
    assert worst(np.clip(dead, -0.05, 0.05)[:-1], cut.current_A[1:]) < 1e-12


def test_sensors_show_what_their_effects_make_of_the_truth() -> None:
    plain = run(theta_of())
    c = run(theta_of(current_offset__offset_A=5e-3, current_gain__relative_error=0.02))
    assert worst(c.current_A, 1.02 * plain.current_A + 5e-3) == 0.0
    assert worst(c.theta_m_rad, plain.theta_m_rad) == 0.0  # the drive doesn't use it
    tilted = run(
        theta_of(
            encoder_eccentricity__sine_rad=2e-3,
            encoder_eccentricity__cosine_rad=1e-3,
            encoder_scale__relative_error=3e-3,
        )
    )
    true = (
        tilted.elongation_m + RIG.plant().jaw_pulley_radius_m * tilted.theta_j_rad
    ) / RIG.plant().motor_pulley_radius_m
    assert worst(tilted.theta_m_rad, 1.003 * true + 2e-3 * np.sin(true) + 1e-3 * np.cos(true)) < 1e-12
    quantum = 2.0 * math.pi / 16384
    counted = run(theta_of(), quantum_rad=quantum).theta_m_rad / quantum
    assert worst(counted, np.round(counted)) < 1e-9


def test_skewed_channels_are_late_in_the_record_alone() -> None:
    plain = run(theta_of())
    c = run(theta_of(channel_skew__theta_m_s=2e-3, channel_skew__current_s=-1e-3, channel_skew__theta_j_s=0.5e-3))
    assert worst(c.theta_m_rad[2:], plain.theta_m_rad[:-2]) < 1e-15
    assert worst(c.current_A[:-1], plain.current_A[1:]) < 1e-15
    assert worst(c.theta_j_rad[2:-1], np.interp(np.arange(2, 1499) - 0.5, np.arange(1500), plain.theta_j_rad)) < 5e-6
    assert worst(c.tension_N, plain.tension_N) == 0.0


def test_a_load_that_was_recorded_late_acts_when_it_was() -> None:
    inputs = inputs_of(edges=[(700, 0.25)])
    load = inputs.tau_w_N_m + np.where(np.arange(1500) > 700, 1e-3, 0.0)
    exact = run(theta_of(), inputs._replace(tau_w_N_m=load))
    skewed, rows, fractions = late_load(load, inputs.edge_rows, inputs.edge_fractions, 2.5)
    assert (rows.tolist(), fractions.tolist()) == ([702], [0.75])
    recorded = inputs._replace(tau_w_N_m=skewed, edge_rows=rows, edge_fractions=fractions)
    c = run(theta_of(channel_skew__tau_w_s=2.5e-3), recorded)
    assert worst(c.theta_j_rad[5:-5], exact.theta_j_rad[5:-5]) < 2e-5
    assert np.array_equal(c.tau_w_N_m, skewed)


def test_a_jump_of_the_load_acts_at_its_fraction_of_the_row() -> None:
    speeds = []
    for fraction in (0.1, 0.35, 0.6, 0.85):
        inputs = Inputs(
            np.linspace(0.0, 3e-3, 4),
            np.full(4, 0.6),
            np.array([0.0, 1e-3, 1e-3, 1e-3]),
            np.array([0]),
            np.array([fraction]),
        )
        fine = run(theta_of(), inputs, substeps=400)
        c = run(theta_of(), inputs, substeps=4)
        assert c.theta_j_rad[1] == pytest.approx(fine.theta_j_rad[1], abs=3e-5)
        speeds.append(c.omega_j_rad_per_s[1])
    assert len(set(speeds)) == 4


def test_slope_of_the_load_and_late_resampling() -> None:
    values = np.linspace(0.0, 9.0, 10) ** 3
    assert late(values, 0.25)[2:-1] == pytest.approx((np.arange(2, 9) - 0.25) ** 3)
    assert late(values, 0.25, linear=True)[3] == pytest.approx(27.0 - 0.25 * 19.0)
    assert np.array_equal(late(values, 0.0), values)


@pytest.mark.parametrize("entry", EFFECTS, ids=[entry.id for entry in EFFECTS])
def test_sensitivities_by_one_sided_and_central_differences_agree(entry: Effect) -> None:
    typical = {f"{entry.id}__{item.name}": item.typical for item in entry.parameters}
    if "channel_skew__current_s" in typical:
        typical = {name: value * 1.3 for name, value in typical.items()}  # off the kinks at whole rows
    theta = theta_of(**typical)
    base = run(theta)
    for name, value in typical.items():
        step = 1e-4 * abs(value)
        up, down = run(theta_of(**{**typical, name: value + step})), run(theta_of(**{**typical, name: value - step}))
        for channel in range(3):
            central, forward = (up[channel] - down[channel]) / 2.0, up[channel] - base[channel]
            size = np.sqrt(np.mean(central**2))
            assert np.sqrt(np.mean((forward - central) ** 2)) <= 0.05 * size + 2e-9, (name, channel)


@pytest.mark.parametrize("samples", [1, 2])
@pytest.mark.parametrize("friction", [0.0, 3e-5], ids=["as it is", "that stops it"])
def test_one_step_for_a_sample_is_all_of_its_steps(friction: float, samples: int) -> None:
    law = closed_loop.law_vector(DRIVE.model_copy(update={"sample_time_s": 1e-3 / samples}))
    inputs = inputs_of(edges=[(400, 0.3), (900, 0.8)])
    theta = theta_of(coulomb_asymmetry__difference_N_m=4e-6)
    theta[parameters.index("forceps.motor_coulomb_N_m")] += friction
    stepped = theta.copy()
    stepped[parameters.index("effects.cogging.sine_N_m")] = 1e-30  # does nothing, and is a plant with an effect
    start = closed_loop.rest(theta, 0.6)
    once, often = (closed_loop.simulate(each, law, 1e-4, inputs, start, 8, samples) for each in (theta, stepped))
    for a, b in zip(once, often, strict=True):
        assert worst(a, b) <= 1e-10 * np.abs(b).max()
    stands = np.count_nonzero(once.omega_m_rad_per_s == 0.0)
    assert stands > 20 if friction else stands < 20


def test_same_call_same_bits_and_two_samples_a_row() -> None:
    theta = theta_of(wire_slack__half_width_m=1e-6)
    assert all(np.array_equal(a, b) for a, b in zip(run(theta), run(theta), strict=True))
    law = closed_loop.law_vector(DRIVE.model_copy(update={"sample_time_s": 5e-4}))
    start = closed_loop.rest(theta, 0.6)
    inputs = inputs_of(200)
    twice = closed_loop.simulate(theta, law, 0.0, inputs, start, 4, 2)
    t = np.linspace(0.0, 0.199, 399)
    held = Inputs(
        t,
        np.repeat(inputs.reference_rad, 2)[:399],
        np.interp(t, inputs.time_s, inputs.tau_w_N_m),
        NO_ROWS,
        np.array([]),
    )
    once = closed_loop.simulate(theta, law, 0.0, held, start, 2)
    assert worst(twice.theta_m_rad, once.theta_m_rad[::2]) < 1e-12


@pytest.mark.parametrize(
    "inputs",
    [
        inputs_of()._replace(reference_rad=np.zeros(3)),
        inputs_of()._replace(edge_rows=np.array([1])),
        inputs_of()._replace(time_s=np.linspace(0.0, 3.0, 1500)),
    ],
)
def test_what_does_not_fit_is_a_wrong_call(inputs: Inputs) -> None:
    with pytest.raises(ValueError, match=r"length|sample time"):
        run(theta_of(), inputs)
    with pytest.raises(ValueError, match="multiple"):
        closed_loop.simulate(theta_of(), LAW, 0.0, inputs_of(), closed_loop.rest(theta_of(), 0.6), 4, 3)


def test_without_the_jaw_s_angle_no_channel_holds_the_jaw_s_radius() -> None:
    """What is fitted without it holds that radius, since these two plants are one to every other sensor."""
    scale, theta = 1.1, parameters.vector(RIG)
    other = theta.copy()
    for name in ("forceps.jaw_pulley_radius_m", "forceps.jaw_inertia_kg_m2"):
        other[parameters.index(name)] *= scale
    over = ("wire_stiffness_N_per_m", "motor_inertia_kg_m2", "motor_viscous_N_m_s_per_rad", "motor_coulomb_N_m")
    for name in (*(f"forceps.{key}" for key in over), "motor.torque_constant_N_m_per_A"):
        other[parameters.index(name)] /= scale
    one, two = run(theta), run(other)
    assert worst(one.theta_m_rad, two.theta_m_rad) < 1e-12
    assert worst(one.current_A, two.current_A) < 1e-12
    assert worst(one.theta_j_rad, scale * two.theta_j_rad) < 1e-12
