"""Runs the checks against one drive, one after the other, each from a drive that is READY and without torque.

A check that goes wrong while this host stood still says nothing about the drive: it is tried again, and called
inconclusive when that does not help. A drive that goes against its references, or further than they ask, gets no more
torque from here.
"""

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

import hil_forceps.bridge.drive_conformance.checks  # noqa: F401 - registers the checks
from firmware_protocol.conformance.findings import Inconclusive, Violation
from firmware_protocol.conformance.suite import NEEDS_MOTION, Verdict
from hil_forceps.bridge.drive_conformance.catalogue import PROMISES, Promise
from hil_forceps.bridge.drive_conformance.loop import Certain, Stopped
from hil_forceps.bridge.drive_conformance.measures import Measure
from hil_forceps.bridge.drive_conformance.registry import CHECKS, Check, Need
from hil_forceps.bridge.drive_conformance.session import Session

SUITE_VERSION: Final = "1.0"


class Result(NamedTuple):
    """What was found of one promise; `applies` is false where such a profile promises nothing of it."""

    requirement: Promise
    verdict: Verdict
    evidence: str
    measures: tuple[Measure, ...] = ()
    attempts: int = 0
    applies: bool = True


class Suite:
    """All checks for one drive. `open` first and `close` at last; what has been run is not run twice."""

    def __init__(self, session: Session, allow_motion: bool = False) -> None:
        self.session = session
        self.allow_motion = allow_motion
        self.lost_drive = ""  # why nothing can be run any more
        self.no_torque = ""  # why nothing with torque can
        self._done: dict[int, Result] = {}
        self._is_certain = False  # the last violation is, however the host stood still

    def open(self) -> None:
        """Get to know the drive; Inconclusive when nobody fits, or it can't be judged as it is."""
        session = self.session
        session.connect()
        if session.refusal:
            self.lost_drive = f"the drive was refused: {session.refusal}"
        else:
            session.require_judgeable(self.allow_motion)

    def close(self) -> None:
        """Leave the drive without torque; Inconclusive when it does not confirm that."""
        self.session.close()

    def run(self, numbers: Iterable[int], show: Callable[[str], None] = lambda _: None) -> list[Result]:
        """Judge these promises; `show` is told each. Disturbed where something outside moves the motor meanwhile.

        Whatever this program itself gets wrong sends an emergency stop before it passes on.
        """
        results = []
        try:
            for number in sorted(set(numbers)):
                show(f"{PROMISES[number].name} {PROMISES[number].title}")
                results.append(self.promise(number))
        except Stopped:
            raise
        except BaseException:
            self.session.off_at_once()
            raise
        return results

    def promise(self, number: int) -> Result:
        """Judge one promise, unless it has been judged."""
        if number not in self._done:
            self._done[number] = self._judge(PROMISES[number], CHECKS[number])
        return self._done[number]

    def _judge(self, promise: Promise, each: Check) -> Result:
        excuse, has_torque = each.excuse(self.session), each.needs is not Need.LISTENING
        if excuse:
            return Result(promise, Verdict.NOT_RUN, excuse, applies=False)
        if has_torque and not self.allow_motion:
            return Result(promise, Verdict.NOT_RUN, NEEDS_MOTION)
        if has_torque and self.no_torque:
            return Result(promise, Verdict.NOT_RUN, self.no_torque)
        if self.lost_drive and not (self.session.refusal and promise.number == min(PROMISES)):
            return Result(promise, Verdict.INCONCLUSIVE, self.lost_drive)
        return self._run(promise, each)

    def _run(self, promise: Promise, each: Check) -> Result:
        session = self.session
        attempts = 1 if session.is_virtual or session.refusal else session.margins.attempts
        attempt, is_excused = 0, True
        while is_excused and attempt < attempts:
            attempt += 1
            verdict, evidence = self._try(each)
            stood_still = not session.is_virtual and session.stalled_ns > session.margins.stall_ns
            is_excused = verdict is not Verdict.PASS and stood_still and not self._is_certain
        if is_excused:
            verdict = Verdict.INCONCLUSIVE
            evidence += f" (this host was blocked in each of {attempts} attempts)"
        result = Result(promise, verdict, evidence, tuple(session.measures), attempt)
        self._recover(promise, each)
        if verdict is not Verdict.PASS and not self.lost_drive:
            session.require_undisturbed()
        return result

    def _try(self, each: Check) -> tuple[Verdict, str]:
        session = self.session
        session.begin_evidence()
        self._is_certain = False
        try:
            if each.needs is not Need.LISTENING:
                session.recover()
                session.begin()
            each.run(session)
        except Violation as finding:
            self._is_certain = isinstance(finding, Certain)
            if session.is_dangerous:
                self.no_torque = f"after {PROMISES[each.promise].name} the drive gets no more torque from here"
            return Verdict.FAIL, "; ".join(filter(None, (str(finding), session.evidence())))
        except Inconclusive as reason:
            return Verdict.INCONCLUSIVE, str(reason)
        return Verdict.PASS, session.evidence()

    def _recover(self, promise: Promise, each: Check) -> None:
        if each.needs is Need.LISTENING or self.lost_drive:
            return
        try:
            self.session.recover()
        except Inconclusive as reason:
            self.lost_drive = f"after {promise.name}: {reason}"
