"""One step for several: as exact as very fine ones, and only where nothing turns, comes taut or hangs in its play."""

import math
from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.model.composition import Physics, motor_viscosity_N_m_s_per_rad
from hil_forceps.model.linear.gains import PIECES, SHORT, SIZE, fill_all, fill_multiples
from hil_forceps.model.physics import Kind, State, kind_of, torque_constant
from hil_forceps.model.step.motion import Drive
from hil_forceps.model.step.refinement import refined_step
from hil_forceps.model.step.whole_step import decays, suits, whole_step
from hil_forceps.rig.catalogue import EFFECTS, effect
from tests.unit.model.test_closed_loop import theta_of

STEP_S, STEPS, FINE = 2.5e-4, 4, 256
EXACT = 8  # steps a sample: where more are asked, all is more exact
TIME_S = 0.7  # of drifts
STRETCH_M = 2e-6
NEVER = {"stribeck_friction", "wire_hysteresis", "electrical_lag", "actuation_delay"}
USUAL, WORST = 1e-3, {"viscous_asymmetry": 3e-3}  # of what the effect does in the step

_P = ParamSpec("_P")
_R = TypeVar("_R")


def in_python(kernel: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return the function that a kernel is compiled from; those that it calls stay compiled."""
    return cast("Callable[_P, _R]", getattr(kernel, "py_func", kernel))


def plant(entry_id: str, size: float = 0.1, **changed: float) -> tuple[Physics, Kind]:
    """Return a plant with an entry of a share of its usual size."""
    names = {
        f"{entry_id}__{item.name}": item.typical * (1.0 if item.neutral is None else size)
        for item in (effect(entry_id).parameters if entry_id else ())
    }
    p = Physics(*theta_of(**names).tolist())._replace(**changed)
    return p, kind_of(p)


def going(p: Physics, speed: float = 1.5, **changed: float) -> State:
    """Return motor and jaw on their way, the wire taut and the pulley behind the motor as it has to be."""
    lost = math.copysign(p.transmission_play_half_width_rad, speed)
    theta_j = (p.r_m * (0.6 - lost) - STRETCH_M - p.wire_slack_half_width_m) / p.r_j
    state = State(0.6, speed, theta_j, speed * p.r_m / p.r_j, 1e-8, 0.0, 0.3, 0.4, 0.5, lost, 0.02)
    return state._replace(**changed)


def drive(p: Physics, speed: float = 1.5) -> Drive:
    """Return what keeps a plain plant going as it goes, but for some load."""
    pull = p.k * STRETCH_M
    torque = p.r_m * pull + p.D_m * speed + math.copysign(p.motor_coulomb, speed)
    load = p.r_j * pull - math.copysign(p.jaw_coulomb, speed)
    current = torque / p.K_t
    return Drive(
        current, 0.0, current, torque_constant(p, TIME_S), motor_viscosity_N_m_s_per_rad(p, TIME_S), load, 1e-6
    )


def tables(p: Physics, step_s: float, steps: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    whole = np.empty((steps, SIZE))
    fill_multiples(whole, p, motor_viscosity_N_m_s_per_rad(p, 0.0), step_s)
    return whole, decays(p, steps, step_s)


def at_once(
    p: Physics,
    kind: Kind,
    x: State,
    d: Drive,
    span_s: float = STEP_S * STEPS,
    steps: int = STEPS,
    friction_N_m: float = 0.0,
) -> tuple[bool, State]:
    moves, end = in_python(whole_step)(p, kind, *tables(p, span_s / steps, steps), steps, x, d, friction_N_m)
    return bool(moves), State(*end)


def in_many(p: Physics, kind: Kind, x: State, d: Drive) -> State:
    """Return the state after as many fine steps, each by the rule for one."""
    step_s, many = STEP_S / FINE, STEPS * FINE
    gains = np.empty((SHORT + 2, SIZE))
    fill_all(gains, p, motor_viscosity_N_m_s_per_rad(p, 0.0), step_s)
    inertia = (p.I_m / step_s, p.I_j / step_s)
    kept = (math.exp(-step_s / p.wire_creep_time_constant_s), math.exp(-step_s / PIECES / p.wire_creep_time_constant_s))
    for k in range(many):
        load = d.load + d.load_slope * ((k + 0.5) / many - 0.5)
        part = d._replace(load=load, load_slope=d.load_slope / many)
        x = State(*in_python(refined_step)(p, kind, gains, inertia, kept, x, part))
    return x


@pytest.mark.parametrize("entry_id", [e.id for e in EFFECTS if e.id not in NEVER])
def test_a_sample_at_once_is_what_fine_steps_make_of_it(entry_id: str) -> None:
    p, kind = plant(entry_id)
    assert in_python(suits)(p, kind, STEPS)
    x, d = going(p), drive(p)
    assert at_once(p, kind, x, d)[0]
    moves, end = at_once(p, kind, x, d, steps=EXACT)
    assert moves
    share = WORST.get(entry_id, USUAL)
    fine, bare = in_many(p, kind, x, d), in_many(*plant(""), x, d)
    for name, a, b, without, before in zip(State._fields, end, fine, bare, x, strict=True):
        assert a == pytest.approx(b, abs=share * abs(b - without) + 1e-10 * abs(before)), name


@pytest.mark.parametrize("entry_id", ["", "jaw_gravity", "cogging", "wire_hardening", "wire_creep"])
def test_a_motor_and_a_jaw_that_no_friction_holds_may_turn_within_a_sample(entry_id: str) -> None:
    p, kind = plant(entry_id, motor_coulomb=0.0, jaw_coulomb=0.0)
    held = 1e-4  # friction that is among the torques
    x, d = going(p, omega_m_rad_per_s=2e-3, omega_j_rad_per_s=-1e-3), drive(p, 0.0)
    d = d._replace(current=d.current - 1e-5 / p.K_t)
    moves, end = at_once(p, kind, x, d, friction_N_m=held)
    fine, bare = in_many(p, kind, x, d), in_many(*plant("", motor_coulomb=0.0, jaw_coulomb=0.0), x, d)
    assert moves
    assert end.omega_m_rad_per_s * x.omega_m_rad_per_s < 0.0  # turned
    for name, a, b, without, before in zip(State._fields, end, fine, bare, x, strict=True):
        assert a == pytest.approx(b, abs=2.0 * USUAL * abs(b - without) + 1e-9 * abs(before)), name


@pytest.mark.parametrize(
    "entry_id", ["coulomb_asymmetry", "viscous_asymmetry", "presliding_friction", "jaw_presliding"]
)
def test_friction_that_knows_a_direction_leaves_turns_to_steps(entry_id: str) -> None:
    p, kind = plant(entry_id, motor_coulomb=0.0, jaw_coulomb=0.0)
    jaw = entry_id.startswith("jaw")
    x = going(p, omega_m_rad_per_s=1.5 if jaw else 0.0, omega_j_rad_per_s=0.0 if jaw else 0.3)
    assert not at_once(p, kind, x, drive(p), friction_N_m=1e-4)[0]


def test_half_the_time_leaves_far_less_than_half_the_error() -> None:
    p, kind = plant("film_friction", film_friction_level_N_m=2e-6, film_friction_speed_rad_per_s=0.5)
    x, d = going(p, 0.4), drive(p, 0.4)._replace(load_slope=0.0)
    exact = in_many(p, kind, x, d)
    moves, once = at_once(p, kind, x, d, steps=EXACT)
    first_moves, half = at_once(p, kind, x, d, 0.5 * STEP_S * STEPS, EXACT)
    second_moves, twice = at_once(p, kind, half, d, 0.5 * STEP_S * STEPS, EXACT)
    assert all((moves, first_moves, second_moves))
    apart = [abs(end.omega_m_rad_per_s - exact.omega_m_rad_per_s) for end in (once, twice)]
    assert apart[1] < 0.06 * apart[0]  # 1/16 of a step's error is left at the fourth order, twice


def test_it_is_found_as_exactly_as_so_many_steps_ask() -> None:
    p, kind = plant("film_friction", film_friction_level_N_m=1e-5, film_friction_speed_rad_per_s=0.3)
    x, d = going(p, 0.3), drive(p, 0.3)._replace(load_slope=0.0)
    exact, bare = in_many(p, kind, x, d), in_many(*plant(""), x, d)
    moves, once = at_once(p, kind, x, d)
    assert moves
    effect_of_it = abs(exact.omega_m_rad_per_s - bare.omega_m_rad_per_s)
    assert abs(once.omega_m_rad_per_s - exact.omega_m_rad_per_s) < 0.024 * effect_of_it  # 0.027 after one round
    assert not at_once(p, kind, x, d, steps=8)[0]  # too quick for that


@pytest.mark.parametrize("turns", [0.5, 1.0])
def test_what_a_parabola_does_not_follow_is_left_to_steps(turns: float) -> None:
    # Cogging that goes through half a turn from its greatest to its least value, or through a whole one and back.
    p, kind = plant("cogging")
    x = going(p)
    way = x.omega_m_rad_per_s * STEP_S * STEPS
    harmonic = 2.0 * math.pi * turns / way
    peak = 5e-5
    sine, cosine = peak * math.sin(harmonic * x.theta_m_rad), peak * math.cos(harmonic * x.theta_m_rad)
    p = p._replace(cogging_harmonic=harmonic, cogging_sine_N_m=sine, cogging_cosine_N_m=cosine)
    many = p._replace(cogging_harmonic=0.01 * harmonic)
    assert at_once(many, kind, x, drive(p))[0]
    assert not at_once(p, kind, x, drive(p))[0]


@pytest.mark.parametrize("speed", [1.5, -1.5])
def test_where_something_happens_it_is_left_to_steps(speed: float) -> None:
    p, kind = plant("jaw_gravity")
    d = drive(p, speed)
    assert at_once(p, kind, going(p, speed), d)[0]
    assert not at_once(p, kind, going(p, speed, omega_m_rad_per_s=0.0), d)[0]
    assert not at_once(p, kind, going(p, speed, omega_j_rad_per_s=0.0), d)[0]
    assert not at_once(p, kind, going(p, speed, omega_j_rad_per_s=-1e-3 * speed), d)[0]  # turns within
    slack, kind = plant("wire_slack")
    assert at_once(slack, kind, going(slack, speed), d)[0]
    loose = going(slack, speed, theta_j_rad=slack.r_m * 0.6 / slack.r_j)
    assert not at_once(slack, kind, loose, d)[0]
    play, kind = plant("transmission_play")
    assert at_once(play, kind, going(play, speed), d)[0]
    assert not at_once(play, kind, going(play, speed, lost_rad=0.0), d)[0]


@pytest.mark.parametrize("entry_id", sorted(NEVER))
def test_falling_friction_turning_wires_and_unsteady_currents_are_left_to_steps(entry_id: str) -> None:
    p, kind = plant(entry_id)
    assert not in_python(suits)(p, kind, STEPS)


def test_an_odd_number_of_steps_has_no_middle() -> None:
    assert not in_python(suits)(*plant("cogging"), 5)
    assert in_python(suits)(*plant(""), 5)
