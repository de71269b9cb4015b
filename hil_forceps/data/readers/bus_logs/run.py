"""Runs out of a bus log: what host and drive said, put together as the host would have heard it."""

from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from firmware_protocol import scales
from firmware_protocol.codec import Decoder
from firmware_protocol.host.samples import RawBench, RawSample, SampleAssembler
from firmware_protocol.messages import BenchSensor, DriveState, FdFeedback, Feedback, Message, Setpoint, Timing
from hil_forceps.data.readers.bus_logs.account import Account, LoggedFrame
from hil_forceps.data.readers.bus_logs.candump import RECORD_AGAIN
from hil_forceps.data.readers.bus_logs.frames import MAX_BUSES, of_bus, read_frames
from hil_forceps.data.readers.format import Choice
from hil_forceps.data.recording.reader import Recording
from hil_forceps.data.recording.writer import Outcome
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError

MAX_SAMPLES = 20_000_000
_MAX_LOG_TIME_NS = 10**18  # a stamp since 1970 is 1.8e18, and is counted from the log's first
_SAMPLE = np.dtype(
    [
        ("stamp_ns", "i8"),
        ("received_ns", "i8"),
        ("theta_m_rad", "f8"),
        ("current_A", "f8"),
        ("sequence", "u1"),
        ("setpoint_sequence", "u1"),
        ("state", "u1"),
    ]
)
_REFERENCE = np.dtype([("tick_ns", "i8"), ("passed_rad", "f8"), ("setpoint_sequence", "u1"), ("outcome", "u1")])
_BENCH = np.dtype([("received_ns", "i8"), ("theta_j_rad", "f8"), ("tau_w_N_m", "f8"), ("sequence", "u1")])


class _Setpoint(NamedTuple):
    time_ns: int
    raw: int  # unwrapped
    sequence: int


class _Drive:
    """What one node and the host that talks to it have said since the drive was switched on."""

    def __init__(self) -> None:
        self.counters: dict[str, int] = {}
        self.assembler = SampleAssembler(self.counters)
        self.samples: list[RawSample] = []
        self.bench: list[RawBench] = []
        self.setpoints: list[_Setpoint] = []

    def hear(self, message: Message, time_ns: int) -> bool:
        """Take one message; False when the drive's clock shows that it was started anew."""
        if isinstance(message, Feedback):
            self.assembler.on_feedback(message, time_ns)
        elif isinstance(message, Timing):
            self.assembler.on_timing(message, time_ns)
        elif isinstance(message, FdFeedback):
            self.assembler.on_fd_feedback(message, time_ns)
        elif isinstance(message, BenchSensor):
            self.assembler.on_bench(message, time_ns)
        elif isinstance(message, Setpoint):
            before = self.setpoints[-1].raw if self.setpoints else message.theta_m_ref
            raw = scales.unwrap(message.theta_m_ref, before, scales.ANGLE_MODULUS)
            self.setpoints.append(_Setpoint(time_ns, raw, message.sequence))
        self.samples += self.assembler.take_samples()
        self.bench += self.assembler.take_bench()
        return not self.assembler.restarted

    def recording(self, name: str, notes: tuple[str, ...]) -> Recording:
        """Return it as the service would have recorded it, without what only the service knows."""
        samples = np.zeros(len(self.samples), dtype=_SAMPLE)
        fields = list(zip(*self.samples, strict=True)) or [()] * len(RawSample._fields)
        raw = dict(zip(RawSample._fields, fields, strict=True))
        for field in ("stamp_ns", "received_ns", "sequence", "setpoint_sequence", "state"):
            samples[field] = raw[field]
        samples["theta_m_rad"] = np.array(raw["theta_m"], dtype=np.float64) * scales.ANGLE_LSB_RAD
        samples["current_A"] = np.array(raw["current"], dtype=np.float64) * scales.CURRENT_LSB_A
        references = np.zeros(len(self.setpoints), dtype=_REFERENCE)
        for field, place in (("tick_ns", 0), ("passed_rad", 1), ("setpoint_sequence", 2)):
            references[field] = [setpoint[place] for setpoint in self.setpoints]
        references["passed_rad"] *= scales.ANGLE_LSB_RAD
        references["outcome"] = Outcome.SENT
        bench = np.zeros(len(self.bench), dtype=_BENCH)
        for field, place in (("sequence", 0), ("theta_j_rad", 1), ("tau_w_N_m", 2), ("received_ns", 3)):
            bench[field] = [reading[place] for reading in self.bench]
        bench["theta_j_rad"] *= scales.ANGLE_LSB_RAD
        bench["tau_w_N_m"] *= scales.BENCH_TORQUE_LSB_N_M
        return Recording(name, {}, {}, samples, references, bench, np.empty(0, np.uint8), (*self._lost(), *notes))

    def _lost(self) -> tuple[str, ...]:
        lost = self.counters["lost_feedback"]
        return (f"{lost} samples are missing in the log",) if lost else ()


def read_bus_log(path: str | Path, kind: str = "", choice: Choice = Choice()) -> list[Run]:  # noqa: B008 - a constant
    """Return a run for each drive in the log, and for each time it was switched on and became operational.

    `kind` as for `read_frames`. Raises UserError when the log can't be read or says no times, when drives speak on
    several buses and none is chosen, when what is chosen isn't there, or no drive in it ever became operational.
    """
    path = Path(path)
    account = Account()
    heard = _Heard(path)
    for logged in of_bus(path, read_frames(path, kind, account), choice.bus):
        heard.take(logged)
    if not heard.count:
        raise UserError(f"{path}: contains no frame of this protocol ({heard.refused} others){_said(account)}")
    drives = heard.chosen(choice.node)
    notes = (*heard.notes(), *account.told())
    runs = [
        (node, recording.to_run())
        for node, each in sorted(drives.items())
        for recording in (drive.recording(path.stem, notes) for drive in each)
        if np.count_nonzero(recording.samples["state"] == DriveState.OPERATIONAL) > 1
    ]
    if not runs:
        raise UserError(f"{path}: contains no run: no drive became operational{_said(account)}")
    if len(runs) == 1:
        return [runs[0][1]]
    return [Run(f"{run.name}-node{node}-{place}", run.columns, run.notes) for place, (node, run) in enumerate(runs, 1)]


class HeardDrive(NamedTuple):
    """What a drive said from one start of its own to the next, and how often it was told a reference."""

    samples: list[RawSample]  # `received_ns` counts from the log's first frame; angles and stamps unwrap from the first
    references: int


def heard_drives(path: Path, node: int) -> tuple[list[HeardDrive], tuple[str, ...]]:
    """Return what one node said, and what should be known of the log; UserError when it can't be read."""
    account = Account()
    heard = _Heard(path)
    for logged in read_frames(path, account=account):
        heard.take(logged)
    drives = [drive for bus in heard.buses for drive in bus.get(node, [])]
    return [HeardDrive(drive.samples, len(drive.setpoints)) for drive in drives], account.told()


def _said(account: Account) -> str:
    return "".join(f"; {told}" for told in account.told())


class _Heard:
    """All that was said, by bus and node."""

    def __init__(self, path: Path) -> None:
        self.count = 0
        self._path = path
        self._decoder = Decoder()
        self._drives: dict[str, dict[int, list[_Drive]]] = {}
        self._counts: Counter[tuple[str, int]] = Counter()
        self._begin_ns: int | None = None
        self._last_ns = 0
        self._steps_back = 0
        self._longest_step_back_ns = 0

    @property
    def buses(self) -> list[dict[int, list[_Drive]]]:
        """What was said, by node, on each bus."""
        return list(self._drives.values())

    @property
    def refused(self) -> int:
        """How many frames are not of this protocol."""
        return sum(self._decoder.counters.values())

    def take(self, logged: LoggedFrame) -> None:
        """Take one frame of the log."""
        if logged.frame.is_extended:
            return  # somebody else's on the same bus
        message = self._decoder.decode(logged.frame)
        if message is None:
            return
        if logged.time_ns is None:
            raise UserError(f"{self._path}: its frames have no times; {RECORD_AGAIN}")
        begin_ns = self._begin_ns = logged.time_ns if self._begin_ns is None else self._begin_ns
        time_ns = logged.time_ns - begin_ns
        if abs(time_ns) >= _MAX_LOG_TIME_NS:
            told = f"its time, {logged.time_ns / 1e9:.6f} s, is not plausible after {begin_ns / 1e9:.6f} s"
            raise UserError(f"{self._path}: frame {self.count + 1}: {told}; cut the log there")
        if time_ns < self._last_ns:
            self._steps_back += 1
            self._longest_step_back_ns = max(self._longest_step_back_ns, self._last_ns - time_ns)
        self._last_ns = time_ns
        self.count += 1
        if self.count > MAX_SAMPLES:
            raise UserError(f"{self._path}: more than {MAX_SAMPLES} frames; cut the log")
        nodes = self._drives.setdefault(logged.bus, {})
        if len(self._drives) > MAX_BUSES:
            raise UserError(f"{self._path}: contains more than {MAX_BUSES} buses; choose one with --bus")
        self._counts[logged.bus, message.node] += 1
        _hear(nodes.setdefault(message.node, [_Drive()]), message, time_ns)

    def chosen(self, node: int | None) -> dict[int, list[_Drive]]:
        """Return the drives of the one bus, or of one node on it; UserError with all of them where that is unclear."""
        if len(self._drives) > 1:
            told = f"{len(self._drives)} buses have drives: {self._listed()}"
            raise UserError(f"{self._path}: {told}; choose one with --bus")
        (drives,) = self._drives.values()
        if node is None:
            return drives
        if node not in drives:
            raise UserError(f"{self._path}: does not contain node {node}; use --node with one of {self._listed()}")
        return {node: drives[node]}

    def notes(self) -> tuple[str, ...]:
        """Return what is strange about the log's times and frames."""
        notes = []
        if self.refused:
            notes.append(f"{self.refused} frames of the log are not of this protocol")
        if self._steps_back:
            longest_ms = self._longest_step_back_ns * 1e-6
            notes.append(f"the log's time goes back {self._steps_back} times, by {longest_ms:.6g} ms at most")
        return tuple(notes)

    def _listed(self) -> str:
        several = len(self._drives) > 1
        return ", ".join(
            f"{f'{bus or None} ' if several else ''}node {node} ({count} frames)"
            for (bus, node), count in sorted(self._counts.items())[:MAX_BUSES]
        )


def _hear(drives: list[_Drive], message: Message, time_ns: int) -> None:
    if not drives[-1].hear(message, time_ns):
        drives.append(_Drive())
        drives[-1].hear(message, time_ns)
