"""Cyclic messages of one drive, and of two with one id."""

import numpy as np
import pytest

from hil_forceps.drives.supervision.message_rate import MIN_INTERVALS, WINDOW_NS, MessageRate

MS = 1_000_000


def counted(arrivals_ms: list[float], period_ms: float) -> MessageRate:
    rate = MessageRate(round(period_ms * MS))
    for at_ms in arrivals_ms:
        rate.receive(round(at_ms * MS))
    return rate


@pytest.mark.parametrize("period_ms", [1.0, 10.0, 100.0])
def test_one_drive_and_two_are_told_apart_whatever_the_jitter(period_ms: float) -> None:
    rng = np.random.default_rng(7)
    one = np.arange(0.0, 30.0 * max(period_ms, 10.0), period_ms)
    jittered = np.sort(one + rng.uniform(0.0, 5.0, one.size)).tolist()
    two = sorted([*one, *(one + 0.3 * period_ms)])
    assert counted(jittered, period_ms).is_one_drive is True
    assert counted(two, period_ms).is_one_drive is False


def test_nothing_is_said_before_a_whole_window() -> None:
    few = [10.0 * n for n in range(MIN_INTERVALS)]
    assert few[-1] * MS < WINDOW_NS
    assert counted(few, 10.0).is_one_drive is None


def test_a_slower_drive_is_one_drive() -> None:
    assert counted([10.0 * n for n in range(20)], 1.0).is_one_drive is True
