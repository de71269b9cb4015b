"""One run of the service from an open link to files on disk, for `bench` and `run`."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from hil_forceps.bench.assembly import Settings, make_pipeline, metadata
from hil_forceps.bench.fault_file import KeptFault, fault_content, fault_path, write_fault
from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.fault import CRASHED
from hil_forceps.bridge.links.adapters import Connection
from hil_forceps.bridge.live.sink import LiveSink
from hil_forceps.bridge.logs.bus_log import BusLog, LoggedLink, LogReport, open_bus_log
from hil_forceps.bridge.logs.flight_recorder import Recent
from hil_forceps.bridge.ports import MotionWatch
from hil_forceps.bridge.results import ServiceConfig, ServiceResult, StopReason, Telemetry
from hil_forceps.bridge.service import Service
from hil_forceps.bridge.teleoperation.udp_server import UdpReferences
from hil_forceps.data.recording.format import BEGUN_KEY, FAULT_NAME
from hil_forceps.data.recording.writer import Recorder, RecordingReport, open_recorder
from hil_forceps.drives.line_use import LineUse
from hil_forceps.drives.port import DriveMachine
from hil_forceps.drives.registry import current_limit_A
from hil_forceps.drives.supervision.following_error import FollowingErrorWatch
from hil_forceps.drives.supervision.runaway import RunawayWatch
from hil_forceps.live.view import View
from hil_forceps.rig import Rig


class Plan(NamedTuple):
    """The run of one axis, and the paths of its results."""

    rig: Rig
    settings: Settings
    drive: DriveMachine
    config: ServiceConfig
    recording: Path
    bus_log: Path  # one for all axes: that of the first plan
    about: Mapping[str, str]  # further metadata of the recording
    name: str = ""  # of the axis, if there are several


class SessionResult(NamedTuple):
    """How the run of an axis ended, and the state of its files."""

    service: ServiceResult
    recording: RecordingReport
    bus_log: LogReport
    wall_s: float
    fault: KeptFault | None = None  # if the run did not end normally

    @property
    def failures(self) -> list[str]:
        """What was not recorded, in words; empty if all was."""
        dropped = [
            f"{name}: {report.dropped} entries dropped, the disk was too slow"
            for name, report in (("recording", self.recording), ("bus log", self.bus_log))
            if report.dropped and not report.failure
        ]
        return [text for text in (self.recording.failure, self.bus_log.failure) if text] + dropped


def stamps_are_host_time(rig: Rig) -> bool:
    """Return whether a rig's drive sends no stamps, so that samples get stamps of the host's clock."""
    return rig.drive_profile != "native"


def service_config(rig: Rig, duration_s: float | None, reset_fault: bool = False) -> ServiceConfig:
    """Return the settings of a rig's loop for a run of `duration_s` from the zero on; None: until it is stopped."""
    return ServiceConfig(
        period_ns=round(rig.bench.host_period_s * 1e9),
        phase_ns=round(rig.bench.host_phase_s * 1e9),
        duration_ns=None if duration_s is None else round(duration_s * 1e9),
        reset_fault=reset_fault,
    )


def run_session(
    connection: Connection,
    plan: Plan,
    stop_requested: Callable[[], bool] = lambda: False,
    telemetry: Callable[[Telemetry], None] | None = None,
    view: View | None = None,
) -> SessionResult:
    """Run the service with one axis; as `run_axes`."""
    return run_axes(connection, [plan], stop_requested, telemetry, view=view)[0]


def run_axes(
    connection: Connection,
    plans: Sequence[Plan],
    stop_requested: Callable[[], bool] = lambda: False,
    telemetry: Callable[[Telemetry], None] | None = None,
    *,
    go_on: bool = False,
    use: LineUse | None = None,
    view: View | None = None,
    remote: UdpReferences | None = None,
) -> tuple[SessionResult, ...]:
    """Run the service to its end, and close link and files in any case; UserError if a file can't be created.

    `go_on`: if an axis fails, the others continue. `use`: counts the frames. `view`: live page of the run. `remote`:
    source of external references, with an input for each plan.
    """
    link, clock = connection.link, connection.clock
    threaded = not connection.virtual_time
    # Virtual time has no date: the same seed gives the same bytes.
    begun = {} if connection.virtual_time else {BEGUN_KEY: datetime.now(UTC).isoformat(timespec="seconds")}
    recorders: list[Recorder] = []
    live = None if view is None else _live_sink(view, plans)
    ending: Sequence[Mapping[str, str]] = [{"reason": CRASHED}] * len(plans)
    try:
        with ExitStack() as files:
            axes = []
            for place, plan in enumerate(plans):
                fault_path(plan.recording).unlink(missing_ok=True)  # of a run before
                outside = None if remote is None else remote.inputs[place]
                pipeline = make_pipeline(plan.rig, plan.settings, outside)
                about = metadata(plan.rig, plan.settings, {**plan.about, **begun})
                recorder = open_recorder(plan.recording, about, threaded)
                recorders.append(recorder)
                files.callback(recorder.close, {"reason": CRASHED, "message": "another file could not be opened"})
                observer = None if live is None else live.axes[place]
                watches = motion_watches(plan.rig)
                axes.append(Axis(plan.drive, pipeline, plan.config, recorder, plan.name, watches, observer, outside))
            log = open_bus_log(plans[0].bus_log, clock.now_ns(), threaded, use)
            files.pop_all()
        logged = LoggedLink(link, clock, log)
        service = Service(
            logged, clock, axes, plans[0].config, stop_requested, telemetry, go_on=go_on, live=live, remote=remote
        )
        began = time.perf_counter()
        crash = ""
        try:
            results = service.run()
            ending = [_ending(result) for result in results]
        except BaseException as error:
            crash = f"{type(error).__name__}: {error}"
            raise
        finally:
            log_report = log.close()
            lines = log.recent()
            kept = [
                fault_content(axis, plan.rig, service, _recent(recorder, lines, log, service), crash)
                for axis, recorder, plan in zip(axes, recorders, plans, strict=True)
            ]
            reports = [
                recorder.close(said, {} if content is None else {FAULT_NAME: content})
                for recorder, said, content in zip(recorders, ending, kept, strict=True)
            ]
            faults = [
                write_fault(axis, plan.recording, content)
                for axis, plan, content in zip(axes, plans, kept, strict=True)
            ]
    finally:
        link.close()
    wall_s = time.perf_counter() - began
    return tuple(
        SessionResult(result, report, log_report, wall_s, fault)
        for result, report, fault in zip(results, reports, faults, strict=True)
    )


def motion_watches(rig: Rig) -> dict[StopReason, MotionWatch]:
    """Return what watches the motion of a rig's drive, each where the rig has the limit for it."""
    watches: dict[StopReason, MotionWatch] = {}
    if (limit_A := current_limit_A(rig)) is not None:
        watches[StopReason.RUNAWAY] = RunawayWatch(limit_A)
    if (max_error_rad := rig.limits.following_error_max_rad) is not None:
        watches[StopReason.FOLLOWING_ERROR] = FollowingErrorWatch(max_error_rad)
    return watches


def _live_sink(view: View, plans: Sequence[Plan]) -> LiveSink:
    return LiveSink(view.writer, [plan.rig.plant() for plan in plans], control=view.options.control)


def _recent(recorder: Recorder, lines: Sequence[str], log: BusLog, service: Service) -> Recent:
    return Recent(recorder.recent(), lines, log.begin_ns, service.lateness)


def _ending(result: ServiceResult) -> dict[str, str]:
    counters = json.dumps({name: dict(values) for name, values in result.counters.items()})
    stages = json.dumps(result.stages)
    return {"reason": result.reason.value, "message": result.message, "counters": counters, "stages": stages}
