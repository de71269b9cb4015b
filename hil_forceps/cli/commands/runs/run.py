"""`hil-forceps run`: the service against a drive, real or simulated."""

import json
import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any, Literal

from rich.status import Status

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
from hil_forceps.bridge.links.adapters import LinkSpec, check_spec, open_link
from hil_forceps.bridge.live_topics import description_of
from hil_forceps.bridge.results import Telemetry
from hil_forceps.cli.arguments.drive_line import line_rate, named_rigs
from hil_forceps.cli.arguments.files import clear_runs, make_folder, named
from hil_forceps.cli.arguments.groups import OfControl, OfFaults, OfLine, OfLive, OfOutput, OfOutside
from hil_forceps.cli.arguments.options import interface_options
from hil_forceps.cli.arguments.references import open_references
from hil_forceps.cli.arguments.trajectory_file import check_trajectory, read_trajectory
from hil_forceps.cli.kernels import ready_kernels
from hil_forceps.cli.terminal.fault_lines import fault_lines, told_reason
from hil_forceps.cli.terminal.gate_words import gate_data, gate_lines, since_start_s
from hil_forceps.cli.terminal.live_page import shown
from hil_forceps.cli.terminal.notes import is_quiet, note, note_console
from hil_forceps.cli.terminal.progress import last_told
from hil_forceps.control.trajectories import PAPER_TRAJECTORY, Trajectory
from hil_forceps.drives.line_use import LineUse
from hil_forceps.drives.lint import findings
from hil_forceps.drives.profile import Finding
from hil_forceps.drives.registry import framing_for, machines_for, sample_period_s
from hil_forceps.drives.several import findings as findings_of_several
from hil_forceps.estimation.registry import ESTIMATOR_IDS
from hil_forceps.live.view import live_options
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import BenchSettings, ProfileName

EXIT_RUN_FAILED = 2


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
    """Estimate and compensate against a motor driver on any python-can interface or pyserial URL.

    Writes OUT/run.mcap (every sample and reference), OUT/bus.log (raw frames) and OUT/run.json (result, counters,
    timing). Ctrl-C and SIGTERM disable the drive first. Exit code 2 when the run did not end as it was meant to: then
    OUT/fault.json has the last second, and `hil-forceps explain OUT` tells what happened.

    Several --rig: as many axes on one bus in one loop; recording and result of each are in OUT/NAME, by the name of its
    rig file.

    Parameters
    ----------
    rig
        Rig file with the forceps, the drive's loop, `bench:` and, always here, `limits:` of the reference; may be
        repeated, for an axis each.
    out
        Folder for the results; made if it isn't there.
    interface
        python-can interface: socketcan, udp_multicast, slcan, pcan, ..., or virtual_forceps.
    channel
        Channel of that interface: can0, vcan0, ...
    serial
        Serial port, pyserial URL, or udp://ADDRESS:PORT (a packet a datagram) instead of a CAN interface.
    baudrate
        Of the serial port; without it 1 Mbit/s, or what the rig says of its drive's line.
    drive
        What the motor driver speaks, as a check against `motor_driver:` of the rig.
    option
        KEY=VALUE for the python-can interface; may be repeated.
    algorithm
        Estimator: previous, improved_as_published, improved or kalman.
    compensate
        Send the compensated motor angle (10); without it the elongation is only estimated.
    trajectory
        CSV with the columns time_s and theta_j_rad; without it the paper's: 90 to 10 degrees in 5 s. One for all axes,
        or one for each in their order.
    duration
        Seconds from the first operational sample; without it the run lasts to the end of the trajectory, or 20 s.
    bus_log
        Format of the raw bus log.
    reset_fault
        Clear a fault that the drive holds from before.
    go_on
        Where one axis fails the others go on; without it they are stopped.
    overwrite
        Write over the run that OUT holds; without it that is refused.
    references
        PORT or ADDRESS:PORT where references of the jaw's angle are taken while it runs, as UDP datagrams, instead of a
        trajectory (docs/teleoperation.md). Without an address 127.0.0.1; another one wants a token.
    references_token
        With --references: file with the token that senders prove to have.
    references_timeout
        With --references: seconds for which a reference is held; without it as long as the gate holds one, 0.05 s.
    live
        Show the run while it lasts, on a page that only this machine reaches (docs/live.md).
    live_control
        With --live: emergency stop and clear on the page.
    live_bind
        With --live: PORT or ADDRESS:PORT of the page; without it a free port on 127.0.0.1.
    foxglove
        With --live: the same data to Foxglove, too.
    """
    page = live_options(live=live, control=live_control, bind=live_bind, foxglove=foxglove)
    rigs = named_rigs(rig)
    _check_algorithm(algorithm)
    options = interface_options(option)
    rates = set()
    for path, loaded in zip(rig, rigs.values(), strict=True):
        _check_profile(path, loaded, drive)
        rates.add(line_rate(path, loaded, interface, serial, baudrate))
    check_spec(LinkSpec(interface=interface, channel=channel, serial_url=serial))
    machines = machines_for(list(rigs.values()))
    for path, loaded in zip(rig, rigs.values(), strict=True):
        _check_settings(str(path), findings(loaded))
        with named(path):
            loaded.plant()  # what every estimator needs; told before anything is opened
    if len(rigs) > 1:
        _check_settings(" ".join(map(str, rig)), findings_of_several(rigs))
    if duration is not None and not (math.isfinite(duration) and duration > 0.0):
        raise UserError(f"--duration {duration}: must be a positive number of seconds")
    _check_outside(references, references_token, references_timeout, trajectory)
    points, duration_s = _motions(trajectory, rig, rigs, duration) if not references else ([None] * len(rigs), duration)
    make_folder(out)
    clear_runs([out, *(out / name for name in rigs if len(rigs) > 1)], overwrite=overwrite)
    plans = []
    for (name, loaded), machine, motion in zip(rigs.items(), machines, points, strict=True):
        folder = out / name if len(rigs) > 1 else out
        make_folder(folder, inside=out)
        feedback_s = sample_period_s(loaded)
        ready_kernels(loaded, feedback_s)
        plans.append(
            Plan(
                loaded,
                Settings(algorithm, compensate, feedback_s, motion, same_clock=stamps_are_host_time(loaded)),
                machine,
                service_config(loaded, duration_s, reset_fault),
                recording=folder / RECORDING_NAME,
                bus_log=out / f"bus.{bus_log}",
                about={"interface": interface or serial, "channel": channel},
                name=name if len(rigs) > 1 else "",
            )
        )
    bench = next(iter(rigs.values())).bench
    link = LinkSpec(
        interface=interface,
        channel=channel,
        serial_url=serial,
        fd=bench.transport == "fd",
        bitrate_bit_per_s=bench.bitrate_bit_per_s,
        data_bitrate_bit_per_s=bench.data_bitrate_bit_per_s,
        baudrate=max(rates),
        options=options,
        framing=framing_for(loaded),
    )
    connection = open_link(link)
    for each in connection.notes:
        note(each)
    flag, use = StopFlag(), LineUse()
    described = description_of(", ".join(rigs), tuple(plan.name for plan in plans), time.monotonic_ns())
    with closing(connection.link), stopped_by_signals(flag), ExitStack() as stack:
        if (page is not None or references) and connection.virtual_time:
            wanted = "--live" if page is not None else "--references"
            raise UserError(f"{wanted}: {interface} runs in virtual time; docs/live.md has a drive by the clock")
        remote = None
        if references:
            remote = open_references(list(rigs.values()), references, references_token, references_timeout)
            stack.callback(remote.close)
            note(f"waiting for references at UDP port {remote.port}; the drive gets torque when there are some")
        view, show = stack.enter_context(shown(described, page)), stack.enter_context(_status())
        results = run_axes(connection, plans, flag.is_set, show, go_on=go_on, use=use, view=view, remote=remote)
    used = None if serial else _line_share(use, results, bench)
    codes = [_tell(result, plan, used) for result, plan in zip(results, plans, strict=True)]
    if len(plans) > 1 and used is not None:
        sys.stdout.write(f"the bus was used by {100.0 * used:.0f} % at most\n")
    return max(codes)


def _check_outside(references: str, token: Path | None, timeout_s: float | None, trajectory: tuple[Path, ...]) -> None:
    """UserError for options that don't go together."""
    if references and trajectory:
        raise UserError("--references and --trajectory: the jaw follows one of them")
    if not references:
        wanting = {"--references-token": token, "--references-timeout": timeout_s}
        if extra := [name for name, given in wanting.items() if given is not None]:
            raise UserError(f"{extra[0]} goes with --references")


def _motions(
    trajectory: tuple[Path, ...], paths: Sequence[Path], rigs: Mapping[str, Rig], duration: float | None
) -> tuple[list[Trajectory | None], float]:
    """Return the trajectory of each axis, and how long the run lasts; UserError where one is beyond the limits."""
    points = _trajectories(trajectory, len(rigs))
    last_s = 20.0 if not trajectory else max(each.times_s[-1] for each in points)
    duration_s = max(last_s, 1e-3) if duration is None else duration
    sources = [*trajectory] if len(trajectory) in {0, len(rigs)} else [*trajectory] * len(rigs)
    for place, (path, loaded) in enumerate(zip(paths, rigs.values(), strict=True)):
        check_trajectory(sources[place] if sources else None, points[place], duration_s, path, loaded)
    return [*points], duration_s


def _trajectories(paths: Sequence[Path], axes: int) -> list[Trajectory]:
    """Return the trajectory of each axis; UserError where their number doesn't fit."""
    if len(paths) not in {0, 1, axes}:
        raise UserError(f"--trajectory: there are {len(paths)} for {axes} axes; give one, or one for each")
    points = [read_trajectory(path) for path in paths] or [PAPER_TRAJECTORY]
    return points * axes if len(points) == 1 else points


def _line_share(use: LineUse, results: Sequence[SessionResult], bench: BenchSettings) -> float:
    """Return the share of the run's time for which frames were on the bus, at most."""
    period = results[0].service.timing["period"]
    lasted_s = (period["mean_us"] or 0.0) * 1e-6 * period["count"]
    return use.time_s(bench.bitrate_bit_per_s, bench.data_bitrate_bit_per_s) / lasted_s if lasted_s > 0.0 else 0.0


def _check_profile(path: Path, rig: Rig, wanted: str | None) -> None:
    """UserError where a drive is asked for that the rig doesn't describe."""
    if wanted is not None and wanted != rig.drive_profile:
        raise UserError(
            f"--drive {wanted}: {path} describes a drive that speaks {rig.drive_profile}; give its `motor_driver:` "
            "(docs/drives.md has an example for each)"
        )


def _check_algorithm(name: str) -> None:
    if name not in ESTIMATOR_IDS:
        raise UserError(f"--algorithm: unknown algorithm '{name}'; there are {', '.join(ESTIMATOR_IDS)}")


def _check_settings(where: str, found: Sequence[Finding]) -> None:
    """Print the notes of `hil-forceps check`; UserError for its problems."""
    problems = [f"{where}: {each.key}: {each.text}" for each in found if each.level == "problem"]
    if problems:
        raise UserError(problems)
    for each in found:
        note(f"{where}: {each.key}: {each.text}")


@contextmanager
def _status() -> Iterator[Any]:
    """Show the run on a terminal; elsewhere, such as in a log file, a line every few seconds."""
    console = note_console()
    if is_quiet():
        yield None
        return
    if not console.is_terminal:
        with last_told(_line) as show:
            yield show
        return
    with Status("connecting", console=console) as status:

        def show(seen: Telemetry) -> None:
            status.update(
                f"{seen.axis} {seen.stage.value} {seen.time_s:6.2f} s  θ_m {seen.theta_m_rad:+.4f} rad  "
                f"τ_w {seen.tau_w_N_m * 1e3:+.3f} mN m  x {seen.elongation_m * 1e6:+.1f} µm  "
                f"sent {seen.frames_sent}  received {seen.frames_received}  overruns {seen.overruns}"
            )

        yield show


def _line(seen: Telemetry) -> str:
    axis = f"{seen.axis} " if seen.axis else ""
    return (
        f"{axis}{seen.stage.value}, {seen.frames_received} frames received, {seen.frames_sent} sent, "
        f"{seen.overruns} overruns"
    )


def _tell(session: SessionResult, plan: Plan, line_share: float | None) -> int:
    """Write `run.json` beside the recording, and the outcome to the terminal; return the exit code."""
    result, folder = session.service, plan.recording.parent
    content: dict[str, Any] = {
        "reason": result.reason.value,
        "message": result.message,
        "drive_disabled": result.drive_disabled,
        "recording": session.recording._asdict(),
        "bus_log": session.bus_log._asdict(),
        "counters": {name: dict(values) for name, values in result.counters.items()},
        "timing": dict(result.timing),
        "stages_s": {stage: since_start_s(result, time_ns) for time_ns, stage in result.stages},
        "gate": gate_data(result),
    }
    if session.fault is not None:
        content["fault"] = {**told_reason(session.fault.reason), "file": session.fault.path.name}
    if line_share is not None:
        content["bus_share_at_most"] = round(line_share, 4)
    failures = list(session.failures)
    try:
        (folder / "run.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        failures.append(f"{folder}/run.json: can't be written: {error.strerror}")
    said = f"{plan.name}: " if plan.name else ""
    for failure in failures:
        sys.stderr.write(f"hil-forceps: {said}{failure}\n")
    for line in gate_lines(result):
        note(f"{said}{line}")
    if not result.ok:
        lines = [result.message] if session.fault is None else fault_lines(session.fault, result.message, folder)
        sys.stderr.write(f"hil-forceps: {said}" + "\n".join(lines) + "\n")
        return EXIT_RUN_FAILED
    age = result.timing["age"]
    sys.stdout.write(
        f"{said}{result.message}; {result.counters['service']['references_sent']} references sent, sample to reference "
        f"p50 {age['p50_us']} µs, p99 {age['p99_us']} µs, max {age['max_us']} µs; results are in {folder}/\n"
    )
    return EXIT_RUN_FAILED if failures else 0
