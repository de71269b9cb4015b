"""All checks in their order: what is asked for, and what that lets be looked at."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from hil_forceps.bridge.doctor import can_interface, disk, drive, machine, multicast, rig, serial_port, timing
from hil_forceps.bridge.doctor.check import Check, Verdict, unknown
from hil_forceps.bridge.doctor.reads import Reads
from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.bridge.ports import Clock
from hil_forceps.drives.compatibility.several import findings as findings_of_several
from hil_forceps.drives.registry import inquiry_for
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import BenchSettings, Limits


class Asked(NamedTuple):
    """What is planned."""

    rigs: Mapping[str, Rig]  # by their names; none: the machine alone
    link: LinkSpec | None  # None: no line was named
    out: Path
    duration_s: float

    def named(self, name: str, checks: Iterator[Check]) -> Iterator[Check]:
        """Return checks of one rig, told by its name where there are several."""
        return checks if len(self.rigs) == 1 else (check._replace(id=f"{check.id}:{name}") for check in checks)


def examine(asked: Asked, reads: Reads, clock: Clock, wall_ns: Callable[[], int]) -> Iterator[Check]:
    """Make all checks; a line is opened last, for as long as it is listened to."""
    rigs = list(asked.rigs.values())
    bench, limits = (rigs[0].bench, rigs[0].limits) if rigs else (None, Limits())
    period_s = (bench or BenchSettings()).host_period_s
    yield from machine.checks(reads)
    yield from disk.checks(reads, asked.out, asked.duration_s, period_s, max(1, len(rigs)))
    measured = timing.measure(clock, wall_ns, period_s)
    yield from timing.checks(measured, period_s)
    for name, each in asked.rigs.items():
        yield from asked.named(name, rig.checks(each))
    if len(rigs) > 1:
        yield from _together(asked.rigs)
    if asked.link is None:
        for name, each in asked.rigs.items():
            yield from asked.named(name, iter((_no_line(each),)))
    else:
        yield from _line(asked.link, reads, bench, limits)
        yield from _drives(asked, asked.link, measured.late_s[-1])


def _together(rigs: Mapping[str, Rig]) -> Iterator[Check]:
    for found in findings_of_several(rigs):
        verdict = Verdict.FAIL if found.level == "problem" else Verdict.OK
        yield Check(f"rigs.{found.key}", "whether the rigs can share one line", verdict, found.text)


def _no_line(each: Rig) -> Check:
    return unknown("drive.answers", drive.who(each), "no line was given; add --interface and --channel, or --serial")


def _line(link: LinkSpec, reads: Reads, bench: BenchSettings | None, limits: Limits) -> Iterator[Check]:
    if link.serial_url:
        yield from serial_port.checks(reads, link.serial_url, limits)
    elif link.interface == "socketcan":
        yield from can_interface.checks(reads, link.channel, bench, limits)
    elif link.interface == "udp_multicast":
        yield from multicast.checks(link.options)


def _drives(asked: Asked, link: LinkSpec, worst_late_s: float) -> Iterator[Check]:
    what = "whether the line can be opened"
    try:
        connection = open_link(link)
    except UserError as error:
        for problem in error.problems:
            text, _, remedy = problem.partition("; ")
            yield Check("line.open", what, Verdict.FAIL, text, remedy)
        return
    yield Check("line.open", what, Verdict.OK, "opened")
    inquiries = [inquiry_for(each) for each in asked.rigs.values()]
    try:
        heard = drive.listen(connection, inquiries, list(asked.rigs.values()))
    finally:
        connection.link.close()
    if not asked.rigs:
        yield drive.who_is_there(heard)
    for (name, each), inquiry, said in zip(asked.rigs.items(), inquiries, heard.said, strict=True):
        found = iter((drive.cannot_ask(each),)) if inquiry is None else drive.checks(each, said, heard)
        yield from asked.named(name, found)
        told_s = None if said is None else said.watchdog_s
        yield from asked.named(name, iter((_watchdog(each, told_s, worst_late_s),)))


def _watchdog(each: Rig, told_s: float | None, worst_late_s: float) -> Check:
    settings = each.motor_driver
    if told_s is None and settings is not None and each.drive_profile != "native":
        return timing.watchdog(settings.watchdog_s, "by the rig", each.bench.host_period_s, worst_late_s)
    return timing.watchdog(told_s, "by the drive", each.bench.host_period_s, worst_late_s)
