"""The simulated drive as a separate process in real time, on a python-can interface or a pseudo terminal.

It prints one line, `ready ...`, when it listens, and one line of JSON at its end; nothing else on standard output.
"""

import argparse
import gc
import json
import logging
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
from types import FrameType

from firmware_protocol.messages import DriveState
from hil_forceps.live.view import View, live_options, live_view
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError
from virtual_bus.bus.bit_timing import NS_PER_S
from virtual_bus.bus.faults import Fault, FaultInjector, FaultKind, Side, load_faults
from virtual_bus.bus.wire import LineCodec
from virtual_bus.drive import SimulatedDrive
from virtual_bus.drives.registry import SERIAL_LINES, SIMULATED_DRIVES, SimulatedMotorDriver
from virtual_bus.plant.load import paper_load
from virtual_bus.realtime.live import LiveTruth, description_of
from virtual_bus.realtime.loop import DEFAULT_SPIN_NS, FaultyWire, RealTimeLoop
from virtual_bus.realtime.serial_server import NATIVE, SerialServer
from virtual_bus.realtime.transports import CanTransport, open_can

_WARM_UP_NS = 20_000_000
_FIFO_PRIORITY = 20
SHORTEST_TRUTH_S = 1e-9  # keeps one row; a page sees each


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="hil-forceps drive",
        description="Simulated drive and forceps in real time, on a CAN interface or a pseudo terminal.",
        epilog="example: hil-forceps drive --rig configs/realistic.yaml --serial-pty /tmp/forceps",
    )
    parser.add_argument("--rig", required=True, metavar="FILE", help="rig file with the forceps and the drive")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--interface", metavar="NAME", help="python-can interface, such as udp_multicast or socketcan")
    where.add_argument("--serial-pty", metavar="LINK", help="create a pseudo terminal, and a link of this name to it")
    parser.add_argument("--channel", metavar="NAME", help="channel of the interface, such as 239.74.163.2 or vcan0")
    parser.add_argument(
        "--option",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="option of the interface, such as port=43113; may be repeated",
    )
    parser.add_argument(
        "--simulation",
        type=int,
        choices=(0, 1, 2),
        default=2,
        help="load: that of simulation 1 or 2 of the paper, 0 for none (default: 2)",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of sensor noise and faults (default: 0)")
    parser.add_argument("--fd", action="store_true", default=None, help="use CAN FD (default: as in the rig file)")
    parser.add_argument("--duration", type=_seconds, metavar="S", help="end after S seconds (default: run until ended)")
    parser.add_argument("--faults", metavar="FILE", help="fault schedule; its times count from the line `ready`")
    parser.add_argument("--live", action="store_true", help="show the true values on a live page, on this machine only")
    parser.add_argument("--live-bind", default="", metavar="ADDRESS:PORT", help="address of the live page")
    parser.add_argument("--foxglove", action="store_true", help="also send the data to Foxglove")
    parser.add_argument("--fifo", action="store_true", help="use real-time scheduling, if permitted")
    parser.add_argument(
        "--spin",
        type=_microseconds,
        default=DEFAULT_SPIN_NS,
        metavar="US",
        help="poll for US microseconds before each sample is due",
    )
    return parser


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError("must be more than 0 and less than 1e6 s")
    return value


def _microseconds(text: str) -> int:
    value = float(text)
    if not 0.0 <= value <= 1e5:
        raise argparse.ArgumentTypeError("must be from 0 to 1e5 µs")
    return round(value * 1000)


def _options(pairs: Sequence[str]) -> dict[str, str]:
    broken = [pair for pair in pairs if "=" not in pair]
    if broken:
        raise UserError([f"--option {pair}: must be KEY=VALUE, such as --option port=43113" for pair in broken])
    return {key: value for key, _, value in (pair.partition("=") for pair in pairs)}


def _faults(path: str | None) -> tuple[Fault, ...]:
    """Read the schedule; UserError for faults that need the simulated bus or the host's controller."""
    faults = () if path is None else load_faults(path)
    problems = [
        f"{path}: {fault.kind}: only possible on the simulated bus (virtual_forceps); remove it from the schedule"
        for fault in faults
        if fault.kind is FaultKind.CORRUPT_WIRE or (fault.kind is FaultKind.BUS_OFF and fault.sender is Side.HOST)
    ]
    if problems:
        raise UserError(problems)
    return faults


def _open(arguments: argparse.Namespace, is_fd: bool, codec: LineCodec) -> tuple[CanTransport | SerialServer, str]:
    if arguments.serial_pty is not None:
        if arguments.channel is not None or arguments.option:
            raise UserError("--channel and --option: only with --interface, not with --serial-pty; leave them out")
        server = SerialServer(arguments.serial_pty, codec)
        return server, f"serial {arguments.serial_pty} {server.device}"
    if arguments.channel is None:
        raise UserError("--interface: needs --channel; add it")
    transport = open_can(arguments.interface, arguments.channel, is_fd, _options(arguments.option))
    return transport, f"{arguments.interface} {arguments.channel}"


def _line_of(path: str, rig: Rig, serial_pty: str | None) -> LineCodec:
    """Return how the rig's drive packs frames on a serial line; UserError where its line is of the other kind."""
    profile = rig.drive_profile
    if profile == "native":
        return NATIVE
    if profile in SERIAL_LINES and serial_pty is None:
        raise UserError(f"{path}: motor_driver.profile: {profile} is on a serial line; give --serial-pty LINK")
    if profile not in SERIAL_LINES and serial_pty is not None:
        raise UserError(f"{path}: motor_driver.profile: {profile} is on a CAN bus; give --interface and --channel")
    return SERIAL_LINES.get(profile, NATIVE)


def _drive(
    rig: Rig, simulation: int, seed: int, is_fd: bool, truth_s: float = 0.0
) -> SimulatedDrive | SimulatedMotorDriver:
    load = paper_load(simulation)
    if rig.drive_profile != "native":
        return SIMULATED_DRIVES[rig.drive_profile](rig, load, seed, truth_s)
    return SimulatedDrive(rig, load, seed, fd=is_fd, truth_duration_s=truth_s, load_restarts=True)


def _show(view: View, drive: SimulatedDrive | SimulatedMotorDriver, loop: RealTimeLoop) -> None:
    """Have a live page see what really is."""

    def state() -> DriveState | None:
        return drive.machine.state if isinstance(drive, SimulatedDrive) else None

    def counts() -> Mapping[str, Mapping[str, object]]:
        return {"loop": loop.counters(), "drive": _counts(drive)}

    drive.truth.observer = LiveTruth(view.writer, state, counts).see


def _counts(drive: SimulatedDrive | SimulatedMotorDriver) -> dict[str, object]:
    """Return what a drive counted, and where the project's own stands."""
    if isinstance(drive, SimulatedDrive):
        return {**drive.machine.counters, **drive.counters, "state": drive.machine.state.name}
    return dict(drive.counters)


def _warm_up(rig: Rig, is_fd: bool) -> None:
    """Run a drive that nobody sees, so that compiling doesn't make the first samples late."""
    drive = _drive(rig, 1, 0, is_fd)
    drive.wake(_WARM_UP_NS)
    drive.take_outbox()


def _schedule_fifo() -> str:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_FIFO_PRIORITY))
    except OSError as error:
        return f"other (fifo: {error.strerror})"
    return "fifo"


def _say(line: str) -> None:
    """Write a line at once; a parent that has stopped listening is no reason to end the drive."""
    with suppress(BrokenPipeError):
        sys.stdout.write(line + "\n")
        sys.stdout.flush()


def _serve(arguments: argparse.Namespace) -> Mapping[str, object]:
    rig = load_rig(arguments.rig)
    codec = _line_of(arguments.rig, rig, arguments.serial_pty)
    is_native = rig.drive_profile == "native"
    is_fd = rig.bench.transport == "fd" if arguments.fd is None else bool(arguments.fd)
    faults = _faults(arguments.faults)
    shown = live_options(live=arguments.live, control=False, bind=arguments.live_bind, foxglove=arguments.foxglove)
    drive = _drive(rig, arguments.simulation, arguments.seed, is_fd, 0.0 if shown is None else SHORTEST_TRUTH_S)
    _warm_up(rig, is_fd)
    transport, name = _open(arguments, is_fd, codec)
    page = nullcontext() if shown is None else live_view(description_of(f"{name}: truth"), shown)
    try:
        period_ns = round(rig.require_drive().sample_time_s * NS_PER_S)
        wire = None
        if faults:
            wire = FaultyWire(FaultInjector(faults, arguments.seed), drive.trip)
        loop = RealTimeLoop(drive, transport, period_ns, wire, arguments.spin, is_native=is_native)

        def stop(_signal: int, _frame: FrameType | None) -> None:
            loop.stop()

        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, stop)
        scheduler = _schedule_fifo() if arguments.fifo else "other"
        gc.collect()
        gc.freeze()
        settings = rig.motor_driver
        node = rig.bench.node_id if settings is None or is_native else settings.node_id
        with page as view:
            if view is not None:
                _show(view, drive, loop)
                sys.stderr.write("".join(f"note: {each}\n" for each in view.notes()))
                sys.stderr.flush()
            _say(f"ready {name} node {node} period_us {period_ns // 1000}")
            loop.run(None if arguments.duration is None else round(arguments.duration * NS_PER_S))
    finally:
        transport.close()
    return {
        "transport_name": name,
        "period_s": period_ns / NS_PER_S,
        "scheduler": scheduler,
        **loop.summary(),
        "drive": _counts(drive),
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Run the drive process; 0 at a clean end, 2 with one line per problem on standard error."""
    arguments = _parser().parse_args(argv)
    logging.getLogger("can").setLevel(logging.ERROR)  # every problem is told once, by us
    try:
        summary = _serve(arguments)
    except UserError as error:
        sys.stderr.write("".join(f"hil-forceps: {problem}\n" for problem in error.problems))
        return 2
    _say(json.dumps(summary))
    return 0
