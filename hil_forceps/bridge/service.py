"""The one loop: from the link through the pipeline back to the link, on an absolute schedule.

The course of a run is `hil_forceps.bridge.course`. An exception out of the loop (a fault of this program) sends an
emergency stop before it passes on.

Each tick drains the link, feeds every sample, sends at most one reference and what the host's state machine has to
say. What the link does not take at once is dropped and counted, never kept for later. Nothing here logs or waits, and
garbage collection rests while the loop runs (a tick makes no cycles). Ticks are due at whole periods plus the phase
on the host's clock; a tick that ends after the next was due is an overrun, and the periods it ran over are skipped.
"""

import gc
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from firmware_protocol.frames import Frame
from hil_forceps.bridge.course import Course
from hil_forceps.bridge.pipeline import Pipeline
from hil_forceps.bridge.ports import Clock, Link, SendResult
from hil_forceps.bridge.results import ServiceConfig, ServiceResult, Stage, Telemetry
from hil_forceps.bridge.statistics import LoopStatistics, make_loop_statistics
from hil_forceps.data.recording.writer import Outcome, Recorder
from hil_forceps.drives.port import DriveMachine

# Looked up once: members of an Enum cost as much as a call when asked for by their class.
_ENDED = Stage.ENDED
_SENT = SendResult.SENT
_NONE, _OUTCOME_SENT = Outcome.NONE, Outcome.SENT


class Service:
    """One run against one drive; `run` once."""

    def __init__(
        self,
        link: Link,
        clock: Clock,
        host: DriveMachine,
        pipeline: Pipeline,
        config: ServiceConfig,
        recorder: Recorder | None = None,
        stop_requested: Callable[[], bool] = lambda: False,
        telemetry: Callable[[Telemetry], None] | None = None,
    ) -> None:
        """`stop_requested` is asked once a tick (set the flag in a signal handler).

        `telemetry` is called after a tick's work, `config.telemetry_period_ns` apart, and takes its time from the
        slack.
        """
        if config.period_ns <= 0 or not 0 <= config.phase_ns < config.period_ns:
            raise ValueError(f"phase {config.phase_ns} ns must lie within the period of {config.period_ns} ns")
        self.statistics: LoopStatistics = make_loop_statistics()
        self._link = link
        self._clock = clock
        self._host = host
        self._pipeline = pipeline
        self._config = config
        self._recorder = recorder
        self._course = Course(host, pipeline, config, recorder, stop_requested)
        self._telemetry = telemetry
        self._counters = dict.fromkeys(
            ("ticks", "overruns", "skipped_periods", "frames_sent", "queue_full", "references_sent"),
            0,
        )
        self._has_run = False
        self._bus_down = False
        self._setpoint_sequence = 0
        self._reference_rad = math.nan
        self._next_telemetry_ns = 0

    def run(self) -> ServiceResult:
        """Run until something ends it; the link and the recorder stay open and belong to the caller."""
        if self._has_run:
            raise ValueError("a service runs once")
        self._has_run = True
        self._pipeline.warm_up()
        now_ns = self._clock.now_ns()
        course = self._course
        course.begin(now_ns)
        try:
            with _no_collection():
                self._loop(now_ns)
        except BaseException:
            self._link.send(self._host.estop_frame())
            raise
        assert course.reason is not None
        counters: dict[str, Mapping[str, int]] = {
            "service": {**self._counters, "frames_received": course.frames_received},
            "pipeline": dict(self._pipeline.counters),
            "host": dict(self._host.counters),
            "link": dict(self._link.counters),
        }
        return ServiceResult(
            course.reason,
            course.message,
            course.drive_disabled,
            self._pipeline.zero_ns,
            counters,
            self.statistics.summary(),
        )

    def _loop(self, now_ns: int) -> None:
        period_ns, phase_ns = self._config.period_ns, self._config.phase_ns
        due_ns = ((now_ns - phase_ns) // period_ns + 1) * period_ns + phase_ns
        before_ns: int | None = None
        course, clock, tick = self._course, self._clock, self._tick
        add_lateness, add_period = self.statistics.lateness.add, self.statistics.period.add
        while course.stage is not _ENDED:
            clock.sleep_until_ns(due_ns)
            now_ns = clock.now_ns()
            add_lateness(now_ns - due_ns)
            if before_ns is not None:
                add_period(now_ns - before_ns)
            before_ns = now_ns
            self._counters["ticks"] += 1
            tick(now_ns)
            due_ns += period_ns
            late_ns = clock.now_ns() - due_ns
            if late_ns >= 0:
                skipped = late_ns // period_ns + 1
                self._counters["overruns"] += 1
                self._counters["skipped_periods"] += skipped
                due_ns += skipped * period_ns

    def _tick(self, now_ns: int) -> None:
        course = self._course
        self._take_in()
        course.advance(now_ns)
        if course.sends_references():
            self._send_reference(now_ns)
        for frame in self._host.poll(now_ns):
            self._send(frame)
        if self._bus_down and course.stage is not _ENDED:
            course.bus_is_down()
        if self._telemetry is not None and now_ns >= self._next_telemetry_ns:
            self._next_telemetry_ns = now_ns + self._config.telemetry_period_ns
            self._telemetry(self._look())

    def _take_in(self) -> None:
        received = self._link.receive()
        host = self._host
        for time_ns, frame in received:
            host.receive(frame, time_ns)
        self._course.frames_received += len(received)
        recorder = self._recorder
        pipeline = self._pipeline
        for raw in host.take_samples():
            if pipeline.feed(raw):
                self._course.last_sample_ns = raw.received_ns
                if recorder is not None:
                    recorder.sample(raw, pipeline.sample, pipeline.estimate)
        for values in host.take_bench():
            if recorder is not None:
                recorder.bench(values)
        if not self._link.is_up():
            self._bus_down = True

    def _send_reference(self, now_ns: int) -> None:
        reference = self._pipeline.reference(now_ns)
        sent_ns, outcome = now_ns, _NONE
        raw = reference.reference_raw
        if raw is not None:
            frame = self._host.setpoint(raw)
            if frame is None:
                outcome = Outcome.NOT_ALLOWED
            else:
                result = self._send(frame)
                self._setpoint_sequence = self._host.setpoint_sequence
                if result is not _SENT:
                    outcome = Outcome.QUEUE_FULL if result is SendResult.QUEUE_FULL else Outcome.BUS_DOWN
                else:
                    outcome = _OUTCOME_SENT
                    sent_ns = self._clock.now_ns()
                    self._counters["references_sent"] += 1
                    self._reference_rad = reference.passed_rad
                    self.statistics.age.add(sent_ns - self._pipeline.host_time_ns(reference.stamp_ns))
        if self._recorder is not None:
            self._recorder.reference(reference, sent_ns, outcome, self._setpoint_sequence)

    def _send(self, frame: Frame) -> SendResult:
        result = self._link.send(frame)
        if result is _SENT:
            self._counters["frames_sent"] += 1
        elif result is SendResult.QUEUE_FULL:
            self._counters["queue_full"] += 1
        else:
            self._bus_down = True
        return result

    def _look(self) -> Telemetry:
        pipeline = self._pipeline
        newest, zero_ns = pipeline.newest, pipeline.zero_ns
        time_s = math.nan if newest is None or zero_ns is None else (newest.stamp_ns - zero_ns) * 1e-9
        counters = self._counters
        return Telemetry(
            stage=self._course.stage,
            time_s=time_s,
            theta_m_rad=pipeline.sample.theta_m_rad,
            reference_rad=self._reference_rad,
            tau_w_N_m=pipeline.estimate.tau_w_N_m,
            elongation_m=pipeline.estimate.elongation_m,
            frames_sent=counters["frames_sent"],
            frames_received=self._course.frames_received,
            overruns=counters["overruns"],
        )


@contextmanager
def _no_collection() -> Iterator[None]:
    """Keep the cyclic collector still: one full collection takes longer than several ticks."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
