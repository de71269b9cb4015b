"""One drive of a service: its machine, pipeline, recorder and course, and what they do in a tick."""

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Final

from firmware_protocol.frames import Frame
from firmware_protocol.scales import CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from hil_forceps.bridge.course import Course
from hil_forceps.bridge.fault import FaultReason, Situation, reason_of
from hil_forceps.bridge.pipeline import Pipeline
from hil_forceps.bridge.ports import MotionWatch, Observer, OutsideReferences, SendResult
from hil_forceps.bridge.results import AS_MEANT, ServiceConfig, ServiceResult, Stage, StopReason
from hil_forceps.bridge.statistics import Histogram, HistogramSummary
from hil_forceps.data.recording.writer import Outcome, Recorder
from hil_forceps.drives.port import DriveMachine

# Looked up once: members of an Enum cost as much as a call when asked for by their class.
_READY: Final = frozenset({HostPhase.READY, HostPhase.ENABLING, HostPhase.RUNNING})
_ENDED: Final = Stage.ENDED
_STOPPED: Final = Stage.STOPPED
_SENT: Final = SendResult.SENT
_NONE: Final = Outcome.NONE
_OUTCOME_SENT: Final = Outcome.SENT


class Axis:
    """A drive in a service; what passes over the link goes through `receive` and the `send` of a tick."""

    def __init__(
        self,
        drive: DriveMachine,
        pipeline: Pipeline,
        config: ServiceConfig,
        recorder: Recorder | None = None,
        name: str = "",
        watches: Mapping[StopReason, MotionWatch] = MappingProxyType({}),
        observer: Observer | None = None,
        outside: OutsideReferences | None = None,
    ) -> None:
        """`name`: for messages, where there are several. `watches`: end a run under torque for their reason.

        `observer` sees what the recorder sees. `outside`: where its references come from outside; the drive is enabled
        when there are some, and disabled when they are lost.
        """
        self.name = name
        self.drive = drive
        self.pipeline = pipeline
        self.age = Histogram()
        self.age_ns = 0  # of the last reference sent
        self.references_sent = 0
        self.reference_rad = math.nan
        self.stages: list[tuple[int, str]] = []  # when each began
        self.fault: FaultReason | None = None  # as soon as the run ends otherwise than it was meant to
        self.now_ns = 0  # of the tick under way, or the last
        self._stage = Stage.CONNECTING
        self._config = config
        self._recorder = recorder
        self._watches = tuple(watches.items())
        self._see = tuple(watch.see for watch in watches.values())
        self._observer = observer
        self.outside = outside
        self._setpoint_sequence = 0
        self.course = Course(drive, pipeline, config, recorder, lambda: False)

    def begin(self, now_ns: int, stop_requested: Callable[[], bool], others_ready: Callable[[], bool]) -> None:
        """Start to ask for the drive; it gets no torque before `others_ready`."""
        self.course = Course(
            self.drive,
            self.pipeline,
            self._config,
            self._recorder,
            stop_requested,
            lambda: others_ready() and self._has_references(),
        )
        self.course.begin(now_ns)
        self._stage, self.now_ns = self.course.stage, now_ns
        self.stages = [(now_ns, self._stage.value)]

    @property
    def is_ready(self) -> bool:
        """Whether its drive is known and without fault."""
        return self.drive.phase in _READY

    @property
    def has_ended(self) -> bool:
        """Whether nothing more happens on it."""
        return self.course.stage is _ENDED

    @property
    def has_failed(self) -> bool:
        """Whether it ends, or has ended, otherwise than it was meant to."""
        return self.course.reason is not None and self.course.reason not in AS_MEANT

    def receive(self, received: Sequence[tuple[int, Frame]]) -> None:
        """Take what came over the link since the tick before, each frame with its time."""
        drive, course, recorder, pipeline = self.drive, self.course, self._recorder, self.pipeline
        watches, observer = self._see, self._observer
        for time_ns, frame in received:
            drive.receive(frame, time_ns)
        course.frames_received += len(received)
        for raw in drive.take_samples():
            if pipeline.feed(raw):
                course.last_sample_ns = raw.received_ns
                for see in watches:
                    see(pipeline.sample.theta_m_rad, raw.current * CURRENT_LSB_A, self.reference_rad)
                if recorder is not None:
                    recorder.sample(raw, pipeline.sample, pipeline.estimate)
                if observer is not None:
                    observer.sample(raw, pipeline.sample, pipeline.estimate)
        for values in drive.take_bench():
            if recorder is not None:
                recorder.bench(values)
            if observer is not None:
                observer.bench(values)

    def tick(self, now_ns: int, send: Callable[[Frame], SendResult], clock_ns: Callable[[], int]) -> None:
        """Send one reference at most, and what the drive's machine has to say."""
        self.now_ns = now_ns
        course = self.course
        for reason, watch in self._watches:
            if watch.has_tripped and course.sends_references():
                course.stop(reason, watch.words(), now_ns)
        if self.outside is not None:
            self._look_outside(self.outside, now_ns)
        course.advance(now_ns)
        if course.stage is not self._stage:
            self._note_stage()
        elif course.stage is _STOPPED and course.has_torque_in_spite():
            send(self.drive.estop_frame())
        if course.sends_references():
            self._send_reference(now_ns, send, clock_ns)
        for frame in self.drive.poll(now_ns):
            send(frame)

    def _has_references(self) -> bool:
        return self.outside is None or not self.outside.is_lost(self.now_ns)

    def _look_outside(self, outside: OutsideReferences, now_ns: int) -> None:
        """End a run with torque whose references stay away; one without waits for them."""
        if not self.course.sends_references():
            outside.release(now_ns)
        elif outside.is_lost(now_ns):
            self.course.stop(StopReason.REFERENCE_LOST, outside.words(now_ns), now_ns)

    def emergency_stop(self, now_ns: int, send: Callable[[Frame], SendResult]) -> None:
        """Have the drive take torque off at once; nothing where that was done already."""
        if self.course.stage is not _STOPPED and not self.has_ended:
            send(self.drive.estop_frame())
            self.course.emergency_stop(now_ns)

    def _note_stage(self) -> None:
        course, before = self.course, self._stage
        since_ns, now_ns = self.stages[-1][0], self.now_ns
        self._stage = course.stage
        self.stages.append((now_ns, course.stage.value))
        if self.fault is None and self.has_failed and course.reason is not None:
            where = Situation(before, since_ns, now_ns, course.last_sample_ns)
            trip = self.pipeline.gate_trip
            self.fault = reason_of(course.reason, course.message, where, self.pipeline, self._config, trip)

    def _send_reference(self, now_ns: int, send: Callable[[Frame], SendResult], clock_ns: Callable[[], int]) -> None:
        pipeline, drive = self.pipeline, self.drive
        reference = pipeline.reference(now_ns)
        sent_ns, outcome = now_ns, _NONE
        raw = reference.reference_raw
        if raw is not None:
            frame = drive.setpoint(raw)
            if frame is None:
                outcome = Outcome.NOT_ALLOWED
            else:
                result = send(frame)
                self._setpoint_sequence = drive.setpoint_sequence
                if result is not _SENT:
                    outcome = Outcome.QUEUE_FULL if result is SendResult.QUEUE_FULL else Outcome.BUS_DOWN
                else:
                    outcome = _OUTCOME_SENT
                    sent_ns = clock_ns()
                    self.references_sent += 1
                    self.reference_rad = reference.passed_rad
                    self.age_ns = age_ns = sent_ns - pipeline.host_time_ns(reference.stamp_ns)
                    self.age.add(age_ns)
        recorder = self._recorder
        if recorder is not None:
            recorder.reference(reference, sent_ns, outcome, self._setpoint_sequence)
        if self._observer is not None:
            self._observer.reference(reference, sent_ns, outcome, self._setpoint_sequence)

    def result(
        self, service: Mapping[str, int], link: Mapping[str, int], timing: Mapping[str, HistogramSummary]
    ) -> ServiceResult:
        """Return how it ended, with what the service counted and timed for all axes; ValueError before the end."""
        course = self.course
        if course.reason is None:
            raise ValueError("the run has not ended")
        if course.stage is not self._stage:  # the bus went down behind the last tick
            self._note_stage()
        counters: dict[str, Mapping[str, int]] = {
            "service": {**service, "references_sent": self.references_sent, "frames_received": course.frames_received},
            "pipeline": dict(self.pipeline.counters),
            "host": dict(self.drive.counters),
            "link": dict(link),
        }
        if self.outside is not None:
            counters["outside"] = dict(self.outside.counters)
        told = self.pipeline.gate_tally.told()
        if told:
            counters["gate"] = {verdict.value: count.references for verdict, count in told.items()}
        return ServiceResult(
            course.reason,
            course.message,
            course.drive_disabled,
            self.pipeline.zero_ns,
            counters,
            {**timing, "age": self.age.summary()},
            told,
            self.pipeline.gate_trip,
            tuple(self.stages),
        )
