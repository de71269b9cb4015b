"""One run of the service from an open link to files on disk: what `bench` and `run` share."""

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from hil_forceps.bench.assembly import Settings, make_pipeline, metadata
from hil_forceps.bridge.adapters import Connection
from hil_forceps.bridge.bus_log import LoggedLink, LogReport, open_bus_log
from hil_forceps.bridge.results import ServiceConfig, ServiceResult, Telemetry
from hil_forceps.bridge.service import Service
from hil_forceps.data.recording.writer import RecordingReport, open_recorder
from hil_forceps.drives.port import DriveMachine
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError


class Plan(NamedTuple):
    """What to run and where to leave it."""

    rig: Rig
    settings: Settings
    drive: DriveMachine
    config: ServiceConfig
    recording: Path
    bus_log: Path
    about: Mapping[str, str]  # more for the recording's metadata


class SessionResult(NamedTuple):
    """How it ended, and what became of the files."""

    service: ServiceResult
    recording: RecordingReport
    bus_log: LogReport
    wall_s: float

    @property
    def failures(self) -> list[str]:
        """What was not recorded, in words; empty when all was."""
        dropped = [
            f"{name}: {report.dropped} entries dropped, the disk was too slow"
            for name, report in (("recording", self.recording), ("bus log", self.bus_log))
            if report.dropped and not report.failure
        ]
        return [text for text in (self.recording.failure, self.bus_log.failure) if text] + dropped


def stamps_are_host_time(rig: Rig) -> bool:
    """Tell whether a rig's drive sends no stamps of its own, so that samples are stamped by the host's clock."""
    return rig.drive_profile != "native"


def service_config(rig: Rig, duration_s: float, reset_fault: bool = False) -> ServiceConfig:
    """Return the settings of a rig's loop for a run of `duration_s` from the zero on."""
    return ServiceConfig(
        period_ns=round(rig.bench.host_period_s * 1e9),
        phase_ns=round(rig.bench.host_phase_s * 1e9),
        duration_ns=round(duration_s * 1e9),
        reset_fault=reset_fault,
    )


def run_session(
    connection: Connection,
    plan: Plan,
    stop_requested: Callable[[], bool] = lambda: False,
    telemetry: Callable[[Telemetry], None] | None = None,
) -> SessionResult:
    """Run the service to its end and close everything, whatever happens; UserError when a file can't be created."""
    link, clock = connection.link, connection.clock
    threaded = not connection.virtual_time
    try:
        pipeline = make_pipeline(plan.rig, plan.settings)
        recorder = open_recorder(plan.recording, metadata(plan.rig, plan.settings, plan.about), threaded)
        try:
            log = open_bus_log(plan.bus_log, clock.now_ns(), threaded)
        except UserError:
            recorder.close({"reason": "crashed", "message": "the bus log could not be opened"})
            raise
        logged = LoggedLink(link, clock, log)
        service = Service(logged, clock, plan.drive, pipeline, plan.config, recorder, stop_requested, telemetry)
        began = time.perf_counter()
        ending = {"reason": "crashed"}
        try:
            result = service.run()
            ending = {"reason": result.reason.value, "message": result.message}
            ending["counters"] = json.dumps({name: dict(values) for name, values in result.counters.items()})
        finally:
            recording_report, log_report = recorder.close(ending), log.close()
    finally:
        link.close()
    return SessionResult(result, recording_report, log_report, time.perf_counter() - began)
