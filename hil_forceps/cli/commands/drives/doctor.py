"""`hil-forceps doctor`: checks before the first motion, each with its remedy."""

import json
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hil_forceps.bridge.clocks import MonotonicClock
from hil_forceps.bridge.doctor.check import Check, Verdict
from hil_forceps.bridge.doctor.examination import Asked, examine
from hil_forceps.bridge.doctor.reads import System
from hil_forceps.bridge.links.adapters import LinkSpec, check_spec
from hil_forceps.cli.arguments.drive_line import line_rate, link_of, named_rigs
from hil_forceps.cli.arguments.groups import OfLine
from hil_forceps.cli.arguments.options import interface_options
from hil_forceps.cli.terminal.check_table import lines
from hil_forceps.rig.errors import UserError

EXIT_FAILS = 1
USUAL_DURATION_S = 20.0  # of `run` without a trajectory


def doctor(
    *,
    rig: tuple[Path, ...] = (),
    interface: OfLine[str] = "",
    channel: OfLine[str] = "",
    serial: OfLine[str] = "",
    baudrate: OfLine[int | None] = None,
    option: OfLine[tuple[str, ...]] = (),
    duration: float = USUAL_DURATION_S,
    out: Path = Path("out"),
    as_json: Annotated[bool, Parameter(name="--json", negative=())] = False,
) -> int:
    """Check this computer, the line, the rig file and the drive before motion.

    Nothing moves, no drive is enabled, and no setting changes; docs/doctor.md lists the frames that are sent. Without
    options only the computer is checked. Exit code 0 if no check failed, 1 if one failed, 2 if the options are wrong.

    Parameters
    ----------
    rig
        Rig file, as for `run`; may be repeated.
    interface
        python-can interface: socketcan, udp_multicast, slcan, pcan, ..., or virtual_forceps.
    channel
        Channel of that interface: can0, vcan0, ...
    serial
        Serial port, pyserial URL, or udp://ADDRESS:PORT instead of a CAN interface.
    baudrate
        Rate of the serial port in bit/s; default: the rig's for its drive, or 1 Mbit/s.
    option
        KEY=VALUE for the python-can interface; may be repeated.
    duration
        Planned duration of the run in s, to check the space on the disk.
    out
        Folder for the results of the planned run; it is not created.
    as_json
        Print JSON instead of the table.
    """
    if not (math.isfinite(duration) and duration > 0.0):
        raise UserError(f"--duration {duration}: must be a positive number of seconds")
    if interface and serial:
        raise UserError("--interface and --serial: the drive is on one of them; leave one out")
    rigs = named_rigs(rig)
    for path, loaded in zip(rig, rigs.values(), strict=True):
        line_rate(path, loaded, interface, serial, baudrate)  # UserError for the wrong kind of line
    if rig and not interface and not serial:
        told = "the line to its drive is missing; give --interface and --channel, or --serial"
        raise UserError(f"--rig {rig[0]}: {told} (without a drive: hil-forceps check {rig[0]})")
    link = None
    if interface or serial:
        link = LinkSpec(interface=interface, channel=channel, serial_url=serial, options=interface_options(option))
        check_spec(link)
        for path, loaded in zip(rig, rigs.values(), strict=True):
            link = link_of(path, loaded, link, baudrate)
    checks = list(examine(Asked(rigs, link, out, duration), System(), MonotonicClock(), time.time_ns))
    fails = any(check.verdict is Verdict.FAIL for check in checks)
    sys.stdout.write(_json(checks, fails) if as_json else "\n".join(lines(checks)) + "\n")
    return EXIT_FAILS if fails else 0


def _json(checks: Sequence[Check], fails: bool) -> str:
    content = {"ok": not fails, "checks": [check._asdict() for check in checks]}
    return json.dumps(content, indent=2) + "\n"
