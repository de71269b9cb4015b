"""Wake-ups, the wall clock and a watchdog beside the period; with clocks of the test's own."""

import pytest

from hil_forceps.bridge.doctor import timing
from hil_forceps.bridge.doctor.check import Check, Verdict
from hil_forceps.bridge.doctor.timing import Lateness

PERIOD_S, PERIOD_NS = 1e-3, 1_000_000


class LateClock:
    """Wakes late by what it is told, in turn."""

    def __init__(self, *late_ns: int) -> None:
        self._now_ns = 0
        self._late_ns = late_ns
        self._ticks = 0
        self.stepped_ns = 0

    def now_ns(self) -> int:
        return self._now_ns

    def wall_ns(self) -> int:
        return 10**18 + self._now_ns + (self.stepped_ns if self._ticks else 0)

    def sleep_until_ns(self, time_ns: int) -> None:
        self._now_ns = max(self._now_ns, time_ns + self._late_ns[self._ticks % len(self._late_ns)])
        self._ticks += 1


def looked(measured: Lateness) -> dict[str, Check]:
    return {check.id: check for check in timing.checks(measured, PERIOD_S)}


def test_each_wake_up_of_a_second_is_measured() -> None:
    clock = LateClock(10_000, 30_000)
    measured = timing.measure(clock, clock.wall_ns, PERIOD_S)
    assert len(measured.late_s) == 1000
    assert measured.late_s[0] == pytest.approx(10e-6)
    assert measured.late_s[-1] == pytest.approx(30e-6)
    assert measured.step_s == 0.0
    assert {check.verdict for check in looked(measured).values()} == {Verdict.OK}


@pytest.mark.parametrize(
    ("late_ns", "verdict"),
    [
        ((*[1_000] * 199, 1_500_000), Verdict.WARN),  # one in 200
        ((*[1_000] * 49, 1_500_000), Verdict.FAIL),  # one in 50
        ((999_000,), Verdict.OK),
    ],
)
def test_wake_ups_later_than_a_period(late_ns: tuple[int, ...], verdict: Verdict) -> None:
    measured = Lateness(tuple(sorted(each * 1e-9 for each in late_ns * (1000 // len(late_ns)))), 0.0, 1.0)
    check = looked(measured)["timing.wake_up"]
    assert check.verdict is verdict
    assert bool(check.remedy) == (verdict is not Verdict.OK)


@pytest.mark.parametrize(
    ("step_ns", "verdict"), [(590_000, Verdict.OK), (-5_000_000, Verdict.WARN), (10**9, Verdict.WARN)]
)
def test_a_wall_clock_that_steps_is_warned_of(step_ns: int, verdict: Verdict) -> None:
    clock = LateClock(0)
    clock.stepped_ns = step_ns
    assert looked(timing.measure(clock, clock.wall_ns, PERIOD_S))["timing.clock_steps"].verdict is verdict


@pytest.mark.parametrize(
    ("watchdog_s", "late_s", "verdict"),
    [
        (0.02, 1e-4, Verdict.OK),
        (0.0029, 0.0, Verdict.FAIL),
        (0.0031, 2e-4, Verdict.WARN),
        (0.0031, 1e-5, Verdict.OK),
        (0.0, 0.0, Verdict.FAIL),
        (None, 0.0, Verdict.UNKNOWN),
    ],
)
def test_a_watchdog_leaves_room_for_a_late_tick(watchdog_s: float | None, late_s: float, verdict: Verdict) -> None:
    check = timing.watchdog(watchdog_s, "by the drive", PERIOD_S, late_s)
    assert check.verdict is verdict
    assert bool(check.remedy) == (verdict in {Verdict.FAIL, Verdict.WARN})
