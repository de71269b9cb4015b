"""Travel within 250 ms of real time."""

import random

import pytest

from hil_forceps.control.gate.verdicts import Bounds
from hil_forceps.control.gate.window import WINDOW_NS, WINDOW_PARTS, TravelWindow

MS = 1_000_000
PART_NS = 15_625_000
WIDE: Bounds = (-10.0, 10.0)


def window_of(*seen: tuple[float, int]) -> TravelWindow:
    window = TravelWindow(0.5)
    for position_rad, now_ns in seen:
        window.see(position_rad, now_ns)
    return window


def test_it_is_250_ms_in_sixteen_parts() -> None:
    assert (WINDOW_NS, WINDOW_PARTS, PART_NS * WINDOW_PARTS) == (250 * MS, 16, WINDOW_NS)


def test_without_a_past_the_bounds_stay_as_they_are() -> None:
    window = window_of()
    assert window.narrow(WIDE, 0) is WIDE
    window.see(1.0, 0)
    window.restart()
    assert window.narrow(WIDE, 0) is WIDE


def test_both_ends_follow_the_extremes() -> None:
    assert window_of((1.0, 0)).narrow(WIDE, MS) == (0.5, 1.5)
    assert window_of((1.0, 0), (1.25, MS), (1.125, 2 * MS)).narrow(WIDE, 3 * MS) == (0.75, 1.5)
    assert window_of((1.0, 0), (0.75, MS), (0.875, 2 * MS)).narrow(WIDE, 3 * MS) == (0.5, 1.25)


def test_extremes_in_other_parts_count_too() -> None:
    window = window_of((1.0, 0), (1.25, 100 * MS), (1.125, 200 * MS))
    assert window.narrow(WIDE, 240 * MS) == (0.75, 1.5)


@pytest.mark.parametrize("bounds", [(0.75, 1.25), (0.9, 1.1), (0.75, 10.0), (-10.0, 1.25)])
def test_narrower_bounds_stay(bounds: Bounds) -> None:
    low, high = window_of((1.0, 0)).narrow(bounds, MS)
    assert (low, high) == (max(0.5, bounds[0]), min(1.5, bounds[1]))


@pytest.mark.parametrize(
    ("now_ns", "counts"),
    [(WINDOW_NS - 1, True), (WINDOW_NS, True), (WINDOW_NS + PART_NS - 1, True), (WINDOW_NS + PART_NS, False)],
)
def test_a_part_counts_until_all_of_it_is_past(now_ns: int, counts: bool) -> None:
    window = window_of((1.0, 0), (1.25, WINDOW_NS - 1))
    assert window.narrow(WIDE, now_ns) == ((0.75, 1.5) if counts else (0.75, 1.75))


def test_memory_is_bounded_and_never_less_than_the_window() -> None:
    chance, window, seen = random.Random(3), TravelWindow(0.5), []
    now_ns = 0
    for _ in range(5000):
        now_ns += chance.randrange(1, 20 * MS)
        position = chance.uniform(-0.2, 0.2)
        window.see(position, now_ns)
        seen.append((now_ns, position))
        low, high = window.narrow(WIDE, now_ns)
        last = [angle for time_ns, angle in seen[-400:] if now_ns - time_ns <= WINDOW_NS]
        longer = [angle for time_ns, angle in seen[-400:] if now_ns - time_ns <= WINDOW_NS + PART_NS]
        assert max(longer) - 0.5 >= low >= max(last) - 0.5
        assert min(longer) + 0.5 <= high <= min(last) + 0.5
    assert len(window._parts) <= WINDOW_PARTS + 1
