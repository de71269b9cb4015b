"""`hil-forceps conformance` for a drive with its maker's protocol."""

import json
import sys
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from firmware_protocol.conformance.findings import Disturbed, Inconclusive
from firmware_protocol.conformance.port import Margins
from firmware_protocol.conformance.report import is_well, junit
from hil_forceps.bench.stopping import StopFlag, stopped_by_signals
from hil_forceps.bridge.drive_conformance.catalogue import PROMISES
from hil_forceps.bridge.drive_conformance.certificate import certificate
from hil_forceps.bridge.drive_conformance.loop import Stopped
from hil_forceps.bridge.drive_conformance.registry import CHECKS, Need
from hil_forceps.bridge.drive_conformance.session import Session
from hil_forceps.bridge.drive_conformance.suite import Result, Suite
from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.bridge.links.conformance_port import LinkPort
from hil_forceps.cli.arguments.files import make_folder
from hil_forceps.cli.terminal.notes import note
from hil_forceps.cli.terminal.verdicts import print_verdicts, progress
from hil_forceps.drives.compatibility.lint import findings
from hil_forceps.drives.profile import Profile
from hil_forceps.drives.registry import machine_for
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import MotorDriver

_NEEDS = {
    Need.LISTENING: "no torque",
    Need.TORQUE: "holds the motor; --allow-motion",
    Need.MOTION: "moves the motor by 1 deg; --allow-motion",
}


class Judged(NamedTuple):
    """What is tested: the rig of a maker's drive, and the line to it."""

    path: Path
    rig: Rig
    profile: Profile
    settings: MotorDriver
    link: LinkSpec
    allow_motion: bool
    only: tuple[str, ...]
    out: Path | None

    @property
    def line(self) -> str:
        """The line, as certificates name it."""
        return self.link.serial_url or ":".join(filter(None, (self.link.interface, self.link.channel)))


def judge(judged: Judged, margins_of: Callable[[bool], Margins]) -> int:
    """Run the suite, print and write the results; return the exit code. UserError if the test can't be run."""
    numbers = _numbers(judged.only)
    _require_checked(judged.path, judged.rig)
    machine = machine_for(judged.rig)
    if judged.out is not None:
        make_folder(judged.out)
    connection = open_link(judged.link)
    for each in connection.notes:
        note(each)
    port, flag = LinkPort(connection, judged.link.fd), StopFlag()
    try:
        margins = margins_of(port.virtual_time)
        session = Session(port, judged.rig, machine, judged.profile, judged.settings, margins, flag.is_set)
        suite = Suite(session, judged.allow_motion)
        with stopped_by_signals(flag):
            results = _run(suite, numbers)
    finally:
        port.close()
    if judged.out is not None:
        _write(judged.out, suite, judged, results)
    settings = judged.settings
    title = f"{judged.path}: {settings.profile}, node {settings.node_id}, on {judged.line}"
    print_verdicts(title, "promise", results)
    return 0 if is_well(results, numbers if judged.only else ()) else 1


def print_list(only: tuple[str, ...]) -> None:
    """Print the checks."""
    for number in _numbers(only):
        promise = PROMISES[number]
        needs = _NEEDS[CHECKS[number].needs]
        sys.stdout.write(f"{promise.name} {promise.level:6} {promise.title}: {promise.why} [{needs}]\n")


def _run(suite: Suite, numbers: Sequence[int]) -> list[Result]:
    """Run, and leave the drive without torque, whatever happens."""
    node = f"node {suite.session.node}"
    try:
        suite.open()
        return suite.run(numbers, progress(len(numbers)))
    except Inconclusive as reason:
        raise UserError(f"{node}: can't be tested: {reason}") from None
    except Disturbed as reason:
        raise UserError(f"{node}: the test was aborted: {reason}") from None
    except Stopped:
        raise KeyboardInterrupt from None
    finally:
        try:
            suite.close()
        except Inconclusive as reason:
            sys.stderr.write(f"hil-forceps: the drive's state before the test was not restored: {reason}\n")


def _require_checked(path: Path, rig: Rig) -> None:
    """UserError for each problem that `hil-forceps check` finds."""
    problems = [f"{path}: {each.key}: {each.text}" for each in findings(rig) if each.level == "problem"]
    if problems:
        raise UserError(problems)


def _numbers(only: Sequence[str]) -> tuple[int, ...]:
    known = {promise.name: number for number, promise in PROMISES.items()}
    problems = [f"--only {name}: unknown check; --list shows all" for name in only if name.upper() not in known]
    if problems:
        raise UserError(problems)
    return tuple(sorted({known[name.upper()] for name in only})) or tuple(PROMISES)


def _write(out: Path, suite: Suite, judged: Judged, results: Sequence[Result]) -> None:
    written = certificate(suite, judged.settings, judged.line, results)
    if not suite.session.is_virtual:
        written["issued"] = datetime.now(UTC).isoformat(timespec="seconds")
    text = json.dumps(written, indent=1, ensure_ascii=False)
    (out / "certificate.json").write_text(text + "\n", encoding="utf-8")
    (out / "junit.xml").write_text(junit(results, f"conformance {judged.line}"), encoding="utf-8")
