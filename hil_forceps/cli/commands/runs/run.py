"""`hil-forceps run`: the service with a drive, real or simulated."""

import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Literal, NamedTuple

from hil_forceps.bench.assembly import Settings
from hil_forceps.bench.run_folder import RECORDING_NAME
from hil_forceps.bench.session import (
    Plan,
    SessionResult,
    run_axes,
    service_config,
    stamps_are_host_time,
)
from hil_forceps.bench.stopping import StopFlag, stopped_by_signals
from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.bridge.live.topics import description_of
from hil_forceps.cli.arguments.drive_line import named_rigs
from hil_forceps.cli.arguments.files import clear_runs, make_folder
from hil_forceps.cli.arguments.groups import OfControl, OfFaults, OfLine, OfLive, OfOutput, OfOutside
from hil_forceps.cli.arguments.options import interface_options
from hil_forceps.cli.arguments.references import open_references
from hil_forceps.cli.commands.runs.run_checks import (
    check_algorithm,
    check_duration,
    check_outside,
    check_rigs,
    checked_rate,
    motions,
    with_following_error,
)
from hil_forceps.cli.commands.runs.run_outcome import line_share, tell
from hil_forceps.cli.kernels import ready_kernels
from hil_forceps.cli.terminal.live_page import shown
from hil_forceps.cli.terminal.notes import note
from hil_forceps.cli.terminal.run_status import run_status
from hil_forceps.drives.line_use import LineUse
from hil_forceps.drives.registry import framing_for, machines_for, sample_period_s
from hil_forceps.live.view import LiveOptions, live_options
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import ProfileName


class Outside(NamedTuple):
    """Source of external references of the jaw; `address` is empty if there is none."""

    address: str
    token: Path | None
    timeout_s: float | None


def run(
    *,
    rig: tuple[Path, ...],
    out: OfOutput[Path],
    interface: OfLine[str] = "",
    channel: OfLine[str] = "",
    serial: OfLine[str] = "",
    baudrate: OfLine[int | None] = None,
    drive: OfLine[ProfileName | None] = None,
    option: OfLine[tuple[str, ...]] = (),
    algorithm: OfControl[str] = "kalman",
    compensate: OfControl[bool] = True,
    trajectory: OfControl[tuple[Path, ...]] = (),
    duration: OfControl[float | None] = None,
    bus_log: OfOutput[Literal["log", "asc", "blf"]] = "log",
    reset_fault: OfFaults[bool] = False,
    max_following_error: OfFaults[float | None] = None,
    go_on: OfFaults[bool] = False,
    overwrite: OfOutput[bool] = False,
    references: OfOutside[str] = "",
    references_token: OfOutside[Path | None] = None,
    references_timeout: OfOutside[float | None] = None,
    live: OfLive[bool] = False,
    live_control: OfLive[bool] = False,
    live_bind: OfLive[str] = "",
    foxglove: OfLive[bool] = False,
) -> int:
    """Control a motor driver on a CAN interface or serial port: estimate the load, compensate the stretch of the wire.

    Writes OUT/run.mcap (every sample and reference), OUT/bus.log (raw frames) and OUT/run.json (result, counters,
    timing). Ctrl-C and SIGTERM disable the drive before the program ends. Exit code 2 if the run ended early or with a
    fault: then OUT/fault.json has the last second, and `hil-forceps explain OUT` lists events and likely causes.

    With several --rig, one loop controls one axis for each on the same bus. Recording and result of each axis are in
    OUT/NAME, where NAME is the name of its rig file.

    Parameters
    ----------
    rig
        Rig file with the forceps, the drive's position loop, `bench:` and the `limits:` of the reference; may be
        repeated, one for each axis.
    out
        Folder for the results; created if it does not exist.
    interface
        python-can interface: socketcan, udp_multicast, slcan, pcan, ..., or virtual_forceps.
    channel
        Channel of that interface: can0, vcan0, ...
    serial
        Serial port, pyserial URL, or udp://ADDRESS:PORT (one packet in each datagram) instead of a CAN interface.
    baudrate
        Rate of the serial port in bit/s; default: the rig's for its drive, or 1 Mbit/s.
    drive
        Protocol of the motor driver, to be checked against `motor_driver:` of the rig.
    option
        KEY=VALUE for the python-can interface; may be repeated.
    algorithm
        Estimator: previous, improved_as_published, improved or kalman.
    compensate
        Send the compensated motor angle (equation 10); without it the stretch is only estimated.
    trajectory
        CSV file with the columns time_s and theta_j_rad; default: that of the paper, 90 to 10 degrees in 5 s. One for
        all axes, or one for each in the order of the rigs.
    duration
        Duration in s from the first operational sample; default: to the end of the trajectory, or 20 s.
    bus_log
        Format of the bus log.
    reset_fault
        Reset a fault that the drive has latched before the run.
    max_following_error
        End the run if the motor is further than this angle in degrees from its reference, or further than the rig's
        limits.following_error_max_rad. Use 0.5 for the first motion of a drive, without a load.
    go_on
        If an axis fails, the other axes continue; without it they are stopped.
    overwrite
        Delete a run that is in OUT; without it the command refuses such a folder.
    references
        PORT or ADDRESS:PORT that receives references of the jaw angle as UDP datagrams during the run, instead of a
        trajectory (docs/teleoperation.md). The default address is 127.0.0.1; any other requires a token.
    references_token
        With --references: file with the token that authenticates the senders.
    references_timeout
        With --references: time in s for which a reference is held; default: that of the gate, 0.05 s.
    live
        Show the run on a live page in the browser, only on this machine (docs/live.md).
    live_control
        With --live: buttons for emergency stop and clear on the page.
    live_bind
        With --live: PORT or ADDRESS:PORT of the page; default: a free port on 127.0.0.1.
    foxglove
        With --live: also send the data to Foxglove.
    """
    page = live_options(live=live, control=live_control, bind=live_bind, foxglove=foxglove)
    rigs = named_rigs(rig)
    check_algorithm(algorithm)
    link = LinkSpec(interface=interface, channel=channel, serial_url=serial, options=interface_options(option))
    rate = checked_rate(rig, rigs, link, baudrate, drive)
    machines = machines_for(list(rigs.values()))
    check_rigs(rig, rigs)
    rigs = with_following_error(rigs, max_following_error)
    check_duration(duration)
    check_outside(references, references_token, references_timeout, trajectory)
    points, duration_s = motions(trajectory, rig, rigs, duration) if not references else ([None] * len(rigs), duration)
    make_folder(out)
    clear_runs([out, *(out / name for name in rigs if len(rigs) > 1)], overwrite=overwrite)
    plans = []
    for (name, loaded), machine, motion in zip(rigs.items(), machines, points, strict=True):
        folder = out / name if len(rigs) > 1 else out
        make_folder(folder, inside=out)
        feedback_s = sample_period_s(loaded)
        ready_kernels(loaded, feedback_s)
        settings = Settings(algorithm, compensate, feedback_s, motion, same_clock=stamps_are_host_time(loaded))
        service = service_config(loaded, duration_s, reset_fault)
        about = {"interface": interface or serial, "channel": channel}
        name_in_several = name if len(rigs) > 1 else ""
        recording, log = folder / RECORDING_NAME, out / f"bus.{bus_log}"
        plans.append(Plan(loaded, settings, machine, service, recording, log, about, name_in_several))
    outside = Outside(references, references_token, references_timeout)
    use = LineUse()
    link = _of_rig(link, plans[0].rig, rate)
    results = _driven(link, plans, outside, page, use, go_on=go_on, title=", ".join(rigs))
    used = None if serial else line_share(use, results, plans[0].rig.bench)
    codes = [tell(result, plan, used) for result, plan in zip(results, plans, strict=True)]
    if len(plans) > 1 and used is not None:
        sys.stdout.write(f"the bus load was at most {100.0 * used:.0f} %\n")
    return max(codes)


def _of_rig(link: LinkSpec, rig: Rig, baudrate: int) -> LinkSpec:
    """Return the link with the rates of a rig; the rigs of several axes have the same."""
    return link._replace(
        fd=rig.bench.transport == "fd",
        bitrate_bit_per_s=rig.bench.bitrate_bit_per_s,
        data_bitrate_bit_per_s=rig.bench.data_bitrate_bit_per_s,
        baudrate=baudrate,
        framing=framing_for(rig),
    )


def _driven(
    link: LinkSpec,
    plans: Sequence[Plan],
    outside: Outside,
    page: LiveOptions | None,
    use: LineUse,
    *,
    go_on: bool,
    title: str,
) -> Sequence[SessionResult]:
    """Open the link and run the axes until they end or a signal comes; UserError if the link can't be opened."""
    connection = open_link(link)
    for each in connection.notes:
        note(each)
    flag = StopFlag()
    described = description_of(title, tuple(plan.name for plan in plans), time.monotonic_ns())
    with closing(connection.link), stopped_by_signals(flag), ExitStack() as stack:
        if (page is not None or outside.address) and connection.virtual_time:
            wanted = "--live" if page is not None else "--references"
            raise UserError(
                f"{wanted}: {link.interface} runs in virtual time; use a drive in real time (docs/live.md has one)"
            )
        remote = None
        if outside.address:
            remote = open_references([plan.rig for plan in plans], *outside)
            stack.callback(remote.close)
            note(f"waiting for references at UDP port {remote.port}; the drive gets torque when they arrive")
        view, show = stack.enter_context(shown(described, page)), stack.enter_context(run_status())
        return run_axes(connection, plans, flag.is_set, show, go_on=go_on, use=use, view=view, remote=remote)
