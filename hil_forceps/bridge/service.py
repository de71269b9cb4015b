"""The one loop: from the link through the pipeline back to the link, on an absolute schedule.

A run goes through stages, each a method that looks at what the tick brought and may move on or end:

CONNECTING  ask who is there until the drive is ready; refuse a version that does not fit
ENABLING    ask the drive for power; references equal the measured angle
RUNNING     references follow the trajectory
STOPPING    no references any more; wait until the drive says that it is disabled

Whatever ends a run goes through STOPPING, but for a bus that is gone: there the drive's own watchdog stops the motor.
An exception out of the loop (a fault of this program) sends an emergency stop before it passes on.

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
from firmware_protocol.host_machine import HostMachine, HostPhase
from firmware_protocol.messages import DriveState
from hil_forceps.bridge.pipeline import VERDICT_NAMES, Pipeline
from hil_forceps.bridge.ports import Clock, Link, SendResult
from hil_forceps.bridge.results import ServiceConfig, ServiceResult, Stage, StopReason, Telemetry, fault_words
from hil_forceps.bridge.statistics import LoopStatistics, make_loop_statistics
from hil_forceps.runs.recording_writer import Outcome, Recorder

SETTLE_PERIODS = 5  # before the drive's word counts: what arrives first was said before the request
SILENT_PERIODS = 20  # at least so many without a sample before a drive counts as silent, however slow the loop
SEQUENCE_AT = 4  # in SETPOINT and FD_SETPOINT, behind the reference
_NO_TORQUE = frozenset({DriveState.DISABLED, DriveState.FAULT})


class Service:
    """One run against one drive; `run` once."""

    def __init__(
        self,
        link: Link,
        clock: Clock,
        host: HostMachine,
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
        self._silence_ns = max(config.silence_timeout_ns, SILENT_PERIODS * config.period_ns)
        self._recorder = recorder
        self._stop_requested = stop_requested
        self._telemetry = telemetry
        self._counters = dict.fromkeys(
            ("ticks", "overruns", "skipped_periods", "frames_received", "frames_sent", "queue_full", "references_sent"),
            0,
        )
        self._works: dict[Stage, Callable[[int], None]] = {
            Stage.CONNECTING: self._connecting,
            Stage.ENABLING: self._enabling,
            Stage.RUNNING: self._running,
            Stage.STOPPING: self._stopping,
        }
        self._stage_work: Callable[[int], None] = (
            self._connecting
        )  # looked up when a stage begins: hashing an Enum takes its time
        self._has_run = False
        self._stage = Stage.CONNECTING
        self._reset_asked = False
        self._reason: StopReason | None = None
        self._message = ""
        self._disabled = False
        self._bus_down = False
        self._stage_end_ns = 0
        self._stage_began_ns = 0
        self._last_sample_ns = 0
        self._setpoint_sequence = 0
        self._verdict = 0
        self._reference_rad = math.nan
        self._next_telemetry_ns = 0

    def run(self) -> ServiceResult:
        """Run until something ends it; the link and the recorder stay open and belong to the caller."""
        if self._has_run:
            raise ValueError("a service runs once")
        self._has_run = True
        self._pipeline.warm_up()
        now_ns = self._clock.now_ns()
        self._enter(Stage.CONNECTING, now_ns, self._config.connect_timeout_ns)
        self._host.connect(now_ns)
        try:
            with _no_collection():
                self._loop(now_ns)
        except BaseException:
            self._link.send(self._host.estop_frame())
            raise
        assert self._reason is not None
        counters: dict[str, Mapping[str, int]] = {
            "service": dict(self._counters),
            "pipeline": dict(self._pipeline.counters),
            "host": dict(self._host.counters),
            "link": dict(self._link.counters),
        }
        return ServiceResult(
            self._reason, self._message, self._disabled, self._pipeline.zero_ns, counters, self.statistics.summary()
        )

    def _loop(self, now_ns: int) -> None:
        period_ns, phase_ns = self._config.period_ns, self._config.phase_ns
        due_ns = ((now_ns - phase_ns) // period_ns + 1) * period_ns + phase_ns
        before_ns: int | None = None
        while self._stage is not Stage.ENDED:
            self._clock.sleep_until_ns(due_ns)
            now_ns = self._clock.now_ns()
            self.statistics.lateness.add(now_ns - due_ns)
            if before_ns is not None:
                self.statistics.period.add(now_ns - before_ns)
            before_ns = now_ns
            self._counters["ticks"] += 1
            self._tick(now_ns)
            due_ns += period_ns
            late_ns = self._clock.now_ns() - due_ns
            if late_ns >= 0:
                skipped = late_ns // period_ns + 1
                self._counters["overruns"] += 1
                self._counters["skipped_periods"] += skipped
                due_ns += skipped * period_ns

    def _tick(self, now_ns: int) -> None:
        self._take_in()
        self._stage_work(now_ns)
        if self._stage is Stage.ENABLING or self._stage is Stage.RUNNING:
            self._send_reference(now_ns)
        for frame in self._host.poll(now_ns):
            self._send(frame)
        if self._bus_down and self._stage is not Stage.ENDED:
            self._end(StopReason.BUS_DOWN, "the bus is gone; the drive's own watchdog stops the motor")
        if self._telemetry is not None and now_ns >= self._next_telemetry_ns:
            self._next_telemetry_ns = now_ns + self._config.telemetry_period_ns
            self._telemetry(self._look())

    def _take_in(self) -> None:
        received = self._link.receive()
        host = self._host
        for time_ns, frame in received:
            host.receive(frame, time_ns)
        self._counters["frames_received"] += len(received)
        recorder = self._recorder
        pipeline = self._pipeline
        for raw in host.take_samples():
            if pipeline.feed(raw):
                self._last_sample_ns = raw.received_ns
                if recorder is not None:
                    recorder.sample(raw, pipeline.sample, pipeline.estimate)
        for values in host.take_bench():
            if recorder is not None:
                recorder.bench(values)
        if not self._link.is_up():
            self._bus_down = True

    def _send_reference(self, now_ns: int) -> None:
        reference = self._pipeline.reference(now_ns)
        self._verdict = reference.verdict
        sent_ns, outcome = now_ns, Outcome.NONE
        raw = reference.reference_raw
        if raw is not None:
            frame = self._host.setpoint(raw)
            if frame is None:
                outcome = Outcome.NOT_ALLOWED
            else:
                result = self._send(frame)
                self._setpoint_sequence = frame.data[SEQUENCE_AT]
                if result is not SendResult.SENT:
                    outcome = Outcome.QUEUE_FULL if result is SendResult.QUEUE_FULL else Outcome.BUS_DOWN
                else:
                    outcome = Outcome.SENT
                    sent_ns = self._clock.now_ns()
                    self._counters["references_sent"] += 1
                    self._reference_rad = reference.passed_rad
                    self.statistics.age.add(sent_ns - self._pipeline.host_time_ns(reference.stamp_ns))
        if self._recorder is not None:
            self._recorder.reference(reference, sent_ns, outcome, self._setpoint_sequence)

    def _send(self, frame: Frame) -> SendResult:
        result = self._link.send(frame)
        if result is SendResult.SENT:
            self._counters["frames_sent"] += 1
        elif result is SendResult.QUEUE_FULL:
            self._counters["queue_full"] += 1
        else:
            self._bus_down = True
        return result

    def _connecting(self, now_ns: int) -> None:
        phase = self._host.phase
        if self._stop_requested():
            self._end(StopReason.STOP_REQUESTED, "stopped on request before the drive was enabled")
        elif phase is HostPhase.REFUSED:
            self._end(StopReason.VERSION_REFUSED, self._host.refusal)
        elif phase is HostPhase.FAULT and self._config.reset_fault and now_ns < self._stage_end_ns:
            if not self._reset_asked:
                self._reset_asked = True
                self._host.reset_fault()
        elif phase is HostPhase.FAULT:
            words = fault_words(self._host.fault)
            self._end(StopReason.DRIVE_FAULT, f"the drive holds a fault from before: {words}; clear it first")
        elif phase is HostPhase.READY:
            self._host.enable()
            self._enter(Stage.ENABLING, now_ns, self._config.enable_timeout_ns)
        elif now_ns >= self._stage_end_ns:
            frames = self._counters["frames_received"]
            heard = f"{frames} frames came, none that fits" if frames else "nothing came over the bus"
            self._end(StopReason.NO_DRIVE, f"no drive answered: {heard}; check node id, bit rate and wiring")

    def _enabling(self, now_ns: int) -> None:
        phase = self._host.phase
        if phase is HostPhase.RUNNING:
            self._last_sample_ns = now_ns
            self._enter(Stage.RUNNING, now_ns, 0)
        elif self._stop_requested():
            self._stop(StopReason.STOP_REQUESTED, "stopped on request while enabling", now_ns)
        elif phase is HostPhase.FAULT:
            self._stop(StopReason.DRIVE_FAULT, f"fault while enabling: {fault_words(self._host.fault)}", now_ns)
        elif now_ns >= self._stage_end_ns:
            last = self._pipeline.counters
            text = f"the drive did not become operational ({last['samples']} samples seen, {last['denied']} denied)"
            self._stop(StopReason.ENABLE_FAILED, text, now_ns)

    def _running(self, now_ns: int) -> None:
        ended = self._trouble(now_ns) or self._enough()
        if ended is not None:
            self._stop(*ended, now_ns)

    def _trouble(self, now_ns: int) -> tuple[StopReason, str] | None:
        host, silent_ns = self._host, now_ns - self._last_sample_ns
        if host.phase is HostPhase.FAULT:
            return StopReason.DRIVE_FAULT, f"the drive latched a fault: {fault_words(host.fault)}"
        if host.phase is HostPhase.REFUSED:
            return StopReason.VERSION_REFUSED, host.refusal
        if host.phase is HostPhase.DISCONNECTED or silent_ns > self._silence_ns:
            return (
                StopReason.DRIVE_LOST,
                f"the drive fell silent or restarted: last sample {silent_ns / 1e6:.0f} ms ago",
            )
        if host.phase is not HostPhase.RUNNING:
            return StopReason.DRIVE_STOPPED, "the drive left operation by itself, without a fault"
        return None

    def _enough(self) -> tuple[StopReason, str] | None:
        pipeline, config = self._pipeline, self._config
        if pipeline.denied_in_a_row >= config.max_denied_in_a_row:
            why = VERDICT_NAMES[self._verdict]
            return StopReason.REFERENCE_DENIED, f"the gate denied {pipeline.denied_in_a_row} references in a row: {why}"
        if self._recorder is not None and self._recorder.failure:
            return StopReason.RECORDING_FAILED, self._recorder.failure
        if self._stop_requested():
            return StopReason.STOP_REQUESTED, "stopped on request"
        newest, zero_ns, duration_ns = pipeline.newest, pipeline.zero_ns, config.duration_ns
        if duration_ns is not None and newest and zero_ns is not None and newest.stamp_ns - zero_ns >= duration_ns:
            return StopReason.COMPLETED, "completed"
        return None

    def _stopping(self, now_ns: int) -> None:
        """Wait for the drive's own word; not at once, for what arrives first was said before the request."""
        settled = now_ns - self._stage_began_ns >= SETTLE_PERIODS * self._config.period_ns
        if self._host.drive_state in _NO_TORQUE and settled:
            self._disabled = True
            self._stage = Stage.ENDED
        elif now_ns >= self._stage_end_ns:
            waited_ms = self._config.disable_timeout_ns / 1e6
            self._message += f"; the drive did not confirm that it is disabled within {waited_ms:.0f} ms"
            self._stage = Stage.ENDED

    def _enter(self, stage: Stage, now_ns: int, timeout_ns: int) -> None:
        self._stage = stage
        self._stage_work = self._works[stage]
        self._stage_began_ns = now_ns
        self._stage_end_ns = now_ns + timeout_ns

    def _stop(self, reason: StopReason, message: str, now_ns: int) -> None:
        self._reason, self._message = reason, message
        self._host.disable()
        self._enter(Stage.STOPPING, now_ns, self._config.disable_timeout_ns)

    def _end(self, reason: StopReason, message: str) -> None:
        if self._reason is None:
            self._reason, self._message = reason, message
        else:
            self._message += f"; {message}"
        self._disabled = self._stage is Stage.CONNECTING or self._host.drive_state is DriveState.FAULT
        self._stage = Stage.ENDED

    def _look(self) -> Telemetry:
        pipeline = self._pipeline
        newest, zero_ns = pipeline.newest, pipeline.zero_ns
        time_s = math.nan if newest is None or zero_ns is None else (newest.stamp_ns - zero_ns) * 1e-9
        counters = self._counters
        return Telemetry(
            stage=self._stage,
            time_s=time_s,
            theta_m_rad=pipeline.sample.theta_m_rad,
            reference_rad=self._reference_rad,
            tau_w_N_m=pipeline.estimate.tau_w_N_m,
            elongation_m=pipeline.estimate.elongation_m,
            frames_sent=counters["frames_sent"],
            frames_received=counters["frames_received"],
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
