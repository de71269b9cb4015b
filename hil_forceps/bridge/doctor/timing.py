"""How late a loop of the rig's period wakes here, whether the wall clock steps, and what a watchdog allows."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple

from hil_forceps.bridge.doctor.check import Check, Verdict, unknown
from hil_forceps.bridge.ports import Clock
from hil_forceps.drives.compatibility.lint import MIN_WATCHDOG_PERIODS

MEASURED_TIME_S: Final = 1.0
# What the kernel turns the clock by, at most, while it disciplines it (MAXFREQ, 500 ppm); more is a step.
MAX_CLOCK_SLEW_s_per_s: Final = 500e-6
MAX_READING_GAP_S: Final = 1e-4  # between the readings of both clocks, where the process is interrupted
_P99: Final = 0.99


class Lateness(NamedTuple):
    """What was measured."""

    late_s: tuple[float, ...]  # of each wake-up, sorted
    step_s: float  # by which the wall clock went away from the monotonic one
    lasted_s: float


def measure(clock: Clock, wall_ns: Callable[[], int], period_s: float, duration_s: float = MEASURED_TIME_S) -> Lateness:
    """Sleep to due times as the service does, and note how late each wake-up is."""
    period_ns = round(period_s * 1e9)
    begin_ns, begin_wall_ns = clock.now_ns(), wall_ns()
    late_s = []
    for tick in range(1, max(1, math.ceil(duration_s / period_s)) + 1):
        due_ns = begin_ns + tick * period_ns
        clock.sleep_until_ns(due_ns)
        late_s.append((clock.now_ns() - due_ns) * 1e-9)
    end_ns, end_wall_ns = clock.now_ns(), wall_ns()
    step_ns = (end_wall_ns - begin_wall_ns) - (end_ns - begin_ns)
    return Lateness(tuple(sorted(late_s)), step_ns * 1e-9, (end_ns - begin_ns) * 1e-9)


def checks(measured: Lateness, period_s: float) -> Iterator[Check]:
    """Judge the wake-ups against the period, and the wall clock against the monotonic one."""
    yield _wake_up(measured.late_s, period_s)
    yield _steps(measured)


def _wake_up(late_s: Sequence[float], period_s: float) -> Check:
    name, what = "timing.wake_up", f"how late {len(late_s)} wake-ups were, {period_s * 1e3:g} ms apart"
    worst_s, p99_s = late_s[-1], late_s[math.ceil(_P99 * len(late_s)) - 1]
    text = f"p99 {p99_s * 1e6:.0f} µs, worst {worst_s * 1e6:.0f} µs"
    remedy = "chrt --fifo 50 hil-forceps run ...; end other programs, or use a longer bench.host_period_s"
    if p99_s >= period_s:
        text += ": at least one tick in a hundred is missed"
        return Check(name, what, Verdict.FAIL, text, remedy, worst_s * 1e6, "µs")
    if worst_s >= period_s:
        return Check(name, what, Verdict.WARN, f"{text}: single ticks are missed", remedy, worst_s * 1e6, "µs")
    return Check(name, what, Verdict.OK, text, "", worst_s * 1e6, "µs")


def _steps(measured: Lateness) -> Check:
    name, what = "timing.clock_steps", "whether the wall clock stepped during the measurement"
    allowed_s = MAX_CLOCK_SLEW_s_per_s * measured.lasted_s + MAX_READING_GAP_S
    text = f"{measured.step_s * 1e3:+.3f} ms in {measured.lasted_s:.2g} s"
    if abs(measured.step_s) <= allowed_s:
        return Check(name, what, Verdict.OK, text, "", measured.step_s * 1e3, "ms")
    text += ": frames get their stamps from it, so the age of samples is wrong"
    remedy = "chronyc tracking, or timedatectl timesync-status; wait until the clock no longer steps"
    return Check(name, what, Verdict.WARN, text, remedy, measured.step_s * 1e3, "ms")


def watchdog(watchdog_s: float | None, whose: str, period_s: float, worst_late_s: float) -> Check:
    """Judge a watchdog's time against the host's period, and what is left behind the worst wake-up; `whose` word."""
    name, what = "timing.watchdog", "watchdog of the drive, compared with the period of the host"
    if watchdog_s is None:
        return unknown(name, what, "neither the drive nor the rig has a value for it")
    text = f"{watchdog_s * 1e3:g} ms {whose}, {watchdog_s / period_s:.1f} periods"
    least_s = MIN_WATCHDOG_PERIODS * period_s
    if watchdog_s <= 0.0:
        text = f"off {whose}: nothing stops the motor if this program or the bus fails"
        return Check(name, what, Verdict.FAIL, text, f"set it to {least_s * 1e3:g} ms or more", 0.0, "ms")
    if watchdog_s < least_s:
        text += f": one late tick stops the motor; at least {MIN_WATCHDOG_PERIODS} are needed"
        remedy = f"set the watchdog to {least_s * 1e3:g} ms or more, or use a shorter bench.host_period_s"
        return Check(name, what, Verdict.FAIL, text, remedy, watchdog_s * 1e3, "ms")
    if watchdog_s < least_s + worst_late_s:
        worst = f"as late as the worst measured here ({worst_late_s * 1e3:.2g} ms)"
        text += f"; fewer than {MIN_WATCHDOG_PERIODS} remain after a wake-up {worst}"
        remedy = "see timing.wake_up, or use a longer watchdog"
        return Check(name, what, Verdict.WARN, text, remedy, watchdog_s * 1e3, "ms")
    return Check(name, what, Verdict.OK, text, "", watchdog_s * 1e3, "ms")
