"""The course of a run: its stages, what moves it from one to the next, and what ends it.

CONNECTING  ask who is there until the drive is ready; refuse a version that does not fit
ENABLING    ask the drive for power; references equal the measured angle
RUNNING     references follow the trajectory
STOPPING    no references any more; wait until the drive says that it is disabled
STOPPED     an operator's emergency stop: no torque, until it is cleared or the run is ended

Whatever ends a run that asked for torque goes through STOPPING, but for a bus that is gone: there the drive's own
watchdog stops the motor. To clear an emergency stop makes the drive forget its fault and ends the run: torque comes
back with another run only.
"""

from collections.abc import Callable
from typing import Final

from firmware_protocol.messages import DriveState
from firmware_protocol.states import HostPhase
from hil_forceps.bridge.pipeline import VERDICT_NAMES, Pipeline
from hil_forceps.bridge.results import ServiceConfig, Stage, StopReason
from hil_forceps.control.gate.trip import IMPLAUSIBLE
from hil_forceps.data.recording.writer import Recorder
from hil_forceps.drives.port import NO_TORQUE, DriveMachine

# Until then it takes the heartbeats of the next host for old ones (HFP-085), and does not see ENABLE rise.
REFUSED_HOST: Final = "it enables a new host only 0.1 s after the last one stopped; start again"
SETTLE_PERIODS: Final = 5  # before the drive's word counts: what arrives first was said before the request
SILENT_PERIODS: Final = 20  # at least so many without a sample before a drive counts as silent, however slow the loop

# Members of an Enum cost as much as a call when looked up by their class, and these are asked for at every tick.
_HOST_RUNNING: Final = HostPhase.RUNNING
_RUNNING: Final = Stage.RUNNING
_ENABLING: Final = Stage.ENABLING


class Course:
    """Where a run is and, at its end, why: `stage`, `reason`, `message`, `drive_disabled`.

    `advance` looks at what the tick brought; `last_sample_ns` (host's clock) and `frames_received` are told from
    outside.
    """

    def __init__(
        self,
        host: DriveMachine,
        pipeline: Pipeline,
        config: ServiceConfig,
        recorder: Recorder | None,
        stop_requested: Callable[[], bool],
        may_enable: Callable[[], bool] = lambda: True,
    ) -> None:
        """`may_enable` is asked while the drive is ready; until it may, the drive stays without torque."""
        self.stage = Stage.CONNECTING
        self.reason: StopReason | None = None
        self.message = ""
        self.drive_disabled = False
        self.last_sample_ns = 0
        self.frames_received = 0
        self._host = host
        self._pipeline = pipeline
        self._config = config
        self._recorder = recorder
        self._stop_requested = stop_requested
        self._may_enable = may_enable
        self._silence_ns = max(config.silence_timeout_ns, SILENT_PERIODS * config.period_ns)
        self._steps: dict[Stage, Callable[[int], None]] = {
            Stage.CONNECTING: self._connecting,
            Stage.ENABLING: self._enabling,
            Stage.RUNNING: self._running,
            Stage.STOPPING: self._stopping,
            Stage.STOPPED: self._stopped,
        }
        self.advance: Callable[[int], None] = self._connecting  # that of the stage, looked up only when it begins
        self._reset_asked = False
        self._is_clearing = False
        self._began_ns = 0
        self._end_ns = 0

    def begin(self, now_ns: int) -> None:
        """Start to ask for the drive."""
        self._enter(Stage.CONNECTING, now_ns, self._config.connect_timeout_ns)
        self._host.connect(now_ns)

    def sends_references(self) -> bool:
        """Tell whether references are to be computed in this stage."""
        return self.stage is _RUNNING or self.stage is _ENABLING

    def bus_is_down(self) -> None:
        """End at once: nothing can be said to the drive any more."""
        self._end(StopReason.BUS_DOWN, "the bus failed; the drive's watchdog stops the motor")

    def stop(self, reason: StopReason, message: str, now_ns: int) -> None:
        """End for a reason from outside, whatever the stage; nothing where it ends already."""
        if self.stage is Stage.CONNECTING:
            self._end(reason, message)
        elif self.reason is None:
            self._stop(reason, message, now_ns)

    def emergency_stop(self, now_ns: int) -> None:
        """Take torque off for good, whatever the stage."""
        if self.stage in {Stage.STOPPED, Stage.ENDED}:
            return
        if self.reason is None:
            self.reason, self.message = StopReason.EMERGENCY_STOP, "stopped by an operator"
        self._host.disable()
        self._enter(Stage.STOPPED, now_ns, 0)

    def has_torque_in_spite(self) -> bool:
        """Tell whether the drive has not followed an emergency stop yet."""
        said = self._host.drive_state
        return self.stage is Stage.STOPPED and said is not None and said not in NO_TORQUE

    def clear(self, now_ns: int) -> None:
        """Clear an emergency stop: the drive is to forget its fault. Nothing in other stages."""
        if self.stage is not Stage.STOPPED or self._is_clearing:
            return
        self._is_clearing = True
        self._end_ns = now_ns + self._config.enable_timeout_ns
        if self._host.phase is HostPhase.FAULT:
            self._host.reset_fault()

    def _connecting(self, now_ns: int) -> None:
        phase = self._host.phase
        if self._stop_requested():
            self._end(StopReason.STOP_REQUESTED, "stopped on request before the drive was enabled")
        elif phase is HostPhase.REFUSED:
            self._end(StopReason.VERSION_REFUSED, self._host.refusal)
        elif phase is HostPhase.FAULT and self._config.reset_fault and now_ns < self._end_ns:
            if not self._reset_asked:
                self._reset_asked = True
                self._host.reset_fault()
        elif phase is HostPhase.FAULT:
            words = self._host.fault_words()
            self._end(StopReason.DRIVE_FAULT, f"the drive has a latched fault: {words}; reset it with --reset-fault")
        elif phase is HostPhase.READY:
            if self._may_enable():
                self._host.enable()
                self._enter(Stage.ENABLING, now_ns, self._config.enable_timeout_ns)
        elif now_ns >= self._end_ns:
            frames = self.frames_received
            heard = f"{frames} frames were received, none of this drive" if frames else "no frame was received"
            self._end(
                StopReason.NO_DRIVE,
                f"no drive answered: {heard}; check node id, bit rate and wiring; `hil-forceps scan` lists the drives",
            )

    def _enabling(self, now_ns: int) -> None:
        phase = self._host.phase
        if phase is HostPhase.RUNNING:
            self.last_sample_ns = now_ns
            self._enter(Stage.RUNNING, now_ns, 0)
        elif self._stop_requested():
            self._stop(StopReason.STOP_REQUESTED, "stopped on request while enabling", now_ns)
        elif phase is HostPhase.FAULT:
            self._stop(
                StopReason.DRIVE_FAULT, f"fault while enabling: {self._host.fault_words()}{self._lateness()}", now_ns
            )
        elif phase is HostPhase.REFUSED:
            self._stop(StopReason.VERSION_REFUSED, self._host.refusal, now_ns)
        elif phase is HostPhase.DISCONNECTED:
            self._stop(StopReason.DRIVE_LOST, "the drive sent no more samples or restarted while enabling", now_ns)
        elif now_ns >= self._end_ns:
            line = self._pipeline
            why = f"{line.counters['samples']} samples received"
            if line.denied_in_a_row:
                why = (
                    f"the gate denies the measured angle: {VERDICT_NAMES[line.verdict]}; check whether it is within "
                    f"`limits:`: the motor is at {line.sample.theta_m_rad:.4g} rad by the rig (encoder_zero_rev, and "
                    "size and sign of encoder_rev_per_pulley_rev)"
                )
            elif self._host.drive_state is DriveState.OPERATIONAL:
                why = "it is operational, but for another program; end that program first"
            elif self._host.drive_state is DriveState.DISABLED:
                why += f", and it stays DISABLED; if another program controlled it just before: {REFUSED_HOST}"
            self._stop(
                StopReason.ENABLE_FAILED, f"the drive did not become operational: {why}{self._lateness()}", now_ns
            )

    def _running(self, now_ns: int) -> None:
        is_well = self._host.phase is _HOST_RUNNING and now_ns - self.last_sample_ns <= self._silence_ns
        ended = self._enough() if is_well else self._trouble(now_ns)
        if ended is not None:
            self._stop(*ended, now_ns)

    def _trouble(self, now_ns: int) -> tuple[StopReason, str]:
        host, silent_ns = self._host, now_ns - self.last_sample_ns
        if host.phase is HostPhase.FAULT:
            return StopReason.DRIVE_FAULT, f"the drive latched a fault: {host.fault_words()}{self._lateness()}"
        if host.phase is HostPhase.REFUSED:
            return StopReason.VERSION_REFUSED, host.refusal
        if host.phase is HostPhase.DISCONNECTED or silent_ns > self._silence_ns:
            return (
                StopReason.DRIVE_LOST,
                f"the drive sent no more samples or restarted: last sample {silent_ns / 1e6:.0f} ms ago",
            )
        return StopReason.DRIVE_STOPPED, "the drive left the operational state without a request and without a fault"

    def _lateness(self) -> str:
        """Return words where references stayed away because samples came too late: a watchdog then did what it must."""
        counters = self._pipeline.counters
        if self._pipeline.denied_in_a_row:
            return f"; the gate denied the reference: {VERDICT_NAMES[self._pipeline.verdict]}"
        if counters["stale"] <= counters["passed"]:
            return ""
        return (
            f"; {counters['stale']} references were not sent, because samples were older than limits.max_sample_age_s"
        )

    def _enough(self) -> tuple[StopReason, str] | None:
        pipeline, config = self._pipeline, self._config
        if pipeline.is_latched:
            return self._latched()
        if pipeline.denied_in_a_row >= config.max_denied_in_a_row:
            why = VERDICT_NAMES[self._pipeline.verdict]
            return StopReason.REFERENCE_DENIED, f"the gate denied {pipeline.denied_in_a_row} references in a row: {why}"
        if self._recorder is not None and self._recorder.failure:
            return StopReason.RECORDING_FAILED, self._recorder.failure
        if self._stop_requested():
            return StopReason.STOP_REQUESTED, "stopped on request"
        newest, zero_ns, duration_ns = pipeline.newest, pipeline.zero_ns, config.duration_ns
        if duration_ns is not None and newest and zero_ns is not None and newest.stamp_ns - zero_ns >= duration_ns:
            return self._completed(newest.stamp_ns - pipeline.passed_stamp_ns)
        return None

    def _completed(self, without_ns: int) -> tuple[StopReason, str]:
        """Return how a run ends whose time is over, `without_ns` after the last sample that made a reference.

        A drive that lets its motor go without a fault, where references stay away, tells nothing of it.
        """
        if without_ns <= self._pipeline.gate.max_gap_ns:
            return StopReason.COMPLETED, "completed"
        why = "samples were older than limits.max_sample_age_s"
        if self._pipeline.denied_in_a_row:
            why = f"the gate denied them: {VERDICT_NAMES[self._pipeline.verdict]}"
        return (
            StopReason.REFERENCE_DENIED,
            f"no reference was sent in the last {without_ns / 1e6:.0f} ms of the run: {why}",
        )

    def _latched(self) -> tuple[StopReason, str]:
        trip = self._pipeline.gate_trip
        is_implausible = trip is not None and trip.check in IMPLAUSIBLE
        reason = StopReason.FEEDBACK_IMPLAUSIBLE if is_implausible else StopReason.GATE_LATCHED
        return reason, f"the gate has latched: {trip}"

    def _stopping(self, now_ns: int) -> None:
        """Wait for the drive's own word; not at once, for what arrives first was said before the request."""
        settled = now_ns - self._began_ns >= SETTLE_PERIODS * self._config.period_ns
        if self._host.drive_state in NO_TORQUE and settled:
            self.drive_disabled = True
            self.stage = Stage.ENDED
        elif now_ns >= self._end_ns:
            waited_ms = self._config.disable_timeout_ns / 1e6
            self.message += f"; the drive did not confirm that it is disabled within {waited_ms:.0f} ms"
            self.stage = Stage.ENDED

    def _stopped(self, now_ns: int) -> None:
        """Wait for an operator: it takes somebody to say that it is well again."""
        said = self._host.drive_state
        self.drive_disabled = said is None or said in NO_TORQUE
        if self._is_clearing and self.drive_disabled and said is not DriveState.FAULT:
            self.message += "; cleared"
            self.stage = Stage.ENDED
        elif self._stop_requested():
            self.message += "; not cleared"
            self.stage = Stage.ENDED
        elif now_ns >= self._end_ns:
            self._is_clearing = False  # the fault is still there; it may be cleared again

    def _enter(self, stage: Stage, now_ns: int, timeout_ns: int) -> None:
        self.stage = stage
        self.advance = self._steps[stage]
        self._began_ns = now_ns
        self._end_ns = now_ns + timeout_ns

    def _stop(self, reason: StopReason, message: str, now_ns: int) -> None:
        self.reason, self.message = reason, message
        self._host.disable()
        self._enter(Stage.STOPPING, now_ns, self._config.disable_timeout_ns)

    def _end(self, reason: StopReason, message: str) -> None:
        if self.reason is None:
            self.reason, self.message = reason, message
        else:
            self.message += f"; {message}"
        said = self._host.drive_state
        if self.stage is not Stage.CONNECTING:
            self.drive_disabled = said is DriveState.FAULT
        else:
            self.drive_disabled = said is None or said in NO_TORQUE
            if not self.drive_disabled:
                self.message += "; the drive has torque that this run did not request"
        self.stage = Stage.ENDED
