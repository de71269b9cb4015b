"""Effects in the truth plant against the catalogue's equations: torques, memories, what stays, what converges."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.rig.catalogue import EFFECT_IDS, EFFECTS, effect
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.plant import PlantParameters
from virtual_bus.effects.command import empty_queue, push_command
from virtual_bus.effects.composition import EffectNumbers
from virtual_bus.effects.motion import advance_with_effects, between
from virtual_bus.effects.numbers import effect_numbers
from virtual_bus.effects.physics import (
    Environment,
    Inputs,
    Memory,
    Motion,
    elongation_of,
    motion_rate,
    played,
    tension_of,
)
from virtual_bus.effects.start import STATE, check_step, rest_with_effects
from virtual_bus.plant.load import LoadProfile, paper_load, piecewise_linear
from virtual_bus.plant.plant import TruthParameters, truth_parameters

TABLE_I = PlantParameters(2.00e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.60e4, 1.35e-2)
P = truth_parameters(TABLE_I, 5.0e-5)
FREE = truth_parameters(TABLE_I._replace(motor_coulomb_N_m=0.0, jaw_coulomb_N_m=0.0), 5.0e-5)
NO_ENVIRONMENT = Environment(0.0, 0.0)
SECOND_NS = 1_000_000_000
BEHIND_RAD = 5.0e-4  # within the play
TYPICAL = {entry.id: {p.name: p.typical for p in entry.parameters} for entry in EFFECTS}
STARTS = [
    Motion(0.6, 1.7, 0.8, 2.0, 1.0e-6),
    Motion(-0.9, -0.2, -1.31, 0.4, -2.0e-6),
    Motion(4.0, 0.1, 5.6, -3.0, 0.0),
    Motion(0.3, -6.0, 0.45, -1.0, 3.0e-6),
]

Difference = Callable[[Motion, Memory, float, float, float], tuple[float, float]]


def numbers(**effects: dict[str, float]) -> EffectNumbers:
    return effect_numbers(effects)


def typical(*ids: str) -> EffectNumbers:
    return effect_numbers({name: TYPICAL[name] for name in ids})


def sign(value: float) -> float:
    return math.copysign(1.0, value)


def stretch_of(m: Motion) -> float:
    """Elongation of the plant without effects, less the creep."""
    return 2.0e-3 * m.theta_m - 1.4e-3 * m.theta_j - m.creep


# ruff: noqa: ARG005  (one signature for all)
# What an effect of typical size adds to the torque on motor and jaw, N m: (motion, memory, current, time, tension).
ADDED: dict[str, Difference] = {
    "stribeck_friction": lambda m, z, i, t, f: (-1e-4 * math.exp(-((m.omega_m / 0.3) ** 2)) * sign(m.omega_m), 0.0),
    "presliding_friction": lambda m, z, i, t, f: (-1e-4 * z.presliding, 0.0),
    "load_dependent_friction": lambda m, z, i, t, f: (-0.02 * 2.0e-3 * abs(f) * sign(m.omega_m), 0.0),
    "coulomb_asymmetry": lambda m, z, i, t, f: (-1e-4 if m.omega_m > 0.0 else 0.0, 0.0),
    "viscous_drift": lambda m, z, i, t, f: (-1.16e-4 * 0.1 * (1.0 - math.exp(-t / 6.0)) * m.omega_m, 0.0),
    "jaw_position_friction": lambda m, z, i, t, f: (
        0.0,
        -(max(0.0, 4.62e-9 + 1e-5 * m.theta_j + 1e-5 * m.theta_j**2) - 4.62e-9) * sign(m.omega_j),
    ),
    "jaw_gravity": lambda m, z, i, t, f: (0.0, -(1e-5 * math.sin(m.theta_j) + 1e-5 * math.cos(m.theta_j))),
    "jaw_coupling": lambda m, z, i, t, f: (0.0, -(2e-5 * m.theta_j + 1e-5)),
    "loaded_presliding": lambda m, z, i, t, f: (-0.02 * 2.0e-3 * abs(f) * z.loaded, 0.0),
    "viscous_asymmetry": lambda m, z, i, t, f: (-2e-5 * max(0.0, m.omega_m), 0.0),
    "film_friction": lambda m, z, i, t, f: (
        -3e-5 * (1.0 - math.exp(-abs(m.omega_m) / 0.3)) * sign(m.omega_m),
        0.0,
    ),
    "jaw_presliding": lambda m, z, i, t, f: (0.0, -(1e-5 + 0.02 * 1.4e-3 * abs(f)) * z.gripped),
    "jaw_viscous_friction": lambda m, z, i, t, f: (0.0, -1e-5 * m.omega_j),
    "torque_constant_drift": lambda m, z, i, t, f: (1.35e-2 * i * -0.02 * (1.0 - math.exp(-t / 6.0)), 0.0),
    "cogging": lambda m, z, i, t, f: (1e-4 * (math.sin(6.0 * m.theta_m) + math.cos(6.0 * m.theta_m)), 0.0),
    "torque_ripple": lambda m, z, i, t, f: (
        1.35e-2 * i * 0.02 * (math.sin(6.0 * m.theta_m) + math.cos(6.0 * m.theta_m)),
        0.0,
    ),
}

# The same for the wire: what it adds to the tension, N.
PULLED: dict[str, Callable[[Motion, Memory], float]] = {
    "wire_slack": lambda m, z: -2.6e4 * max(-1e-6, min(1e-6, stretch_of(m))),
    "wire_hardening": lambda m, z: 2.6e4 * 1e7 * stretch_of(m) ** 3,
    "wire_hysteresis": lambda m, z: 0.02 * z.hysteresis,
    "wire_damping": lambda m, z: 0.3 * (2.0e-3 * m.omega_m - 1.4e-3 * m.omega_j),
    "wire_permanent_stretch": lambda m, z: -2.6e4 * 1e-6,
    "transmission_play": lambda m, z: -2.6e4 * 2.0e-3 * BEHIND_RAD,
}


def torques(m: Motion, e: EffectNumbers, current_A: float, time_s: float) -> tuple[float, float, Memory]:
    x = elongation_of(m.theta_m, m.theta_j, P, e)
    memory = Memory(m.theta_m, m.theta_j, x, 0.4, -0.7, sign(m.omega_m), sign(m.omega_j), BEHIND_RAD, 0.3, -0.6)
    u = Inputs(current_A, current_A, 0.0, 1.0e-3, 0.0, time_s)
    rate = motion_rate(m, memory, u, 0.0, P, e, NO_ENVIRONMENT)
    return rate.omega_m * TABLE_I.motor_inertia_kg_m2, rate.omega_j * TABLE_I.jaw_inertia_kg_m2, memory


@pytest.mark.parametrize("m", STARTS)
@pytest.mark.parametrize("name", [*ADDED, *PULLED])
def test_torques_are_those_of_the_equation(name: str, m: Motion) -> None:
    current, time_s = 0.15, 2.5
    with_m, with_j, memory = torques(m, typical(name), current, time_s)
    without_m, without_j, _ = torques(m, numbers(), current, time_s)
    if name in PULLED:
        pull = PULLED[name](m, memory)
        expected = (-2.0e-3 * pull, 1.4e-3 * pull)
    else:
        expected = ADDED[name](m, memory, current, time_s, 2.6e4 * stretch_of(m))
    scale = abs(without_m) + abs(without_j)
    assert with_m - without_m == pytest.approx(expected[0], rel=1.0e-6, abs=1.0e-13 * scale)
    assert with_j - without_j == pytest.approx(expected[1], rel=1.0e-6, abs=1.0e-13 * scale)


@pytest.mark.parametrize("name", ["pulley_eccentricity", "spool_radius_change"])
def test_wire_winds_up_by_the_radius_and_pulls_at_it(name: str) -> None:
    """Power balance: what the tension takes from the motor is what it puts into stretch."""
    e = typical(name)
    for angle in (-2.0, 0.3, 5.0):
        if name == "pulley_eccentricity":
            radius = 2.0e-3 * (1.0 + 0.01 * math.sin(angle) + 0.01 * math.cos(angle))
        else:
            radius = 2.0e-3 + 2.0e-5 * angle / (2.0 * math.pi)
        slope = (elongation_of(angle + 1e-4, 0.0, P, e) - elongation_of(angle - 1e-4, 0.0, P, e)) / 2e-4
        assert slope == pytest.approx(radius, rel=1.0e-8)
        m = Motion(angle, 0.0, elongation_of(angle, 0.0, P, e) / 1.4e-3 - 0.01, 0.0, 0.0)
        torque_m, torque_j, _ = torques(m, e, 0.0, 0.0)
        pull = 2.6e4 * 1.4e-3 * 0.01
        assert torque_m == pytest.approx(-radius * pull - 4.62e-7, rel=1.0e-6)
        assert torque_j == pytest.approx(1.4e-3 * pull - 4.62e-9 - 1.0e-3, rel=1.0e-6)
    assert elongation_of(0.0, 0.0, P, e) == 0.0


def test_jaw_takes_wire_by_its_lever_and_is_pulled_at_it() -> None:
    e = typical("transmission_curve")
    for angle in (-1.2, 0.3, 2.0):
        lever = 1.4e-3 * (1.0 + 0.01 * math.sin(angle) + 0.01 * math.cos(angle))
        slope = (elongation_of(0.0, angle + 1e-4, P, e) - elongation_of(0.0, angle - 1e-4, P, e)) / 2e-4
        assert slope == pytest.approx(-lever, rel=1.0e-8)
        theta_m = (1.0e-5 - elongation_of(0.0, angle, P, e)) / 2.0e-3
        torque_m, torque_j, _ = torques(Motion(theta_m, 0.0, angle, 0.0, 0.0), e, 0.0, 0.0)
        pull = 2.6e4 * 1.0e-5
        assert torque_m == pytest.approx(-2.0e-3 * pull - 4.62e-7, rel=1.0e-6)
        assert torque_j == pytest.approx(lever * pull - 4.62e-9 - 1.0e-3, rel=1.0e-6)
    assert elongation_of(0.0, 0.0, P, e) == 0.0


def test_play_is_lost_at_each_reversal_and_nowhere_else() -> None:
    """The motor there and back, held by force: the pulley follows 2 ψ later, whatever the tension."""
    for tension_N in (0.0, 5.0):
        behind, pulley = 0.0, []
        for way in (0.01, -0.003, -0.01, 0.002, 0.01):
            behind = played(behind, way, 2.0e-3)
            pulley.append(behind)
        assert pulley == pytest.approx([2e-3, -1e-3, -2e-3, 0.0, 2e-3])
        # In the gap the wire neither winds nor lets go of its tension.
        e = numbers(transmission_play={"half_width_rad": 2.0e-3})
        memory = Memory(0.5, 0.5, 0.0, 0.0, 0.0, 1.0, 1.0, -1.0e-3, 0.0, 0.0)
        jaw = (2.0e-3 * 0.501 - tension_N / 2.6e4) / 1.4e-3
        for way in (0.0, 1.0e-3, 2.9e-3):
            assert tension_of(Motion(0.5 + way, 0.0, jaw, 0.0, 0.0), memory, P, e) == pytest.approx(tension_N, abs=1e-9)
        pulled = tension_of(Motion(0.504, 0.0, jaw, 0.0, 0.0), memory, P, e)
        assert pulled == pytest.approx(tension_N + 2.6e4 * 2.0e-3 * 1.0e-3)


def test_every_effect_has_a_test_of_its_equation() -> None:
    elsewhere = {
        "wire_creep", "pulley_eccentricity", "spool_radius_change", "current_offset", "current_gain",
        "amplifier_deadband", "electrical_lag", "actuation_delay", "channel_skew", "encoder_eccentricity",
        "encoder_scale", "current_saturation", "transmission_curve",
    }  # fmt: skip
    assert set(ADDED) | set(PULLED) | elsewhere == set(EFFECT_IDS)


def moved(
    state: NDArray[np.float64],
    e: EffectNumbers,
    end_ns: int,
    *,
    load: LoadProfile | None = None,
    command_A: float = 0.0,
    step_s: float = 5.0e-5,
    p: TruthParameters = P,
) -> NDArray[np.float64]:
    """Return the state after `end_ns` under a constant command."""
    profile = load or paper_load(0)
    result = state.copy()
    queue = empty_queue(e.actuation_delay_delay_s, 1.0)
    push_command(queue, command_A, round(e.actuation_delay_delay_s * 1e9))
    late = np.full(4, end_ns)
    advance_with_effects(
        result, queue, p, e, NO_ENVIRONMENT, profile.time_ns, profile.torque_N_m, 0, end_ns, step_s, late, np.zeros(4)
    )
    return result


def named(state: NDArray[np.float64]) -> dict[str, float]:
    return dict(zip(STATE, state.tolist(), strict=True))


def test_friction_holds_a_body_still_up_to_its_level_and_no_further() -> None:
    e = numbers(coulomb_asymmetry={"difference_N_m": 1.0e-4})
    level = 1.0e-4 + 4.62e-7
    start = rest_with_effects(P, e, 0.0)
    held = moved(start, e, SECOND_NS, command_A=0.99 * level / 1.35e-2)
    assert (held[0], held[1], held[2]) == (0.0, 0.0, 0.0)
    assert moved(start, e, SECOND_NS // 10, command_A=1.05 * level / 1.35e-2)[0] > 1.0e-3
    assert moved(start, e, SECOND_NS // 10, command_A=-0.2 * level / 1.35e-2)[0] < -1.0e-2  # no brake this way


def test_motor_coasts_to_rest_as_the_equation_says_and_stays() -> None:
    """Constant friction a on inertia J without anything else: angle ω²J/2a, and then not the least motion."""
    slippery = truth_parameters(TABLE_I._replace(motor_viscous_N_m_s_per_rad=0.0, wire_stiffness_N_per_m=1e-9), 5.0e-5)
    start = np.zeros(len(STATE))
    start[1] = 3.0
    e = numbers(stribeck_friction={"rise_N_m": 1.0e-5, "speed_rad_per_s": 1.0e6})
    end = moved(start, e, SECOND_NS, p=slippery)
    level = 4.62e-7 + 1.0e-5
    assert end[0] == pytest.approx(3.0**2 * 3.18e-8 / 2.0 / level, rel=1.0e-5)
    assert end[1] == 0.0
    assert moved(end, e, SECOND_NS, p=slippery)[0] == end[0]


def test_presliding_builds_up_over_its_angle() -> None:
    """A slow push: torque over angle is L (1 − exp(−θ/δ))."""
    e = numbers(presliding_friction={"level_N_m": 1.0e-4, "angle_rad": 0.02})
    loose = truth_parameters(TABLE_I._replace(motor_coulomb_N_m=0.0, wire_stiffness_N_per_m=1e-9), 5.0e-5)
    pushed = 0.6e-4
    end = named(moved(np.zeros(len(STATE)), e, 5 * SECOND_NS, command_A=pushed / 1.35e-2, p=loose))
    assert end["presliding"] == pytest.approx(0.6, rel=0.02)
    assert end["theta_m"] == pytest.approx(-0.02 * math.log(1.0 - end["presliding"]), rel=1.0e-9)
    back = named(moved(moved(np.zeros(len(STATE)), e, 5 * SECOND_NS, command_A=pushed / 1.35e-2, p=loose), e,
                       5 * SECOND_NS, p=loose))  # fmt: skip
    assert 0.0 < back["theta_m"] < end["theta_m"]  # it doesn't return to where it was


def test_creep_settles_at_its_share_and_recovers() -> None:
    """Motor held by its friction, jaw loaded: x_c goes to s f/k with the time constant, and back."""
    e = numbers(wire_creep={"share": 0.5, "time_constant_s": 0.5}, coulomb_asymmetry={"difference_N_m": -1.0})
    held = P._replace(motor_coulomb_N_m=1.0)
    load = piecewise_linear([0.0, 4.0, 4.0], [1.0e-3, 1.0e-3, 0.0])
    final = 0.5 * (1.0e-3 / 1.4e-3) / 2.6e4
    start = rest_with_effects(held, e, 0.0)
    for time_s in (0.25, 1.0, 3.0):
        creep = moved(start, e, round(time_s * 1e9), load=load, p=held)[4]
        assert creep == pytest.approx(final * (1.0 - math.exp(-time_s / 0.5)), rel=0.02)
    kept = moved(start, e, 4 * SECOND_NS, load=load, p=held)[4]
    recovered = moved(start, e, 5 * SECOND_NS, load=load, p=held)[4]
    assert recovered == pytest.approx(kept * math.exp(-2.0), rel=0.03)


def test_hysteresis_of_the_wire_is_a_loop_whatever_the_rate() -> None:
    """Load up, down and up again: the stretch differs by direction, by nearly 2h in force, at both rates."""
    h = 0.05
    e = numbers(wire_hysteresis={"force_N": h, "stretch_m": 2.0e-6})
    held = P._replace(motor_coulomb_N_m=1.0)

    def widths(leg_s: float) -> float:
        load = piecewise_linear([0.0, leg_s, 2 * leg_s, 3 * leg_s], [0.0, 2.0e-3, -2.0e-3, 2.0e-3])
        start = rest_with_effects(held, e, 0.0)
        down = moved(start, e, round(1.5 * leg_s * 1e9), load=load, p=held)[2]
        up = moved(start, e, round(2.5 * leg_s * 1e9), load=load, p=held)[2]
        return float(1.4e-3 * (up - down)) * 2.6e4

    assert widths(2.0) == pytest.approx(2.0 * h, rel=0.05)
    assert widths(8.0) == pytest.approx(widths(2.0), rel=0.02)


def test_wire_with_hysteresis_and_damping_gives_no_energy() -> None:
    """Swinging freely, kinetic and elastic energy with what the memory holds never grow."""
    e = numbers(
        wire_hysteresis={"force_N": 0.02, "stretch_m": 5.0e-6}, wire_damping={"damping_N_s_per_m": 0.01},
        load_dependent_friction={"mu": 0.02},
    )  # fmt: skip
    free = FREE._replace(motor_viscous_N_m_s_per_rad=0.0)
    state = rest_with_effects(free, e, 0.0)
    state[2] = -0.01
    energies = []
    for _ in range(400):
        state = moved(state, e, 500_000, step_s=1.0e-5, p=free)
        x = 2.0e-3 * state[0] - 1.4e-3 * state[2]
        energies.append(0.5 * (3.18e-8 * state[1] ** 2 + 6.85e-8 * state[3] ** 2 + 2.6e4 * x**2))
    assert energies[-1] < 0.2 * energies[0]
    assert (np.diff(energies) < 0.02 * 5.0e-6).all()  # the memory can give back h·s at most


@pytest.mark.parametrize("name", EFFECT_IDS)
def test_neutral_effect_changes_no_bit(name: str) -> None:
    neutral = {p.name: p.typical if p.neutral is None else p.neutral for p in effect(name).parameters}
    if name == "current_saturation":
        neutral = {"limit_A": 200.0}
    others = {"cogging": TYPICAL["cogging"], "viscous_drift": TYPICAL["viscous_drift"]}
    ends = []
    for effects in (others, others | {name: others.get(name, neutral)}):
        e = effect_numbers(effects)
        start = rest_with_effects(P, e, 0.3)
        ends.append(moved(start, e, SECOND_NS // 10, load=piecewise_linear([0.0, 0.1], [0.0, 1e-3]), command_A=0.05))
    assert ends[0].tobytes() == ends[1].tobytes()
    if name != "current_saturation":
        assert effect_numbers({name: neutral}) == numbers()


@pytest.mark.parametrize("ids", [("wire_hardening", "cogging"), ("jaw_gravity", "torque_constant_drift", "wire_creep"),
                                 ("pulley_eccentricity", "electrical_lag", "viscous_drift")])  # fmt: skip
def test_smooth_effects_keep_the_order_of_the_integrator(ids: tuple[str, ...]) -> None:
    e = typical(*ids)
    start = rest_with_effects(FREE, e, 0.2)
    load = piecewise_linear([0.0, 0.01], [0.0, 1.5e-3])

    def end(step_s: float) -> NDArray[np.float64]:
        return moved(start, e, 20_000_000, load=load, command_A=0.3, step_s=step_s, p=FREE)[:4]

    exact = end(5.0e-6)
    coarse, fine = (np.abs(end(step_s) - exact) / np.abs(exact) for step_s in (1.0e-4, 5.0e-5))
    assert (coarse.max() / fine.max()) > 12.0


def test_friction_that_stops_and_releases_converges() -> None:
    e = typical("stribeck_friction", "presliding_friction", "load_dependent_friction", "coulomb_asymmetry")
    start = rest_with_effects(P, e, 0.0)
    load = piecewise_linear([0.0, 0.05, 0.1, 0.15], [0.0, 2.0e-3, -2.0e-3, 1.0e-3])

    def end(step_s: float) -> NDArray[np.float64]:
        return moved(start, e, 200_000_000, load=load, step_s=step_s)[[0, 2]]

    exact = end(2.0e-6)
    errors = [np.abs(end(step_s) - exact).max() for step_s in (8.0e-5, 4.0e-5, 2.0e-5)]
    assert abs(exact[0]) > 0.05
    assert errors[0] < 1.0e-3
    assert errors[2] < 0.3 * errors[0]


def test_all_effects_at_once_stay_finite() -> None:
    e = effect_numbers(TYPICAL)
    start = rest_with_effects(P, e, 0.5)
    load = piecewise_linear([0.0, 0.5, 0.5, 1.0], [0.0, 3.0e-3, -3.0e-3, 0.0])
    assert np.isfinite(moved(start, e, SECOND_NS, load=load, command_A=0.1)).all()


def test_rest_is_without_tension() -> None:
    e = typical("wire_permanent_stretch", "pulley_eccentricity", "spool_radius_change")
    for angle in (-1.0, 0.0, 2.5):
        state = rest_with_effects(P, e, angle)
        assert elongation_of(float(state[0]), angle, P, e) - e.wire_permanent_stretch_stretch_m == pytest.approx(
            0.0, abs=1.0e-17
        )


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        ({"wire_slack": {"delta_m": 1e-6}}, "wire_slack.delta_m"),
        ({"wire_creep": {"share": 0.1}}, "wire_creep.time_constant_s: is missing"),
        ({"current_saturation": {}}, "current_saturation.limit_A: is missing"),
        ({"gremlins": {}}, "gremlins"),
    ],
)
def test_effects_that_say_too_little_or_nonsense_are_refused(effects: dict[str, dict[str, float]], words: str) -> None:
    with pytest.raises(UserError, match=words):
        effect_numbers(effects)


@pytest.mark.parametrize("effects", [{"wire_hardening": {"beta_per_m2": 1e13}},
                                     {"wire_damping": {"damping_N_s_per_m": 500.0}},
                                     {"presliding_friction": {"level_N_m": 1e-3, "angle_rad": 1e-5}}])  # fmt: skip
def test_step_too_coarse_for_what_effects_add_is_refused(effects: dict[str, dict[str, float]]) -> None:
    with pytest.raises(ValueError, match="too coarse"):
        check_step(P, effect_numbers(effects), 1.0, 5.0e-5)
    check_step(P, effect_numbers(TYPICAL), 1.0, 5.0e-5)


def test_between_the_ends_of_a_step_lies_the_cubic() -> None:
    def cubic(t: float) -> float:
        return 1.0 - 2.0 * t + 3.0 * t**2 + 5.0 * t**3

    def slope(t: float) -> float:
        return -2.0 + 6.0 * t + 15.0 * t**2

    start, step = 0.3, 0.4
    for share in (0.0, 0.25, 0.8, 1.0):
        value = between(cubic(start), slope(start), cubic(start + step), slope(start + step), share, step)
        assert value == pytest.approx(cubic(start + share * step), rel=1.0e-14)
