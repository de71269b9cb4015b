"""`hil-forceps conformance`: a drive tested against the requirements of the protocol.

If the rig has a maker's profile, the drive is tested against that profile (`conformance_of_drive.py`).
"""

import json
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from firmware_protocol.conformance.catalogue import REQUIREMENTS, name_of
from firmware_protocol.conformance.findings import Disturbed, Inconclusive
from firmware_protocol.conformance.port import MS, REAL, VIRTUAL, Margins
from firmware_protocol.conformance.registry import CHECKS, Need
from firmware_protocol.conformance.report import certificate, is_well, junit
from firmware_protocol.conformance.suite import Result, Suite, discover
from firmware_protocol.frames import MAX_NODE
from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.bridge.links.conformance_port import LinkPort
from hil_forceps.cli.arguments.drive_line import NATIVE_BAUDRATE, link_of
from hil_forceps.cli.arguments.files import make_folder
from hil_forceps.cli.arguments.options import interface_options
from hil_forceps.cli.commands.drives import conformance_of_drive
from hil_forceps.cli.terminal.notes import note
from hil_forceps.cli.terminal.verdicts import print_verdicts, progress
from hil_forceps.drives.registry import maker_profile
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError


def conformance(
    *,
    rig: Path | None = None,
    interface: str = "",
    channel: str = "",
    serial: str = "",
    baudrate: int | None = None,
    fd: bool = False,
    option: tuple[str, ...] = (),
    node: int | None = None,
    allow_motion: bool = False,
    only: tuple[str, ...] = (),
    out: Path | None = None,
    line_ms: float | None = None,
    flood_s: float | None = None,
    list_: Annotated[bool, Parameter(name="--list")] = False,
) -> int:
    """Test a drive, real or simulated, against all requirements of the protocol that can be observed on the line.

    If the rig has a maker's profile, the drive is tested for the properties that the service relies on
    (docs/drive-conformance.md).

    With --out, writes certificate.json and junit.xml. Exit code 0 if no check failed; 1 if a check failed or was
    inconclusive, or if a check named with --only was not run; 2 if the test could not be run.

    Parameters
    ----------
    rig
        Rig file, as for `run`; required for a drive with its maker's protocol.
    interface
        python-can interface: socketcan, udp_multicast, slcan, pcan, ..., or virtual_forceps.
    channel
        Channel of that interface: can0, vcan0, ...
    serial
        Serial port, pyserial URL, or udp://ADDRESS:PORT (one packet in each datagram) instead of a CAN interface.
    baudrate
        Rate of the serial port in bit/s; default: the rig's for its drive, or 1 Mbit/s.
    fd
        Open the bus for CAN FD. A classic drive must tolerate this.
    option
        KEY=VALUE for the python-can interface; may be repeated.
    node
        Node id of the drive; only needed if several drives answer.
    allow_motion
        Also run the checks that give torque: the motor is held, moved by 6 degrees (1 with a maker's drive), and
        stopped. Nothing may be in its way.
    only
        Run only this requirement, such as HFP-120, or this check of a maker's drive, such as DRV-050; may be repeated.
    out
        Folder for the certificate and the JUnit file.
    line_ms
        Time in ms that line, adapter and host may add to a round trip; default: 5 in real time, 1 in virtual time.
    flood_s
        Time limit in s for the flood of 65536 frames (HFP-086); default: 60.
    list_
        List the checks, and run nothing.
    """
    loaded = None if rig is None else load_rig(rig)
    found = None if loaded is None else maker_profile(loaded)
    if rig is not None and loaded is not None and found is not None:
        given = {"--node": node is not None, "--fd": fd, "--flood-s": flood_s is not None}
        strange = [
            f"{name}: not for the drive of {rig}, or set by that file; leave it out"
            for name, is_on in given.items()
            if is_on
        ]
        if strange:
            raise UserError(strange)
        if list_:
            conformance_of_drive.print_list(only)
            return 0
        wanted = LinkSpec(interface, channel, serial, options=interface_options(option))
        link = link_of(rig, loaded, wanted, baudrate)
        judged = conformance_of_drive.Judged(rig, loaded, *found, link, allow_motion, only, out)
        return conformance_of_drive.judge(judged, lambda virtual_time: margins_of(virtual_time, line_ms, None))
    numbers = _numbers(only)
    if list_:
        _print_list(numbers)
        return 0
    if out is not None:
        make_folder(out)
    rate = NATIVE_BAUDRATE if baudrate is None else baudrate
    spec = LinkSpec(interface, channel, serial, fd, baudrate=rate, options=interface_options(option))
    connection = open_link(spec)
    for each in connection.notes:
        note(each)
    port = LinkPort(connection, fd)
    try:
        suite = open_suite(port, node, margins_of(port.virtual_time, line_ms, flood_s), allow_motion)
        results = _run(suite, numbers)
    finally:
        port.close()
    line = serial or ":".join(filter(None, (interface, channel)))
    if out is not None:
        write_results(out, suite, line, results)
    _print_results(suite, line, results)
    return 0 if is_well(results, numbers if only else ()) else 1


def margins_of(virtual_time: bool, line_ms: float | None, flood_s: float | None) -> Margins:
    """Return the margins for this line; UserError if an option is out of range."""
    margins = VIRTUAL if virtual_time else REAL
    if line_ms is not None:
        if not 0.0 < line_ms <= 1000.0:
            raise UserError(f"--line-ms {line_ms}: must be above 0 and at most 1000")
        margins = margins._replace(line_ns=round(line_ms * MS))
    if flood_s is not None:
        if not 0.0 < flood_s <= 1e5:
            raise UserError(f"--flood-s {flood_s}: must be above 0 and at most 100000")
        margins = margins._replace(flood_ns=round(flood_s * 1e9))
    return margins


def open_suite(port: LinkPort, node: int | None, margins: Margins, allow_motion: bool) -> Suite:
    """Find the drive and read its identity; UserError if none answers, or several and no node is given."""
    if node is None:
        found = discover(port, margins.line_ns)
        if not found:
            raise UserError("no drive answers DISCOVER; check its power, the channel and the bit rate")
        if len(found) > 1:
            drives = ", ".join(f"node {each.node} ({each.serial_number:012x})" for each in found)
            raise UserError(f"several drives answer: {drives}; choose one with --node")
        node = found[0].node
    elif not 1 <= node <= MAX_NODE:
        raise UserError(f"--node {node}: must be 1 to {MAX_NODE}")
    suite = Suite(port, node, margins, allow_motion)
    try:
        suite.open()
    except Inconclusive as reason:
        raise UserError(f"node {node}: can't be tested: {reason}") from None
    return suite


def _numbers(only: Sequence[str]) -> tuple[int, ...]:
    known = {name_of(number): number for number in REQUIREMENTS}
    problems = [f"--only {name}: unknown requirement; --list shows all" for name in only if name.upper() not in known]
    if problems:
        raise UserError(problems)
    return tuple(sorted({known[name.upper()] for name in only})) or tuple(REQUIREMENTS)


def _run(suite: Suite, numbers: Sequence[int]) -> list[Result]:
    """Run the checks; restore the drive's state in any case."""
    show = progress(len({c.name for c in CHECKS if c.requirement in numbers}))
    try:
        results = suite.run(numbers, show)
    except Disturbed as reason:
        raise UserError(f"node {suite.session.home}: the test was aborted: {reason}") from None
    finally:
        try:
            suite.close()
        except Inconclusive as reason:
            sys.stderr.write(f"hil-forceps: the drive's state before the test was not restored: {reason}\n")
    return results


def write_results(out: Path, suite: Suite, line: str, results: Sequence[Result]) -> None:
    """Write certificate.json and junit.xml; the date only in real time, so that virtual time stays reproducible."""
    written = certificate(suite, line, results)
    if not suite.session.virtual:
        written["issued"] = datetime.now(UTC).isoformat(timespec="seconds")
    text = json.dumps(written, indent=1, ensure_ascii=False)
    (out / "certificate.json").write_text(text + "\n", encoding="utf-8")
    (out / "junit.xml").write_text(junit(results, f"conformance {line}"), encoding="utf-8")


def _print_results(suite: Suite, line: str, results: Sequence[Result]) -> None:
    identity = suite.session.identity
    assert identity is not None
    form = "CAN FD" if suite.session.fd else "classic"
    title = f"{identity.serial_number:012x}, node {suite.session.home}, protocol {identity.protocol_major}."
    title += f"{identity.protocol_minor}, {form}, on {line}"
    print_verdicts(title, "requirement", results)


def _print_list(numbers: Sequence[int]) -> None:
    for number in numbers:
        requirement = REQUIREMENTS[number]
        needs = [c.needs for c in CHECKS if c.requirement == number]
        words = requirement.untestable or ", ".join(dict.fromkeys(_words(need) for need in needs))
        sys.stdout.write(f"{requirement.name} {requirement.level:6} {requirement.title} [{words}]\n")


def _words(needs: Need) -> str:
    names = {
        Need.MOTION: "motion",
        Need.FD_DRIVE: "FD drive",
        Need.CLASSIC_DRIVE: "classic drive",
        Need.FD_LINE: "line with FD",
        Need.FOREIGN: "line with extended ids",
        Need.SERIAL: "serial line",
        Need.STREAM: "stream of bytes",
        Need.DATAGRAM: "datagrams",
    }
    return " and ".join(name for need, name in names.items() if needs & need) or "any drive"
