"""Opening a link: any python-can interface or pyserial URL, with the clock that goes with it; errors in words."""

import errno
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, cast

import can
import serial
from can.interfaces.udp_multicast import UdpMulticastBus

from hil_forceps.bridge.clocks import MonotonicClock, VirtualClock, VirtualTimeBus
from hil_forceps.bridge.links.can_link import PythonCanLink, VirtualTimeLink, error_number
from hil_forceps.bridge.links.loopback import keep_on_loopback
from hil_forceps.bridge.links.serial_link import SerialLink
from hil_forceps.bridge.links.udp_port import SCHEME, UdpPort
from hil_forceps.bridge.ports import Clock, Link
from hil_forceps.drives.framing import NATIVE, Framing
from hil_forceps.rig.errors import UserError

IFF_UP = 1
NET_DEVICES = Path("/sys/class/net")
SERIAL_DEVICES = Path("/sys/class/tty")
MARKS_OTHERS = frozenset({"socketcan"})  # a drive that is a process of this machine looks like ourselves
ECHOING = frozenset({"udp_multicast"})  # hears its own frames, whatever it is asked, and does not mark them
VIRTUAL_TIME = ("now_ns", "advance_until_ns", "send_frame", "receive_frames")

_CAN_REMEDIES = {
    errno.ENODEV: "there is no such CAN device; see `ip link`, and `ip link set can0 up type can bitrate 1000000`",
    errno.ENETDOWN: "the device is down; `ip link set can0 up type can bitrate 1000000`",
    errno.EAFNOSUPPORT: "this kernel has no CAN; `modprobe can_raw`, or use udp_multicast or a serial port",
    errno.EPROTONOSUPPORT: "this kernel has no raw CAN sockets; `modprobe can_raw`",
    errno.EPERM: "not permitted; run as a user that may use it",
    errno.EACCES: "not permitted; run as a user that may use it",
    errno.ENOENT: "there is no such device; check the channel",
}
_SERIAL_REMEDIES = {
    errno.ENOENT: "there is no such port; see `python3 -m serial.tools.list_ports`",
    errno.EACCES: "not permitted; add your user to the group that owns it (often `dialout`)",
    errno.EPERM: "not permitted; add your user to the group that owns it (often `dialout`)",
    errno.EBUSY: "another program has it open; close that first",
    errno.EAGAIN: "another program has it open; close that first",
    errno.ENOTTY: "this is not a serial port",
    errno.EIO: "the other end is gone",
    errno.ECONNREFUSED: "nobody listens there",
}


class LinkSpec(NamedTuple):
    """Where the drive is: `interface` and `channel` of python-can, or `serial_url`.

    `serial_url`: a path, a pyserial URL, or udp://address:port for packets as datagrams (see `UdpPort`). `options` go
    to the python-can interface as they are. `framing`: of packets on a serial port. `spin_ns`: see `MonotonicClock`.
    """

    interface: str = ""
    channel: str = ""
    serial_url: str = ""
    fd: bool = False
    bitrate_bit_per_s: int = 1_000_000
    data_bitrate_bit_per_s: int = 5_000_000
    baudrate: int = 1_000_000
    options: Mapping[str, object] = MappingProxyType({})
    spin_ns: int = 100_000
    framing: Framing = NATIVE


class Connection(NamedTuple):
    """An open link with its clock.

    `virtual_time` says that the clock is the bus itself, `notes` what a user should know.
    """

    link: Link
    clock: Clock
    virtual_time: bool
    notes: tuple[str, ...]


def check_spec(spec: LinkSpec) -> None:
    """UserError where no line is named, or two are, or an interface that nobody has; nothing is opened."""
    if bool(spec.interface) == bool(spec.serial_url):
        both = "there are both; " if spec.interface else "the drive's line is missing; "
        raise UserError(
            f"{both}give either a CAN interface and its channel, such as socketcan and can0, or a serial port"
        )
    if spec.interface and spec.interface not in can.VALID_INTERFACES:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise UserError(f"{_name(spec)}: unknown CAN interface; known interfaces: {known}")


def open_link(spec: LinkSpec) -> Connection:
    """Open what `spec` names; UserError with the remedy when that can't be."""
    check_spec(spec)
    return _open_serial(spec) if spec.serial_url else _open_can(spec)


def _name(spec: LinkSpec) -> str:
    return f"{spec.interface}:{spec.channel}" if spec.channel else spec.interface


def _open_can(spec: LinkSpec) -> Connection:
    name = _name(spec)
    _check_net_device(spec)
    options: dict[str, object] = {"fd": spec.fd, "bitrate": spec.bitrate_bit_per_s, **spec.options}
    if spec.fd:
        options.setdefault("data_bitrate", spec.data_bitrate_bit_per_s)
    try:
        # ty: python-can accepts any option of the interface
        bus = can.Bus(channel=spec.channel or None, interface=spec.interface, ignore_config=True, **options)  # type: ignore[arg-type]
    except NotImplementedError as error:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise UserError(f"{name}: {_words(error)}; interfaces: {known}") from error
    except (can.CanError, OSError, ValueError, TypeError, ImportError, AttributeError) as error:
        raise UserError(f"{name}: can't be opened: {_words(error)}{_can_remedy(spec, error)}") from error
    notes: tuple[str, ...] = ()
    if spec.interface == "udp_multicast":
        notes = _keep_near(bus, spec)
    if all(hasattr(bus, method) for method in VIRTUAL_TIME):
        virtual = cast(VirtualTimeBus, bus)
        return Connection(VirtualTimeLink(virtual), VirtualClock(virtual), True, ())
    clock = MonotonicClock(spec.spin_ns)
    link = PythonCanLink(bus, clock, spec.interface in ECHOING, marks_own=spec.interface not in MARKS_OTHERS)
    return Connection(link, clock, False, notes)


def _keep_near(bus: can.BusABC, spec: LinkSpec) -> tuple[str, ...]:
    """Keep frames on this machine unless `hop_limit` is among the options; return the warning where it is."""
    hops = spec.options.get("hop_limit", 0)
    if hops != 0:
        return (f"udp_multicast: hop_limit is {hops}: whoever is in this network can read frames and send references",)
    try:
        keep_on_loopback(bus.fileno(), spec.channel or UdpMulticastBus.DEFAULT_GROUP_IPv6)
    except (OSError, ValueError) as error:
        bus.shutdown()
        raise UserError(
            f"udp_multicast:{spec.channel}: can't be limited to this computer: {_words(error)}; use an IPv4 group, "
            "such as "
            "--channel 239.74.163.2, or open it to the network with --option hop_limit=1"
        ) from error
    return ()


def _check_net_device(spec: LinkSpec) -> None:
    if spec.interface != "socketcan" or not spec.channel:
        return
    try:
        flags = int((NET_DEVICES / spec.channel / "flags").read_text(), 16)
    except (OSError, ValueError):
        return  # opening it says what is wrong
    if not flags & IFF_UP:
        raise UserError(
            f"socketcan:{spec.channel}: the device is down; "
            f"`ip link set {spec.channel} up type can bitrate {spec.bitrate_bit_per_s}`"
        )


def _can_remedy(spec: LinkSpec, error: Exception) -> str:
    if spec.interface == "udp_multicast":
        if "msgpack" in str(error):
            return "; install it: pip install msgpack"
        # python-can says so in words only; it knows no other reason to fail there.
        if "multicast IP network" in str(error) or error_number(error) in {errno.ENETUNREACH, errno.ENODEV}:
            return "; is there a route? `ip link set lo multicast on; ip route add 239.0.0.0/8 dev lo`"
    number = error_number(error)
    return f"; {_CAN_REMEDIES[number]}" if number in _CAN_REMEDIES else ""


def _open_serial(spec: LinkSpec) -> Connection:
    url = spec.serial_url
    port: serial.Serial | UdpPort
    try:
        if url.startswith(SCHEME):
            port = UdpPort(url)
        else:
            port = serial.serial_for_url(url, baudrate=spec.baudrate, timeout=0)
            if "://" not in url:
                port.exclusive = True
    except (serial.SerialException, OSError, ValueError) as error:
        number = error_number(error)
        remedy = f"; {_SERIAL_REMEDIES[number]}" if number in _SERIAL_REMEDIES else ""
        raise UserError(f"{url}: can't be opened: {_words(error)}{remedy}") from error
    clock = MonotonicClock(spec.spin_ns)
    return Connection(SerialLink(port, clock, spec.framing), clock, False, serial_notes(url, SERIAL_DEVICES))


def serial_notes(path: str, devices: Path) -> tuple[str, ...]:
    """Tell what makes a serial adapter slow: FTDI chips hold data back for 16 ms unless told otherwise."""
    timer = devices / Path(path).resolve().name / "device" / "latency_timer"  # /dev/serial/by-id/… is a link
    try:
        latency_ms = int(timer.read_text())
    except (OSError, ValueError):
        return ()
    if latency_ms <= 1:
        return ()
    return (f"{path}: the adapter holds data back for {latency_ms} ms; `echo 1 > {timer}` as root",)


def _words(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
