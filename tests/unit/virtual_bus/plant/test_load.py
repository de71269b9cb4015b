"""Load profiles: the paper's, general ones, and what happens exactly at an edge."""

import math

import pytest

from virtual_bus.plant.load import load_at, paper_load, piecewise_linear, segment_of

S = 1_000_000_000


@pytest.mark.parametrize(
    ("simulation", "time_ns", "torque_N_m"),
    [
        (0, 12 * S, 0.0),
        (1, -5 * S, 0.0),
        (1, 10 * S, 0.0),
        (1, 12 * S + S // 2, 1.0e-3),
        (1, 15 * S, 2.0e-3),
        (1, 20 * S, 2.0e-3),
        (2, 0, 0.0),
        (2, 10 * S - 1, 0.0),
        (2, 10 * S, 2.0e-3),
        (2, 12 * S + S // 2 - 1, 2.0e-3),
        (2, 12 * S + S // 2, 0.0),
        (2, 15 * S - 1, 0.0),
        (2, 15 * S, 2.0e-3),
        (2, 17 * S + S // 2, 0.0),
        (2, 20 * S, 0.0),
    ],
)
def test_paper_loads(simulation: int, time_ns: int, torque_N_m: float) -> None:
    assert paper_load(simulation).torque_at(time_ns) == pytest.approx(torque_N_m, abs=1.0e-12)


def test_there_is_no_third_simulation() -> None:
    with pytest.raises(ValueError, match="simulations 1 and 2"):
        paper_load(3)


def test_ends_hold_and_a_step_counts_from_its_instant() -> None:
    load = piecewise_linear([1.0, 2.0, 2.0, 3.0], [1.0, 2.0, -5.0, -6.0])
    assert load.torque_at(-(1 << 62)) == 1.0
    assert load.torque_at(3 * S // 2) == 1.5
    assert load.torque_at(2 * S - 1) == pytest.approx(2.0)
    assert load.torque_at(2 * S) == -5.0
    assert load.torque_at(1 << 62) == -6.0


def test_line_before_a_step_ends_at_its_own_value() -> None:
    load = piecewise_linear([1.0, 2.0, 2.0], [1.0, 2.0, -5.0])
    segment = segment_of(load.time_ns, S)
    assert load_at(load.time_ns, load.torque_N_m, segment, 2 * S) == 2.0


def test_of_three_breakpoints_at_one_time_the_last_counts() -> None:
    load = piecewise_linear([1.0, 1.0, 1.0], [0.0, 9.0, 3.0])
    assert load.torque_at(S) == 3.0


@pytest.mark.parametrize(
    ("times", "torques", "words"),
    [
        ([], [], "at least one"),
        ([0.0, 1.0], [0.0], "as many times as torques"),
        ([1.0, 0.5], [0.0, 0.0], "must not decrease"),
        ([0.0, math.nan], [0.0, 0.0], "finite"),
        ([0.0, 1.0], [0.0, math.inf], "finite"),
        ([1.0e10], [0.0], "within 1e9 s"),
    ],
)
def test_what_is_no_profile_is_refused(times: list[float], torques: list[float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        piecewise_linear(times, torques)


def test_a_profile_does_not_change_with_the_lists_it_was_made_of() -> None:
    torques = [0.0, 1.0]
    load = piecewise_linear([0.0, 1.0], torques)
    torques[1] = 5.0
    assert load.torque_at(S) == 1.0
    with pytest.raises(ValueError, match="read-only"):
        load.torque_N_m[0] = 1.0
