"""The position loop of the reference firmware against the world's: the same law, single precision against double."""

import ctypes
import itertools
import math
import random

import pytest

from tests.firmware_library import CLoopConfig, dirty_memory, library
from virtual_bus.plant.position_loop import LoopParameters, LoopState, loop_step

RIG = LoopParameters(1.0e-3, 1.2, 15.0, 6.0e-3, 150.0, 1.0)
GAINS = (
    RIG,
    RIG._replace(ki_A_per_rad_s=0.0),
    RIG._replace(kd_A_s_per_rad=0.0, derivative_cutoff_Hz=0.0),
    RIG._replace(kp_A_per_rad=0.0, kd_A_s_per_rad=0.0, current_limit_A=0.05),
    RIG._replace(sample_time_s=1.0e-4, derivative_cutoff_Hz=5_000.0),
    RIG._replace(current_limit_A=0.0),
    RIG._replace(cascade_time_s=5.0e-3),
    RIG._replace(kp_A_per_rad=0.0, kd_A_s_per_rad=0.0, cascade_time_s=0.05),
)


class CLoop:
    """hfp_loop."""

    def __init__(self, p: LoopParameters, theta_raw: int) -> None:
        self._lib = library()
        self._bytes = dirty_memory("loop")
        config = CLoopConfig(*p)
        self.valid = bool(self._lib.hfp_loop_init(self._bytes, ctypes.byref(config), ctypes.c_int32(theta_raw)))

    def step(self, active: bool, reference_raw: int, theta_raw: int) -> float:
        return float(self._lib.hfp_loop_step(self._bytes, active, reference_raw, theta_raw))


@pytest.mark.parametrize("p", GAINS)
@pytest.mark.parametrize("spread", [3, 2_000, 300_000, 100_000_000])
def test_same_current_as_the_world(p: LoopParameters, spread: int) -> None:
    """Ten thousand samples of a wandering angle, with pauses; within 2 parts in a million of limit and terms."""
    rng = random.Random(spread)
    theta = rng.randrange(-(1 << 33), 1 << 33)
    ours, state = CLoop(p, theta), LoopState(0.0, 0.0, float(theta))
    reference, active, moving, worst = theta, False, 0, 0.0
    for _ in range(10_000):
        if rng.random() < 0.01:
            active = not active
        if rng.random() < 0.05:
            reference = theta + rng.randrange(-spread, spread + 1)
        theta += rng.randrange(-spread, spread + 1)
        state, wanted = loop_step(state, p, active, reference, theta)
        got = ours.step(active, reference, theta)
        size = 0.0
        if active:
            error = abs(reference - theta) * 3.75e-7
            size = p.kp_A_per_rad * error + p.ki_A_per_rad_s * abs(state.integral_rad_s)
            size += p.kd_A_s_per_rad * abs(state.speed_rad_per_s)
            size += p.ki_A_per_rad_s * p.cascade_time_s * abs(state.speed_rad_per_s) * p.sample_time_s
            moving += 0.0 < abs(wanted) < p.current_limit_A
        worst = max(worst, abs(got - wanted) / (size + p.current_limit_A + 1e-30))
    assert worst < 2.0e-6
    assert moving > 100 or spread == 100_000_000 or p.current_limit_A < 0.1


def test_the_first_sample_remembers_nothing() -> None:
    _, wanted = loop_step(LoopState(0.0, 0.0, 7.0), RIG, True, 50_000, 7)
    assert CLoop(RIG, 7).step(True, 50_000, 7) == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("cutoff_Hz", [0.0, 1e-3, 4.9, 5.0, 80.0, 150.0, 1e3, 5e3, 5.1e3, 1e6])
def test_the_pole_of_the_speed_filter(cutoff_Hz: float) -> None:
    """After one step of the angle at rest the derivative shows the filter's gain alone, within a millionth."""
    p = RIG._replace(kp_A_per_rad=0.0, ki_A_per_rad_s=0.0, derivative_cutoff_Hz=cutoff_Hz, current_limit_A=1e3)
    loop, state = CLoop(p, 0), LoopState(0.0, 0.0, 0.0)
    _, wanted = loop_step(state, p, True, 0, 1 << 20)
    assert loop.step(True, 0, 1 << 20) == pytest.approx(wanted, rel=1e-6)


def test_small_errors_are_never_lost_in_the_integral() -> None:
    """One unit for 2**24 + n samples would stand still in single precision: here it counts on."""
    p = RIG._replace(kp_A_per_rad=0.0, kd_A_s_per_rad=0.0)
    loop = CLoop(p, 0)
    first = [loop.step(True, 1 << 24, 0) for _ in range(9)][-1]
    for _ in range(50_000):
        last = loop.step(True, 1, 0)
    step_A = 15.0 * 1.0e-3 * 2.0 * math.pi / 2**24
    assert last - first == pytest.approx(50_000 * step_A, rel=1e-3)


def test_the_integral_stops_at_the_limit_and_comes_back_at_once() -> None:
    p = RIG._replace(kp_A_per_rad=0.0, kd_A_s_per_rad=0.0)
    for sign in (1, -1):
        loop = CLoop(p, 0)
        for _ in range(1_000):
            current = loop.step(True, sign << 22, 0)
        assert current == pytest.approx(sign * 1.0, rel=1e-6)
        assert abs(loop.step(True, -sign << 22, 0)) < 1.0


def test_turning_past_the_wrap_changes_nothing() -> None:
    """HFP-053: the same motion about 0 and about ±128 rev gives the same currents."""
    rng = random.Random(5)
    here, there = CLoop(RIG, 0), CLoop(RIG, 1 << 31)
    theta = 0
    for _ in range(2_000):
        theta += rng.randrange(-1_000, 1_000)
        reference = theta + rng.randrange(-10_000, 10_000)
        wanted = here.step(True, reference, theta)
        assert there.step(True, reference + (1 << 31), theta + (1 << 31)) == wanted


def test_the_motor_starts_without_a_kick() -> None:
    fresh, used = CLoop(RIG, 500), CLoop(RIG, 0)
    for theta in range(0, 500, 100):
        used.step(True, 1 << 22, theta)
    assert used.step(False, 0, 500) == 0.0
    assert fresh.step(False, 0, 500) == 0.0
    for theta in (500, 500, 510):
        assert used.step(True, 700, theta) == fresh.step(True, 700, theta)


def test_extremes_stay_finite() -> None:
    p = RIG._replace(ki_A_per_rad_s=1e-30, kp_A_per_rad=1e3)
    loop = CLoop(p, 0)
    for reference, theta in itertools.product((-(1 << 31), 0, (1 << 31) - 1), repeat=2):
        for _ in range(10):
            assert abs(loop.step(True, reference, theta)) <= p.current_limit_A


def test_settings_that_make_no_sense_are_refused() -> None:
    assert CLoop(RIG, 0).valid
    assert CLoop(RIG._replace(**dict.fromkeys(RIG._fields[1:], 0.0)), 0).valid
    assert not CLoop(RIG._replace(sample_time_s=0.0), 0).valid
    for name in RIG._fields:
        for value in (-1e-9, math.nan, math.inf):
            assert not CLoop(RIG._replace(**{name: value}), 0).valid, (name, value)
