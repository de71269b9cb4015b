"""The drive's law, term by term, against the words of the rig file's description."""

import math
from collections.abc import Iterable

import pytest

from firmware_protocol.scales import ANGLE_LSB_RAD
from virtual_bus.plant.position_loop import LoopParameters, LoopState, loop_step

REST = LoopState(0.0, 0.0, 0.0)
EXAMPLE = LoopParameters(1.0e-3, 1.2, 15.0, 0.006, 150.0, 1.0)


def raw(angle_rad: float) -> int:
    return round(angle_rad / ANGLE_LSB_RAD)


def law(p: LoopParameters, samples: Iterable[tuple[float, float]]) -> list[float]:
    """The law again in plain Python on (reference, angle) in rad, from rest at the first angle."""
    integral = speed = 0.0
    previous: float | None = None
    currents = []
    alpha = 1.0 - math.exp(-2.0 * math.pi * p.derivative_cutoff_Hz * p.sample_time_s)
    for reference, theta in samples:
        error = reference - theta
        integral += error * p.sample_time_s
        if p.ki_A_per_rad_s:
            bound = p.current_limit_A / p.ki_A_per_rad_s
            integral = max(-bound, min(bound, integral))
        speed += alpha * ((theta - (theta if previous is None else previous)) / p.sample_time_s - speed)
        previous = theta
        wanted = p.kp_A_per_rad * error + p.ki_A_per_rad_s * integral - p.kd_A_s_per_rad * speed
        currents.append(max(-p.current_limit_A, min(p.current_limit_A, wanted)))
    return currents


def run(p: LoopParameters, samples: Iterable[tuple[float, float]]) -> list[float]:
    currents: list[float] = []
    state: LoopState | None = None
    for reference, theta in samples:
        if state is None:
            state, _ = loop_step(REST, p, False, 0, raw(theta))
        state, current = loop_step(state, p, True, raw(reference), raw(theta))
        currents.append(current)
    return currents


def on_wire(angle_rad: float) -> float:
    return raw(angle_rad) * ANGLE_LSB_RAD


SAMPLES = [(on_wire(0.3 * math.sin(0.05 * k)), on_wire(0.2 * math.sin(0.03 * k + 1.0))) for k in range(400)]


@pytest.mark.parametrize(
    "p",
    [
        EXAMPLE,
        EXAMPLE._replace(ki_A_per_rad_s=0.0),
        EXAMPLE._replace(kp_A_per_rad=0.0, kd_A_s_per_rad=0.0, ki_A_per_rad_s=200.0),
        EXAMPLE._replace(sample_time_s=1.0e-4, derivative_cutoff_Hz=2000.0),
        EXAMPLE._replace(current_limit_A=0.05),
    ],
)
def test_law_on_a_long_path(p: LoopParameters) -> None:
    assert run(p, SAMPLES) == pytest.approx(law(p, SAMPLES), abs=1.0e-12)


def cascade(
    gains: tuple[float, float, float], p: LoopParameters, samples: Iterable[tuple[float, float]]
) -> list[float]:
    """A position loop with gain K around a velocity loop with gains K_v and K_i, as drives' manuals write it."""
    position_per_s, velocity, integral_gain = gains
    speed, integral, currents = 0.0, 0.0, []
    previous: float | None = None
    alpha = 1.0 - math.exp(-2.0 * math.pi * p.derivative_cutoff_Hz * p.sample_time_s)
    for reference, theta in samples:
        speed += alpha * ((theta - (theta if previous is None else previous)) / p.sample_time_s - speed)
        previous = theta
        lacking = position_per_s * (reference - theta) - speed
        bound = p.current_limit_A / integral_gain
        integral = max(-bound, min(bound, integral + lacking * p.sample_time_s))
        currents.append(max(-p.current_limit_A, min(p.current_limit_A, velocity * lacking + integral_gain * integral)))
    return currents


@pytest.mark.parametrize("limit_A", [1.0, 0.08])
def test_a_position_loop_around_a_velocity_loop(limit_A: float) -> None:
    position_per_s, velocity, integral_gain = 120.0, 0.01, 0.2
    p = LoopParameters(
        1.0e-3,
        position_per_s * velocity,
        position_per_s * integral_gain,
        velocity,
        150.0,
        limit_A,
        cascade_time_s=1.0 / position_per_s,
    )
    wanted = cascade((position_per_s, velocity, integral_gain), p, SAMPLES)
    assert run(p, SAMPLES) == pytest.approx(wanted, abs=1.0e-12)
    assert wanted != pytest.approx(law(p, SAMPLES), abs=1e-2)


def test_proportional_and_integral_of_one_sample() -> None:
    p = EXAMPLE._replace(kd_A_s_per_rad=0.0)
    _, current = loop_step(REST, p, True, raw(0.1), 0)
    assert current == pytest.approx(1.2 * 0.1 + 15.0 * 0.1 * 1.0e-3, rel=1.0e-5)


def test_derivative_acts_on_the_measured_angle_only() -> None:
    p = EXAMPLE._replace(kp_A_per_rad=0.0, ki_A_per_rad_s=0.0)
    state, jump = loop_step(REST, p, True, raw(0.5), 0)
    assert jump == 0.0
    _, moving = loop_step(state, p, True, raw(0.5), raw(0.001))
    alpha = 1.0 - math.exp(-2.0 * math.pi * 0.15)
    assert moving == pytest.approx(-0.006 * alpha * 1.0, rel=1.0e-4)


def test_integral_alone_never_asks_for_more_than_the_limit_and_lets_go_at_once() -> None:
    state = REST
    for _ in range(5000):
        state, current = loop_step(state, EXAMPLE, True, raw(1.0), 0)
        assert abs(EXAMPLE.ki_A_per_rad_s * state.integral_rad_s) <= EXAMPLE.current_limit_A * (1.0 + 1.0e-12)
        assert current <= EXAMPLE.current_limit_A
    assert 15.0 * state.integral_rad_s == pytest.approx(1.0)
    state, _ = loop_step(state, EXAMPLE, True, raw(-1.0), 0)
    assert 15.0 * state.integral_rad_s < 1.0


def test_inactive_means_no_current_and_no_memory() -> None:
    state = LoopState(0.05, 3.0, 12.0)
    state, current = loop_step(state, EXAMPLE, False, raw(1.0), 777)
    assert current == 0.0
    assert state == LoopState(0.0, 0.0, 777.0)


def test_start_on_the_measured_angle_is_without_a_kick() -> None:
    theta = raw(1.0996)
    state, _ = loop_step(LoopState(0.06, 40.0, 0.0), EXAMPLE, False, 0, theta)
    _, current = loop_step(state, EXAMPLE, True, theta, theta)
    assert current == 0.0
