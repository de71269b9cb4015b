"""Runs the checks against one drive, one after the other, each from a drive that is DISABLED and without fault.

A check that goes wrong while this host stood still says nothing about the drive: it is tried again, and called
inconclusive when that does not help. A drive that is late by itself fails, after as many tries.
"""

from collections.abc import Callable, Iterable
from enum import StrEnum
from typing import Final, NamedTuple

import firmware_protocol.conformance.checks  # noqa: F401 - registers the checks
from firmware_protocol.conformance.catalogue import REQUIREMENTS, Requirement, name_of
from firmware_protocol.conformance.findings import Inconclusive, Violation
from firmware_protocol.conformance.port import Capability, Margins, Port
from firmware_protocol.conformance.registry import CHECKS, Check, Need
from firmware_protocol.conformance.session import MeasuredTime, Session
from firmware_protocol.frames import BROADCAST_NODE, Frame, arbitration_id
from firmware_protocol.messages import Function, Identity

__all__ = ["CheckResult", "Result", "Suite", "Verdict", "discover"]

SUITE_VERSION: Final = "1.1"
_SERIAL_KINDS: Final = Capability.SERIAL | Capability.STREAM
NEEDS_MOTION: Final = "moves the motor; wants --allow-motion"


class Verdict(StrEnum):
    """What can be said of a requirement."""

    PASS = "pass"  # noqa: S105 - a verdict
    FAIL = "fail"
    INCONCLUSIVE = "inconclusive"
    NOT_RUN = "not run"


class CheckResult(NamedTuple):
    """What one check found; `applies` is false where the requirement says nothing about such a drive or line."""

    name: str
    verdict: Verdict
    evidence: str
    attempts: int
    timings: tuple[MeasuredTime, ...]
    applies: bool = True


class Result(NamedTuple):
    """What all checks of one requirement found together."""

    requirement: Requirement
    verdict: Verdict
    evidence: str
    checks: tuple[CheckResult, ...]
    applies: bool


def discover(port: Port, wait_ns: int) -> list[Identity]:
    """Return the drives that answer DISCOVER to all, in order of node."""
    listener = Session(port, BROADCAST_NODE, Margins(wait_ns, 0, 1, 500_000, 0))
    for _ in range(2):
        listener.send(Frame(arbitration_id(Function.DISCOVER, BROADCAST_NODE), b""))
        listener.run(40_000_000 + wait_ns)
    return sorted({identity for _, identity in listener.identities})


class Suite:
    """All checks for one drive. `open` first and `close` at last; what has been run is not run twice."""

    def __init__(self, port: Port, node: int, margins: Margins, allow_motion: bool = False) -> None:
        self.margins = margins
        self.allow_motion = allow_motion
        self.session = Session(port, node, margins)
        self.lost_drive = ""  # why nothing can be run any more
        self._done: dict[str, CheckResult] = {}
        self._capabilities = port.capabilities

    def open(self) -> None:
        """Get to know the drive; Inconclusive when it does not say enough to go on, or can't be judged as it is."""
        self.session.open()
        self.session.require_judgeable(self.allow_motion)

    def close(self) -> None:
        """Leave the drive as it was found; Inconclusive when that fails."""
        self.session.close()

    def run(self, numbers: Iterable[int], show: Callable[[str], None] = lambda _: None) -> list[Result]:
        """Judge these requirements, in the order in which the checks disturb each other least; `show` is told each.

        Disturbed where something outside moves the motor meanwhile.
        """
        wanted = set(numbers)
        for each in sorted((c for c in CHECKS if c.requirement in wanted), key=lambda c: (c.last, c.requirement)):
            show(f"{name_of(each.requirement)} {each.name}")
            self.check(each)
        return [self.requirement(number) for number in sorted(wanted)]

    def requirement(self, number: int) -> Result:
        """Judge one requirement by all its checks."""
        requirement = REQUIREMENTS[number]
        if requirement.untestable:
            return Result(requirement, Verdict.NOT_RUN, requirement.untestable, (), False)
        results = tuple(self.check(each) for each in CHECKS if each.requirement == number)
        counting = [r for r in results if r.applies] or list(results)
        order = (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.NOT_RUN, Verdict.PASS)
        verdict = next(v for v in order if any(r.verdict is v for r in counting))
        evidence = "; ".join(dict.fromkeys(r.evidence for r in counting if r.verdict is verdict))
        return Result(requirement, verdict, evidence, results, any(r.applies for r in results))

    def check(self, each: Check) -> CheckResult:
        """Run one check, unless it has been run."""
        if each.name not in self._done:
            self._done[each.name] = self._run(each)
        return self._done[each.name]

    def _run(self, each: Check) -> CheckResult:
        missing = self._missing(each.needs)
        if missing:
            return CheckResult(each.name, Verdict.NOT_RUN, missing, 0, (), False)
        if each.needs & Need.MOTION and not self.allow_motion:
            return CheckResult(each.name, Verdict.NOT_RUN, NEEDS_MOTION, 0, ())
        if self.lost_drive:
            return CheckResult(each.name, Verdict.INCONCLUSIVE, self.lost_drive, 0, ())
        attempts = 1 if self.session.virtual else self.margins.attempts
        attempt, excuse = 0, "none yet"
        while excuse and attempt < attempts:
            attempt += 1
            verdict, evidence, excuse = self._try(each)
        timings = tuple(self.session.timings)
        if excuse == "host":
            verdict = Verdict.INCONCLUSIVE
            evidence += f" (this host was blocked in each of {attempts} attempts)"
        self._recover(each)
        if verdict is not Verdict.PASS:
            self.session.require_undisturbed()
        return CheckResult(each.name, verdict, evidence, attempt, timings)

    def _try(self, each: Check) -> tuple[Verdict, str, str]:
        """Run a check once; return verdict, evidence, and who disturbed it, if anybody: host or line."""
        session = self.session
        session.begin()
        session.timings = []
        try:
            session.recover()
            session.begin()
            verdict, evidence = Verdict.PASS, each.run(session)
        except Violation as finding:
            verdict, evidence = Verdict.FAIL, str(finding)
        except Inconclusive as reason:
            verdict, evidence = Verdict.INCONCLUSIVE, str(reason)
        if session.virtual:
            return verdict, evidence, ""
        limit_ns = self.margins.void_stall_ns if verdict is Verdict.PASS else self.margins.stall_ns
        if session.stalled_ns > limit_ns:
            return verdict, evidence, "host"
        # A line that loses frames, or a drive that was late once, may be excused; if it is so every time, it is not.
        return verdict, evidence, "" if verdict is Verdict.PASS else "line"

    def _recover(self, each: Check) -> None:
        try:
            self.session.recover()
        except Inconclusive as reason:
            self.lost_drive = f"after {name_of(each.requirement)} ({each.name}): {reason}"

    def _missing(self, needs: Need) -> str:
        """Say what a check needs that this drive or line does not have, or nothing."""
        can = self._capabilities
        for need, there, words in (
            (Need.FD_DRIVE, self.session.fd, "speaks of CAN FD drives; this one is classic"),
            (Need.CLASSIC_DRIVE, not self.session.fd, "speaks of classic drives; this one is CAN FD"),
            (Need.FD_LINE, bool(can & Capability.FD), "this line carries no CAN FD frames"),
            (Need.FOREIGN, bool(can & Capability.FOREIGN), "this line carries data frames with 11-bit ids only"),
            (Need.SERIAL, bool(can & Capability.SERIAL), "speaks of serial lines"),
            (Need.STREAM, bool(can & Capability.STREAM), "speaks of streams; this line keeps packets whole"),
            (Need.DATAGRAM, can & _SERIAL_KINDS == Capability.SERIAL, "speaks of datagrams"),
        ):
            if needs & need and not there:
                return words
        return ""
