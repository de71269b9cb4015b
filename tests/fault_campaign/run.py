"""One run of the service under a schedule, in virtual time, and all that is known of it afterwards."""

import hashlib
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any, Final

from firmware_protocol.host.samples import RawSample
from hil_forceps.bench.assembly import Settings, make_pipeline, metadata
from hil_forceps.bench.session import SessionResult
from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.links.can_link import VirtualTimeLink
from hil_forceps.bridge.logs.bus_log import LogReport
from hil_forceps.bridge.results import ServiceConfig, ServiceResult
from hil_forceps.bridge.service import Service
from hil_forceps.data.recording.reader import Recording, read_recording
from hil_forceps.data.recording.writer import Recorder, RecordingReport, Reference
from hil_forceps.drives.registry import machine_for, sample_period_s
from hil_forceps.rig import Rig
from tests.fault_campaign.bus import world_of
from tests.fault_campaign.drive import FaultyDrive
from tests.fault_campaign.host import Disk, HostClock, KilledError, WatchedBus, stall, watch_references
from tests.fault_campaign.rigs import RUN_NS, rig_of, trajectory_of
from tests.fault_campaign.schedule import Kind, Schedule
from virtual_bus import worlds
from virtual_bus.interface import VirtualForcepsBus

AFTER_NS: Final = 200_000_000  # of the world without a host: every drive's watchdog must have acted by then
_channels = count()


@dataclass
class Tap:
    """A recorder that keeps in memory, too, what it was handed."""

    recorder: Recorder
    samples: list[RawSample] = field(default_factory=list)
    references: list[tuple[Reference, int, int]] = field(default_factory=list)  # with time of sending, outcome
    bench_readings: int = 0

    @property
    def failure(self) -> str:
        """See `Recorder`."""
        return self.recorder.failure

    def sample(self, raw: RawSample, *more: Any) -> None:
        """See `Recorder`."""
        self.samples.append(raw)
        self.recorder.sample(raw, *more)

    def reference(self, reference: Reference, sent_ns: int, outcome: int, sequence: int) -> None:
        """See `Recorder`."""
        self.references.append((reference, sent_ns, int(outcome)))
        self.recorder.reference(reference, sent_ns, outcome, sequence)

    def bench(self, raw: Any) -> None:
        """See `Recorder`."""
        self.bench_readings += 1
        self.recorder.bench(raw)


@dataclass
class Record:
    """All that is known of a run."""

    schedule: Schedule
    rig: Rig
    config: ServiceConfig
    drives: list[FaultyDrive]
    bus: WatchedBus
    clock: HostClock
    tap: Tap
    disk: Disk
    machine_samples: int  # that the drive's machine handed out
    counters: Mapping[str, Mapping[str, int]]  # of the drive's machine and the pipeline
    ended_ns: int  # bus time at which the service ended
    result: ServiceResult | None  # None where the process was killed, or an exception came out
    report: RecordingReport | None
    crash: str

    @property
    def was_killed(self) -> bool:
        """Whether the process was."""
        return self.clock.is_dead

    @property
    def exit_code(self) -> int | None:
        """What `hil-forceps run` would return; None where it returned nothing."""
        if self.result is None or self.report is None:
            return None
        session = SessionResult(self.result, self.report, LogReport(0, 0, ""), 0.0)
        return 0 if self.result.ok and not session.failures else 2

    def recording(self) -> Recording:
        """Return what the public reader makes of the file."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "run.mcap"
            path.write_bytes(self.disk.content)
            return read_recording(path)

    def digest(self) -> str:
        """Return a number for everything that the run did: frames with their times, the drive's course, the file."""
        whole = self.bus.digest.copy()
        whole.update(self.disk.content)
        for drive in self.drives:
            whole.update(repr(drive.forceps.moments).encode())
        whole.update(repr((self.result, self.report, self.crash, self.ended_ns)).encode())
        return hashlib.sha256(whole.digest()).hexdigest()


def config_of(rig: Rig) -> ServiceConfig:
    """Return the loop's settings: the rig's, with time-outs short enough for many runs."""
    return ServiceConfig(
        period_ns=round(rig.bench.host_period_s * 1e9),
        phase_ns=round(rig.bench.host_phase_s * 1e9),
        duration_ns=RUN_NS,
        connect_timeout_ns=900_000_000,
        enable_timeout_ns=500_000_000,
        disable_timeout_ns=400_000_000,
    )


def run(schedule: Schedule) -> Record:
    """Run the service under a schedule; nothing that the service does comes out as an exception."""
    rig = rig_of(schedule.profile)
    references: set[Any] = set()
    world, drives = world_of(schedule, references)
    channel = f"fault campaign {next(_channels)}"
    worlds.join(channel, None, lambda: world)
    bus = VirtualForcepsBus(channel)
    try:
        clock = HostClock(bus, schedule)
        return _serve(schedule, rig, clock, WatchedBus(bus, clock, schedule, references), drives)
    finally:
        bus.shutdown()
        worlds.leave(channel)


def _serve(schedule: Schedule, rig: Rig, clock: HostClock, bus: WatchedBus, drives: list[FaultyDrive]) -> Record:
    same_clock = rig.drive_profile != "native"
    period_s = sample_period_s(rig)
    settings = Settings("kalman", schedule.seed % 4 != 1, period_s, trajectory_of(schedule.seed), same_clock)
    pipeline = make_pipeline(rig, settings)
    pipeline._step = stall(pipeline._step, clock, schedule)
    machine = machine_for(rig)
    watch_references(machine, bus)
    taken = _count_samples(machine)
    disk = Disk()
    recorder = Recorder(disk, metadata(rig, settings, {}), threaded=False)
    for fault in schedule.of_kind(Kind.FULL_DISK):
        disk.room = disk.tell() + round(fault.size)
    tap = Tap(recorder)
    config = config_of(rig)
    axis = Axis(machine, pipeline, config, tap)  # type: ignore[arg-type]
    service = Service(VirtualTimeLink(bus), clock, [axis], config)
    result, report, crash = None, None, ""
    try:
        (result,) = service.run()
    except KilledError:
        disk.close()
    except Exception as error:  # whatever comes out of the service is a finding
        crash = f"{type(error).__name__}: {error}"
    ended_ns = clock.bus.now_ns()
    if not clock.is_dead:
        report = recorder.close({"reason": result.reason.value if result else "crashed"})
    clock.bus.advance_until_ns(ended_ns + AFTER_NS)
    counters = {"machine": dict(machine.counters), "pipeline": dict(pipeline.counters)}
    return Record(
        schedule, rig, config, drives, bus, clock, tap, disk, taken[0], counters, ended_ns, result, report, crash
    )


def _count_samples(machine: Any) -> list[int]:
    """Have the machine's samples counted as it hands them out."""
    taken, take = [0], machine.take_samples

    def take_samples() -> list[RawSample]:
        samples: list[RawSample] = take()
        taken[0] += len(samples)
        return samples

    machine.take_samples = take_samples
    return taken
