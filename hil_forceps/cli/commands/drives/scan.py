"""`hil-forceps scan`: who is on this bus or port, by listening, or by asking what moves nothing."""

import json
import math
import sys
from typing import Annotated

from cyclopts import Parameter
from rich.box import SIMPLE_HEAD
from rich.table import Table

from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.cli.arguments.groups import OfLine
from hil_forceps.cli.arguments.options import interface_options
from hil_forceps.cli.terminal.tables import print_table
from hil_forceps.drives.framing import NATIVE
from hil_forceps.drives.profile import Profile
from hil_forceps.drives.registry import PROFILES
from hil_forceps.drives.scan import BusListener
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import ProfileName

EXIT_NOBODY = 1
POLL_S = 0.01
MAX_SECONDS = 3600.0
TABLE_WIDTH = 100


def scan(
    *,
    interface: OfLine[str] = "",
    channel: OfLine[str] = "",
    serial: OfLine[str] = "",
    baudrate: OfLine[int] = 1_000_000,
    bitrate: OfLine[int] = 1_000_000,
    fd: OfLine[bool] = False,
    data_bitrate: OfLine[int] = 5_000_000,
    option: OfLine[tuple[str, ...]] = (),
    seconds: float = 2.0,
    ask: ProfileName | None = None,
    as_json: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Listen on a bus or a serial port, and tell which drives are there. Nothing moves or changes.

    Nothing is sent but by --ask. Exit code 1 when nobody was recognised. A drive that says nothing by itself is found
    only by --ask.

    Parameters
    ----------
    interface
        python-can interface: socketcan, udp_multicast, slcan, pcan, ..., or virtual_forceps.
    channel
        Channel of that interface: can0, vcan0, ...
    serial
        Serial port, pyserial URL, or udp://ADDRESS:PORT instead of a CAN interface.
    baudrate
        Of the serial port.
    bitrate
        Of the CAN bus, where the interface sets it.
    fd
        Open the interface for CAN FD, as a moteus needs; then drives of classic frames are heard, too.
    data_bitrate
        Of the data of frames of CAN FD, where the interface sets it.
    option
        KEY=VALUE for the python-can interface; may be repeated.
    seconds
        How long to listen.
    ask
        Ask the drives of this profile who they are, where it has such a question: dynamixel, by a ping to all; moteus,
        over CAN FD, for mode and fault.
    as_json
        As JSON.
    """
    if not (math.isfinite(seconds) and 0.0 < seconds <= MAX_SECONDS):
        raise UserError(f"--seconds {seconds:g}: must be above 0 and at most {MAX_SECONDS:g}")
    asked = _asked(ask)
    if serial and asked is not None and asked.link == "can":
        raise UserError(f"--ask {ask}: such a drive is on a CAN bus; give --interface and --channel")
    spec = LinkSpec(
        interface=interface,
        channel=channel,
        serial_url=serial,
        fd=fd or (asked is not None and asked.speaks_fd),
        bitrate_bit_per_s=bitrate,
        data_bitrate_bit_per_s=data_bitrate,
        baudrate=baudrate,
        options=interface_options(option),
        framing=NATIVE if asked is None else asked.framing,
    )
    connection = open_link(spec)
    listener = BusListener(asked)
    try:
        for question in () if asked is None else asked.ask:
            connection.link.send(question)
        now_ns = connection.clock.now_ns()
        end_ns = now_ns + round(seconds * 1e9)
        while now_ns < end_ns:
            connection.clock.sleep_until_ns(min(now_ns + round(POLL_S * 1e9), end_ns))
            now_ns = connection.clock.now_ns()
            for _, frame in connection.link.receive():
                listener.receive(frame)
    finally:
        connection.link.close()
    if as_json:
        drives = [each._asdict() for each in listener.found()]
        sys.stdout.write(json.dumps({"frames": listener.frames, "drives": drives}, indent=2) + "\n")
        return 0 if drives else EXIT_NOBODY
    return _tell(listener, seconds)


def _asked(name: str | None) -> Profile | None:
    """Return the profile to ask by; UserError where it has no question."""
    if name is None:
        return None
    profile = PROFILES.get(name)
    if profile is None or not profile.ask:
        raise UserError(f"--ask {name}: such a drive tells by itself that it is there; leave --ask out")
    return profile


def _tell(listener: BusListener, seconds: float) -> int:
    found = listener.found()
    if not found:
        heard = (
            f"{listener.frames} frames came, and no heartbeat of a drive that is known here"
            if listener.frames
            else "nothing came; check bit rate, wiring, termination and the drive's power"
        )
        sys.stdout.write(
            f"nobody recognised in {seconds:g} s: {heard}; a moteus is found by --ask moteus, or by --fd where it is "
            "asked by others; a mini cheetah drive (mit) says nothing by itself, and is found by `run` alone\n"
        )
        return EXIT_NOBODY
    table = Table(box=SIMPLE_HEAD, padding=(0, 1))
    for name in ("profile", "node", "says"):
        table.add_column(name, no_wrap=name != "says")
    for each in found:
        table.add_row(each.profile, str(each.node), each.says)
    print_table(table, TABLE_WIDTH)
    sys.stdout.write(
        "profile and node go into a rig's `motor_driver:`, a native drive's node into `bench.node_id`; docs/drives.md\n"
    )
    return 0
