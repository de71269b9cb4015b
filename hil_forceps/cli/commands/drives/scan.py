"""`hil-forceps scan`: the drives on a bus or port, by listening or by a read-only request."""

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
    """Listen on a bus or a serial port, and list the drives on it. Nothing moves or changes.

    Nothing is sent without --ask. Drives that send nothing unasked are found only with --ask. Exit code 1 if no drive
    was recognised.

    Parameters
    ----------
    interface
        python-can interface: socketcan, udp_multicast, slcan, pcan, ..., or virtual_forceps.
    channel
        Channel of that interface: can0, vcan0, ...
    serial
        Serial port, pyserial URL, or udp://ADDRESS:PORT instead of a CAN interface.
    baudrate
        Rate of the serial port in bit/s.
    bitrate
        Bit rate of the CAN bus in bit/s, if the interface sets it.
    fd
        Open the interface for CAN FD, as a moteus requires; classic frames are received, too.
    data_bitrate
        Bit rate of the data phase of CAN FD in bit/s, if the interface sets it.
    option
        KEY=VALUE for the python-can interface; may be repeated.
    seconds
        Time to listen, in s.
    ask
        Send a read-only request to the drives of this profile. dynamixel: a ping to all. moteus: mode and fault, over
        CAN FD.
    as_json
        Print the drives as JSON.
    """
    if not (math.isfinite(seconds) and 0.0 < seconds <= MAX_SECONDS):
        raise UserError(f"--seconds {seconds:g}: must be above 0 and at most {MAX_SECONDS:g}")
    asked = _asked(ask)
    if serial and asked is not None and asked.link == "can":
        raise UserError(f"--ask {ask}: this drive is on a CAN bus, not a serial port; give --interface and --channel")
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
    """Return the profile whose request is sent; UserError if it has none."""
    if name is None:
        return None
    profile = PROFILES.get(name)
    if profile is None or not profile.ask:
        raise UserError(f"--ask {name}: this profile has no read-only request; leave --ask out")
    return profile


def _tell(listener: BusListener, seconds: float) -> int:
    found = listener.found()
    if not found:
        heard = (
            f"{listener.frames} frames were received, none of them a heartbeat of a known drive"
            if listener.frames
            else "no frame was received; check bit rate, wiring, termination and the drive's power"
        )
        sys.stdout.write(
            f"no drive recognised in {seconds:g} s: {heard}. A moteus needs --ask moteus, a Dynamixel --ask dynamixel. "
            "A mini cheetah drive (mit) sends nothing unasked, and only `run` finds it\n"
        )
        return EXIT_NOBODY
    table = Table(box=SIMPLE_HEAD, padding=(0, 1))
    for name in ("profile", "node", "state"):
        table.add_column(name, no_wrap=name != "state")
    for each in found:
        table.add_row(each.profile, str(each.node), each.says)
    print_table(table, TABLE_WIDTH)
    sys.stdout.write(
        "enter profile and node in `motor_driver:` of the rig file, the node of a native drive in `bench.node_id` "
        "(docs/drives.md)\n"
    )
    return 0
