"""`Service`: estimation and compensation with a motor driver, real or simulated, on any link."""

import math
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType

import numpy as np

from firmware_protocol.messages import DriveState
from hil_forceps.api.arguments import check_duration, check_motion, check_text, check_whole, kind
from hil_forceps.api.estimator import Estimates
from hil_forceps.api.runs import RigSource, as_rig
from hil_forceps.bench.assembly import Settings, make_pipeline
from hil_forceps.bench.run_folder import RECORDING_NAME, RUN_FILES
from hil_forceps.bench.session import Plan, SessionResult, run_session, service_config, stamps_are_host_time
from hil_forceps.bench.stopping import StopFlag, stopped_by_signals
from hil_forceps.bridge.links.adapters import LinkSpec, check_spec, open_link
from hil_forceps.bridge.results import Telemetry
from hil_forceps.control.requests import first_excess
from hil_forceps.control.trajectories import PAPER_TRAJECTORY, Trajectory
from hil_forceps.data.recording.reader import Recording, read_recording
from hil_forceps.data.run import Run
from hil_forceps.drives.compatibility.lint import findings
from hil_forceps.drives.registry import framing_for, machine_for, maker_profile, sample_period_s
from hil_forceps.estimation.interface import Sample
from hil_forceps.estimation.registry import make_estimator
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

NATIVE_BAUDRATE = 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class ServiceRun:
    """The end of a run of the service, and its recorded data.

    `recorded` and `estimates` have a row for each sample of the drive in operation, from its zero; None if it never
    operated. `folder` contains run.mcap and bus.log if `out` was given, and fault.json if the run did not end normally.
    """

    reason: str  # "completed", "stop_requested", "no_drive", ... of `StopReason`
    message: str
    ok: bool  # the run ended normally, the drive is disabled, and everything was recorded
    drive_disabled: bool
    recorded: Run | None
    estimates: Estimates | None
    counters: Mapping[str, Mapping[str, int]]  # of the service, the pipeline, the host's machine, the link
    gate: Mapping[str, int]  # number of references that the gate limited, held or denied, by its verdict
    notes: tuple[str, ...]  # notes on the rig and the link, and what could not be recorded
    folder: Path | None

    def __repr__(self) -> str:
        return f"<ServiceRun {self.reason}: {self.message}; {self.recorded!r}>"


class Service:
    """The service for one drive, on a python-can interface or a serial port; each `run` opens the link again.

    `interface`, `channel`, `options`: of python-can; or `serial`: a port, a pyserial URL, or udp://ADDRESS:PORT, with
    its `baudrate` if the rig has none. `algorithm`: as of `Estimator`. `compensate`: send the motor angle that
    compensates the stretch of the wire, else only estimate. UserError for a rig that is inconsistent with its drive or
    has no `limits:`.
    """

    def __init__(
        self,
        rig: RigSource,
        *,
        interface: str = "",
        channel: str = "",
        serial: str = "",
        baudrate: int | None = None,
        options: Mapping[str, object] = MappingProxyType({}),
        algorithm: str = "kalman",
        compensate: bool = True,
    ) -> None:
        self.rig = as_rig(rig)
        texts = {"interface": interface, "channel": channel, "serial": serial, "algorithm": algorithm}
        for name, value in texts.items():
            check_text(name, value)
        if baudrate is not None:
            check_whole("baudrate", baudrate, least=1)
        if not isinstance(options, Mapping):
            raise TypeError(f"options: must be a mapping of names to values, not {kind(options)}")
        found = findings(self.rig)
        if problems := [f"{each.key}: {each.text}" for each in found if each.level == "problem"]:
            raise UserError(problems)
        self._notes = tuple(f"{each.key}: {each.text}" for each in found)
        self._algorithm = algorithm
        self._compensate = compensate
        bench = self.rig.bench
        self._link = LinkSpec(
            interface=interface,
            channel=channel,
            serial_url=serial,
            fd=bench.transport == "fd",
            bitrate_bit_per_s=bench.bitrate_bit_per_s,
            data_bitrate_bit_per_s=bench.data_bitrate_bit_per_s,
            baudrate=_baudrate(self.rig, serial, baudrate),
            options=options,
            framing=framing_for(self.rig),
        )
        check_spec(self._link)
        machine_for(self.rig)  # so that an unusable rig is refused here
        make_pipeline(self.rig, self._settings(PAPER_TRAJECTORY))

    def run(
        self,
        trajectory: Trajectory = PAPER_TRAJECTORY,
        duration_s: float | None = None,
        *,
        out: str | PathLike[str] | None = None,
        reset_fault: bool = False,
        stop_requested: Callable[[], bool] = lambda: False,
        telemetry: Callable[[Telemetry], None] | None = None,
    ) -> ServiceRun:
        """Connect, enable the drive, follow a trajectory of the jaw, disable the drive, close the link.

        The trajectory should begin at the jaw's angle and stay within the rig's `limits:`. Without one it is the
        paper's, 90 to 10 degrees in 5 s. `duration_s`: from the first sample in operation, by default to the
        trajectory's end. `out`: a folder for run.mcap and bus.log. `reset_fault`: reset a fault that the drive latched
        before the run. An interrupt (Ctrl-C, or a notebook's stop) disables the drive and ends the run, if it is in the
        main thread; so does `stop_requested`, which is called once a period. The result has faults of the drive;
        UserError if the trajectory exceeds the limits, or if the link or a file can't be opened.
        """
        check_motion("trajectory", trajectory)
        check_duration("duration_s", duration_s)
        if out is not None and not isinstance(out, str | PathLike):
            raise TypeError(f"out: must be the path of a folder, not {kind(out)}")
        lasts_s = trajectory.times_s[-1] if duration_s is None else duration_s
        if not (math.isfinite(lasts_s) and lasts_s > 0.0):
            raise ValueError(f"trajectory: lasts {lasts_s} s; give duration_s, or a trajectory that lasts")
        if (excess := first_excess(trajectory, lasts_s, self.rig.plant(), self.rig.limits)) is not None:
            raise UserError(f"trajectory: {excess.words}; change it or the limit")
        _ready(self._algorithm, self.rig)
        with TemporaryDirectory() if out is None else _folder(Path(out)) as name:
            folder = Path(name)
            plan = Plan(
                self.rig,
                self._settings(trajectory),
                machine_for(self.rig),
                service_config(self.rig, lasts_s, reset_fault),
                recording=folder / RECORDING_NAME,
                bus_log=folder / "bus.log",
                about={"interface": self._link.interface or self._link.serial_url, "channel": self._link.channel},
            )
            connection = open_link(self._link)
            with _stoppable() as flag:
                session = run_session(connection, plan, lambda: flag.is_set() or stop_requested(), telemetry)
            recording = read_recording(plan.recording)
        return _result(session, recording, (*self._notes, *connection.notes), None if out is None else folder)

    def _settings(self, trajectory: Trajectory) -> Settings:
        period_s, same_clock = sample_period_s(self.rig), stamps_are_host_time(self.rig)
        return Settings(self._algorithm, self._compensate, period_s, trajectory, same_clock)


def _baudrate(rig: Rig, serial: str, wanted: int | None) -> int:
    """Return the rate of a serial line; UserError where the drive is on another kind of line."""
    found = maker_profile(rig)
    if found is None:
        return NATIVE_BAUDRATE if wanted is None else wanted
    profile, settings = found
    if profile.link == "can" and serial:
        raise UserError(
            f"serial {serial!r}: the rig's drive ({profile.name}) is on a CAN bus; give interface and channel"
        )
    if profile.link == "serial" and wanted not in {None, settings.baudrate_bit_per_s}:
        told = (
            f"the rig says motor_driver.baudrate_bit_per_s: {settings.baudrate_bit_per_s}, by which samples are stamped"
        )
        raise UserError(f"baudrate {wanted}: {told}; leave it out, or change it there")
    return settings.baudrate_bit_per_s


def _ready(algorithm: str, rig: Rig) -> None:
    """Call the estimator's kernels once: the first call compiles, too long for a drive to wait."""
    period_s = sample_period_s(rig)
    estimator = make_estimator(algorithm, rig, period_s)
    state = estimator.start(Sample(0, 0.0, 0.0))
    estimator.estimate(estimator.step(state, Sample(round(period_s * 1e9), 0.0, 0.0)))


@contextmanager
def _folder(path: Path) -> Iterator[str]:
    missing = [each for each in (path, *path.parents) if not each.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        if there := [name for name in RUN_FILES if (path / name).is_file()]:
            raise UserError(f"out {path}: contains a run ({there[0]}); name another folder")
    except OSError as error:
        raise UserError(f"out {path}: can't be made: {error.strerror}; name another folder") from error
    try:
        yield str(path)
    except UserError:  # a refused run leaves no empty folder
        for each in missing:
            if not any(each.iterdir()):
                each.rmdir()
        raise


@contextmanager
def _stoppable() -> Iterator[StopFlag]:
    """Turn signals into a clean stop; only possible in the main thread."""
    flag = StopFlag()
    if threading.current_thread() is not threading.main_thread():
        yield flag
        return
    with stopped_by_signals(flag):
        yield flag


def _result(session: SessionResult, recording: Recording, notes: tuple[str, ...], folder: Path | None) -> ServiceRun:
    service = session.service
    rows = np.flatnonzero(recording.samples["state"] == DriveState.OPERATIONAL)
    recorded = estimates = None
    if rows.size >= 2:
        run, samples = recording.to_run(), recording.samples[rows]
        recorded = Run("run", run.columns, run.notes)
        estimates = Estimates(
            samples["tau_w_estimate_N_m"].astype(np.float64), samples["elongation_estimate_m"].astype(np.float64)
        )
    return ServiceRun(
        service.reason.value,
        service.message,
        service.ok and not session.failures,
        service.drive_disabled,
        recorded,
        estimates,
        service.counters,
        {verdict.value: count.references for verdict, count in service.gate.items()},
        (*notes, *session.failures),
        folder,
    )
