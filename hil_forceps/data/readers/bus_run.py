"""Runs out of a bus log: what host and drive said, put together as the host would have heard it."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from firmware_protocol import scales
from firmware_protocol.codec import Decoder
from firmware_protocol.messages import BenchSensor, DriveState, FdFeedback, Feedback, Message, Setpoint, Timing
from firmware_protocol.samples import RawBench, RawSample, SampleAssembler
from hil_forceps.data.readers.bus_frames import read_frames
from hil_forceps.data.recording.reader import Recording
from hil_forceps.data.recording.writer import Outcome
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError

MAX_SAMPLES = 20_000_000
_LONGEST_LOG_S = 1e9  # a stamp in s since 1970 is 1.8e9, and is counted from the log's first
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

    def recording(self, name: str, refused: int) -> Recording:
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
        return Recording(name, {}, {}, samples, references, bench, np.empty(0, np.uint8), self._notes(refused))

    def _notes(self, refused: int) -> tuple[str, ...]:
        lost = self.counters["lost_feedback"]
        notes = [f"{lost} samples are missing in the log"] if lost else []
        return (*notes, f"{refused} frames of the log are not of this protocol") if refused else tuple(notes)


def read_bus_log(path: str | Path, kind: str = "") -> list[Run]:
    """Return a run for each drive in the log, and for each time it was switched on and became operational.

    `kind` as for `read_frames`. Raises UserError when the log can't be read or no drive in it ever became operational.
    """
    path = Path(path)
    decoder = Decoder()
    drives: dict[int, list[_Drive]] = {}
    begin_s: float | None = None
    count = 0
    for stamped in read_frames(path, kind):
        if stamped.frame.is_extended:
            continue  # somebody else's on the same bus
        message = decoder.decode(stamped.frame)
        if message is None:
            continue
        time_s = stamped.time_s or 0.0
        begin_s = time_s if begin_s is None else begin_s
        if not abs(time_s - begin_s) < _LONGEST_LOG_S or not math.isfinite(begin_s):
            raise UserError(f"{path}: frame {count + 1}: its time, {time_s!r} s, makes no sense")
        count += 1
        if count > MAX_SAMPLES:
            raise UserError(f"{path}: more than {MAX_SAMPLES} frames; cut the log")
        _hear(drives.setdefault(message.node, [_Drive()]), message, round((time_s - begin_s) * 1e9))
    refused = sum(decoder.counters.values())
    if not count:
        raise UserError(f"{path}: no frame of this protocol in it ({refused} others)")
    runs = _runs(path, drives, refused)
    if not runs:
        raise UserError(f"{path}: holds no run: no drive in it ever became operational")
    return runs


def _hear(drives: list[_Drive], message: Message, time_ns: int) -> None:
    if not drives[-1].hear(message, time_ns):
        drives.append(_Drive())
        drives[-1].hear(message, time_ns)


def _runs(path: Path, drives: dict[int, list[_Drive]], refused: int) -> list[Run]:
    heard = [(node, drive) for node, each in sorted(drives.items()) for drive in each]
    runs = []
    for node, drive in heard:
        recording = drive.recording(path.stem, refused)
        if np.count_nonzero(recording.samples["state"] == DriveState.OPERATIONAL) > 1:
            runs.append((node, recording.to_run()))
    if len(runs) == 1:
        return [runs[0][1]]
    return [Run(f"{run.name}-node{node}-{place}", run.columns, run.notes) for place, (node, run) in enumerate(runs, 1)]
