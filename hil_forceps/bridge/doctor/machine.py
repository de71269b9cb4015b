"""How punctual this machine can be: scheduling class, timer slack, frequency of its cores, its clocks."""

import os
from collections.abc import Iterator
from typing import Final

from hil_forceps.bridge.doctor.check import Check, Verdict, unknown, why
from hil_forceps.bridge.doctor.reads import Reads
from hil_forceps.bridge.links.adapters import LinkSpec

_CLASSES: Final = {
    os.SCHED_OTHER: "SCHED_OTHER",
    os.SCHED_FIFO: "SCHED_FIFO",
    os.SCHED_RR: "SCHED_RR",
    os.SCHED_BATCH: "SCHED_BATCH",
    os.SCHED_IDLE: "SCHED_IDLE",
    6: "SCHED_DEADLINE",
}
_REAL_TIME: Final = frozenset({os.SCHED_FIFO, os.SCHED_RR, 6})
# Read over a bus or counted by interrupts, so that reading the time takes a microsecond and more
# (Documentation/timers/timekeeping.rst of the kernel); all others are a register of the processor or of its hypervisor.
_SLOW_SOURCES: Final = frozenset({"hpet", "acpi_pm", "jiffies", "refined-jiffies", "pit"})
_CPUS: Final = "/sys/devices/system/cpu"
_SOURCE: Final = "/sys/devices/system/clocksource/clocksource0/current_clocksource"
_SLACK: Final = "/proc/self/timerslack_ns"
_REAL_TIME_LINE: Final = (
    "chrt --fifo 50 hil-forceps run ... (if not permitted: `$USER - rtprio 50` in /etc/security/limits.conf)"
)


def checks(reads: Reads) -> Iterator[Check]:
    """Look at the machine."""
    yield _scheduling(reads)
    yield _timer_slack(reads)
    yield _governor(reads)
    yield _isolated_cores(reads)
    yield _clock_source(reads)
    yield _clock(reads)


def _scheduling(reads: Reads) -> Check:
    name, what = "machine.scheduling", "scheduling class of a process that is started here"
    try:
        policy, priority = reads.scheduling()
    except OSError as error:
        return unknown(name, what, why(error))
    text = _CLASSES.get(policy, f"policy {policy}")
    if policy in _REAL_TIME:
        return Check(name, what, Verdict.OK, f"{text}, priority {priority}", "", float(priority), "priority")
    text += ": other processes can delay the loop"
    return Check(name, what, Verdict.WARN, text, _REAL_TIME_LINE)


def _timer_slack(reads: Reads) -> Check:
    name, what = "machine.timer_slack", "how late the kernel may wake a sleeping process (prctl PR_SET_TIMERSLACK)"
    try:
        slack_ns = int(reads.text(_SLACK))
    except OSError as error:
        return unknown(name, what, why(error))
    except ValueError:
        return unknown(name, what, f"{_SLACK} contains no number")
    spin_ns = LinkSpec().spin_ns
    text = f"{slack_ns / 1e3:g} µs; the loop polls for the last {spin_ns / 1e3:g} µs"
    if slack_ns <= spin_ns:
        return Check(name, what, Verdict.OK, text, "", slack_ns / 1e3, "µs")
    remedy = "start it from another shell: the slack is inherited, and the kernel's default is 50 µs"
    return Check(name, what, Verdict.WARN, text, remedy, slack_ns / 1e3, "µs")


def _governor(reads: Reads) -> Check:
    name, what = "machine.governor", "whether the cores have a constant frequency (cpufreq)"
    governors: dict[str, str] = {}
    try:
        for core in reads.names(_CPUS):
            if core.removeprefix("cpu").isdecimal():
                governors[core] = reads.text(f"{_CPUS}/{core}/cpufreq/scaling_governor")
    except OSError as error:
        return unknown(name, what, why(error))
    if not governors:
        return unknown(name, what, f"{_CPUS} lists no core")
    others = sorted({governor for governor in governors.values() if governor != "performance"})
    if not others:
        return Check(name, what, Verdict.OK, f"performance on {len(governors)} cores")
    text = f"{', '.join(others)}: an idle core lowers its frequency, and is slow when a sample arrives"
    return Check(name, what, Verdict.WARN, text, "sudo cpupower frequency-set -g performance")


def _isolated_cores(reads: Reads) -> Check:
    name, what = "machine.cores", "whether isolated cores (isolcpus) are used"
    try:
        text, allowed = reads.text(f"{_CPUS}/isolated"), reads.cores()
    except OSError as error:
        return unknown(name, what, why(error))
    isolated = parse_cores(text)
    if isolated is None:
        return unknown(name, what, f"{_CPUS}/isolated contains {text[:40]!r}, which is not a list of cores")
    if not isolated:
        return Check(name, what, Verdict.OK, f"no core is isolated; this process may use {len(allowed)}")
    if allowed <= isolated:
        return Check(name, what, Verdict.OK, f"this process runs on {_listed(allowed)}, which is isolated")
    text = f"{_listed(isolated)} is isolated, but this process may run on {_listed(allowed)}"
    return Check(name, what, Verdict.WARN, text, f"taskset -c {min(isolated)} hil-forceps run ...")


def parse_cores(text: str) -> frozenset[int] | None:
    """Return the cores of a kernel's list as 2-3,6; None where it is none."""
    cores: set[int] = set()
    for part in filter(None, text.strip().split(",")):
        first, dash, last = part.partition("-")
        ends = (first, last if dash else first)
        if not all(end.isdecimal() and len(end) < 6 for end in ends):
            return None
        cores.update(range(int(ends[0]), int(ends[1]) + 1))
    return frozenset(cores)


def _listed(cores: frozenset[int]) -> str:
    return "core " + ",".join(map(str, sorted(cores)))


def _clock_source(reads: Reads) -> Check:
    name, what = "machine.clock_source", "clock source of the kernel"
    try:
        source = reads.text(_SOURCE)
    except OSError as error:
        return unknown(name, what, why(error))
    if source not in _SLOW_SOURCES:
        return Check(name, what, Verdict.OK, source)
    text = f"{source}: reading the time takes a microsecond or more, several times in each tick"
    return Check(name, what, Verdict.WARN, text, f"cat {_SOURCE.replace('current', 'available')}; dmesg | grep -i tsc")


def _clock(reads: Reads) -> Check:
    name, what = "machine.clock", "whether the wall clock, from which frames get their stamps, is synchronised"
    try:
        status = reads.clock_status()
    except OSError as error:
        return unknown(name, what, why(error))
    if status.is_synchronised:
        text = f"synchronised, error at most {status.max_error_s * 1e3:.3g} ms"
        return Check(name, what, Verdict.OK, text, "", status.max_error_s, "s")
    text = "not synchronised: dates in recordings may be wrong, and stamps jump when the clock is set"
    return Check(name, what, Verdict.WARN, text, "sudo timedatectl set-ntp true")
