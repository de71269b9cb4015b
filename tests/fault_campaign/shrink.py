"""From a schedule that fails to a short one that still fails in the same way: delta debugging (Zeller, ddmin)."""

from collections.abc import Callable, Iterator

from tests.fault_campaign.schedule import Fault, Schedule

MAX_RUNS = 300  # some ten seconds
_MS = 1_000_000

Fails = Callable[[Schedule], bool]


def shrink(schedule: Schedule, fails: Fails) -> Schedule:
    """Return the least schedule found for which `fails`; fewer faults first, then shorter, smaller, rounder ones.

    ValueError where the schedule itself doesn't fail.
    """
    if not fails(schedule):
        raise ValueError("a schedule that doesn't fail can't be shrunk")
    runs, best, is_less = 0, schedule, True
    while is_less and runs < MAX_RUNS:
        is_less = False
        for candidate in _simpler(best):
            runs += 1
            if fails(candidate):
                best, is_less = candidate, True
                break
            if runs >= MAX_RUNS:
                break
    return best


def _simpler(schedule: Schedule) -> Iterator[Schedule]:
    """Yield simpler schedules, the boldest first."""
    faults = schedule.faults
    for place in range(len(faults)):
        yield schedule._replace(faults=faults[:place] + faults[place + 1 :])
    for place, fault in enumerate(faults):
        for simpler in _simpler_faults(fault):
            yield schedule._replace(faults=(*faults[:place], simpler, *faults[place + 1 :]))


def _simpler_faults(fault: Fault) -> Iterator[Fault]:
    if fault.duration_ns >= 2 * _MS:
        yield fault._replace(duration_ns=fault.duration_ns // 2 // _MS * _MS)
    rounded = float(f"{fault.size / 2.0:.2g}")
    if abs(fault.size) > 1e-4 and rounded != fault.size:
        yield fault._replace(size=rounded)
    for step_ns in (10 * _MS, _MS):
        if fault.begin_ns % step_ns:
            yield fault._replace(begin_ns=fault.begin_ns // step_ns * step_ns)
    for digits in (1, 2):
        if (size := float(f"{fault.size:.{digits}g}")) != fault.size:
            yield fault._replace(size=size)
