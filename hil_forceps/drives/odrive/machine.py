"""An ODrive over CANSimple, firmware 0.5 or 0.6, as the host sees it.

    DISCONNECTED -> IDENTIFYING  heartbeat, encoder estimates and Iq are waited for; nothing is sent
    IDENTIFYING  -> READY        all three came, heartbeats and estimates no more often than one drive sends them
    IDENTIFYING  -> REFUSED      one of them does not come: ODrive sends Iq only where it is told to; or what has the
                                 heartbeat's id comes so fast that something else speaks here; or estimates come as
                                 often as of two drives with one id; or the axis calibrates
    READY        -> ENABLING     where the axis isn't idle, idle is asked for; with each of the first references go mode
                                 and limits; then closed loop is asked for. An ODrive that enters it goes to the last
                                 input it was given, however old that is: so that is the measured angle, and it stays
                                 what it was when closed loop was asked for until a heartbeat has answered.
    ENABLING     -> RUNNING      the heartbeat says closed loop, as it was asked to
    RUNNING      -> READY        the heartbeat says otherwise, without an error
    any          -> FAULT        the heartbeat has an error
    FAULT        -> IDENTIFYING  the error is cleared
    any          -> DISCONNECTED no heartbeat for `HEARTBEAT_TIMEOUT_NS`

Any frame feeds an ODrive's watchdog. So nothing is sent while it runs but references from fresh samples.

ODrive stamps nothing, and angle and current come in different frames. A sample's stamp is the arrival of its encoder
estimates. Its current is that which comes right behind them, from the same tick of the drive; where none does, the
newest that came before, as long as that is not too old.
"""

import math
from typing import Final, NamedTuple

from firmware_protocol.frames import Frame
from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV
from firmware_protocol.states import HostPhase
from hil_forceps.drives import sample_queue
from hil_forceps.drives.odrive import messages as wire
from hil_forceps.drives.odrive.messages import AxisState, Command, Firmware
from hil_forceps.drives.port import NO_TORQUE, SEQUENCE_MASK
from hil_forceps.drives.supervision.message_rate import MessageRate
from hil_forceps.drives.transitions import COMMON, P

HEARTBEAT_TIMEOUT_NS: Final = 350_000_000  # three of its heartbeats and a half, which come every 100 ms
IDENTIFY_NS: Final = 1_000_000_000  # for all three kinds of frames to come
MIN_HEARTBEAT_NS: Final = 5_000_000  # between two; a twentieth of what an ODrive takes unless told otherwise
MAX_HASTY_HEARTBEATS_IN_A_ROW: Final = 3  # shorter intervals in a row: more than a host that was late makes
REPEAT_NS: Final = 50_000_000  # between requests of idle that no heartbeat shows yet
MAX_CURRENT_AGE_PERIODS: Final = 2.5  # of Iq, beyond which a sample has no current
FLIGHT_NS: Final = 10_000_000  # for a request to arrive, and for a heartbeat from before it to have come
FIRST_REFERENCES: Final = 3  # sent before closed loop is asked for: two may be lost

COUNTERS: Final = (
    "setpoints_sent",
    "not_for_us",
    "bad_length",
    "no_estimate",  # exactly 0.0 and 0.0 behind another angle: what an ODrive sends whose estimate is invalid
    "without_current",
    "not_increasing",
    *sample_queue.COUNTERS,
)

# Besides what every drive has.
TRANSITIONS: Final = COMMON | {
    (P.ENABLING, "closed loop"): P.RUNNING,
    (P.RUNNING, "left"): P.READY,
    (P.FAULT, "cleared"): P.IDENTIFYING,
}


class ODriveConfig(NamedTuple):
    """One axis and how it sits on the motor pulley."""

    node: int
    firmware: Firmware
    rev_per_pulley_rev: float  # of the ODrive's encoder, with the sign of the direction
    zero_rev: float  # what the ODrive calls the angle 0 of the motor pulley
    velocity_limit_rad_per_s: float  # of the motor pulley
    current_limit_A: float
    feedback_period_ns: int  # of encoder estimates, as it is set in the drive
    iq_period_ns: int  # likewise


class ODrive:
    """One axis of an ODrive; a `DriveMachine`."""

    def __init__(self, config: ODriveConfig) -> None:
        """ValueError for a node or a ratio that can't be."""
        if not 0 <= config.node <= wire.MAX_NODE or config.rev_per_pulley_rev == 0.0:
            raise ValueError(f"no ODrive: {config}")
        self.config = config
        self.phase = HostPhase.DISCONNECTED
        self.refusal = ""
        self.drive_state: DriveState | None = None
        self.setpoint_sequence = 0
        self.counters = dict.fromkeys(COUNTERS, 0)
        self._heartbeat: wire.Heartbeat | None = None
        self._heartbeat_ns = 0
        self._has_pace = False  # two heartbeats came as far apart as heartbeats do
        self._hasty = 0  # intervals in a row that are too short for heartbeats
        self._current: wire.Iq | None = None
        self._current_ns = 0
        self._estimates_rate = MessageRate(config.feedback_period_ns)
        self._position_rev: float | None = None
        self._pending: tuple[float, int] | None = None  # a position with its arrival, that waits for its current
        self._stamp_ns = -1
        self._samples = sample_queue.SampleQueue(self.counters)
        self._since_ns = 0  # of the phase
        self._is_set = False  # mode and limits were sent, once at least
        self._references = 0  # sent while enabling, since mode and limits were first sent
        self._newest_raw: int | None = None  # the reference that went out since the last tick, if one did
        self._held_raw: int | None = None  # the reference with which closed loop was asked for
        self._closed_asked_ns = 0
        self._wants_idle = False
        self._idle_first_ns: int | None = None  # when idle was first asked for
        self._idle_last_ns = 0
        self._clears = False

    def connect(self, now_ns: int) -> None:
        """Listen for the drive; ValueError while connected."""
        if self.phase not in {HostPhase.DISCONNECTED, HostPhase.REFUSED}:
            raise ValueError(f"an ODrive that is {self.phase.name} is connected already")
        self._since_ns = now_ns
        self.refusal = ""
        self._heartbeat, self._has_pace, self._hasty = None, False, 0
        self._estimates_rate = MessageRate(self.config.feedback_period_ns)
        self._fire("connect")

    def enable(self) -> None:
        """Ask for closed loop control; ValueError unless READY."""
        if self.phase is not HostPhase.READY:
            raise ValueError(f"an ODrive that is {self.phase.name} can't be enabled")
        self._is_set, self._references, self._newest_raw, self._held_raw = False, 0, None, None
        self._wants_idle, self._idle_first_ns = False, None
        self._fire("enable")

    def disable(self) -> None:
        """Ask for idle, until a heartbeat from behind the request says so."""
        if self.phase in {HostPhase.ENABLING, HostPhase.RUNNING}:
            # Closed loop may have been asked for and not be in a heartbeat yet: what the last one said doesn't count.
            self.drive_state = None
        self._wants_idle, self._idle_first_ns = True, None
        self._fire("disable")

    def reset_fault(self) -> None:
        """Clear the errors once; ValueError unless in FAULT."""
        if self.phase is not HostPhase.FAULT:
            raise ValueError("there is no fault to clear")
        self._clears = True

    def estop_frame(self) -> Frame:
        """Return ESTOP."""
        return wire.estop(self.config.node)

    def fault_words(self) -> str:
        """Return the axis error in words."""
        return wire.error_words(self.config.firmware, 0 if self._heartbeat is None else self._heartbeat.axis_error)

    def take_samples(self) -> list[RawSample]:
        """Hand over the samples since the last call, oldest first."""
        return self._samples.take()

    def take_bench(self) -> list[RawBench]:
        """Return nothing: an ODrive has no bench sensors."""
        return []

    def setpoint(self, theta_m_ref_raw: int) -> Frame | None:
        """Return SET_INPUT_POS; from the request of closed loop until its answer, with the angle at that request."""
        if self.phase is HostPhase.ENABLING:
            if self._held_raw is not None:
                theta_m_ref_raw = self._held_raw
            elif not self._is_set or self.drive_state is not DriveState.DISABLED:
                return None
            self._references += 1
        elif self.phase is not HostPhase.RUNNING:
            return None
        self._newest_raw = theta_m_ref_raw
        self.setpoint_sequence = self.setpoint_sequence + 1 & SEQUENCE_MASK
        self.counters["setpoints_sent"] += 1
        config = self.config
        return wire.set_input_pos(
            config.node, config.zero_rev + theta_m_ref_raw / ANGLE_LSB_PER_REV * config.rev_per_pulley_rev
        )

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take one frame from the bus."""
        node, data = self.config.node, frame.data
        if frame.is_extended:  # CANSimple has ids of 11 bits only
            self.counters["not_for_us"] += 1
        elif frame.arbitration_id == wire.frame_id(node, Command.ENCODER_ESTIMATES):
            self._see_estimates(wire.parse_estimates(data), now_ns)
        elif frame.arbitration_id == wire.frame_id(node, Command.GET_IQ):
            current = wire.parse_iq(data)
            if current is None:
                self.counters["bad_length"] += 1
            else:
                self._current, self._current_ns = current, now_ns
                self._complete()
        elif frame.arbitration_id == wire.frame_id(node, Command.HEARTBEAT):
            self._see_heartbeat(wire.parse_heartbeat(data), now_ns)
        else:
            self.counters["not_for_us"] += 1

    def poll(self, now_ns: int) -> list[Frame]:
        """Return what is due: settings, a request of a state, or an order to forget errors."""
        reference_raw, self._newest_raw = self._newest_raw, None
        if self.phase is HostPhase.IDENTIFYING:
            self._identify(now_ns)
        elif self._heartbeat is not None and now_ns - self._heartbeat_ns > HEARTBEAT_TIMEOUT_NS:
            self.drive_state = None  # an old word
            self._fire("gone")
        if self._clears:
            self._clears = False
            return [wire.clear_errors(self.config.node)]
        if self.phase is HostPhase.ENABLING:
            return self._enable(reference_raw, now_ns)
        if self._wants_idle and (self._idle_first_ns is None or self.drive_state not in NO_TORQUE):
            return self._ask_idle(now_ns)
        return []

    def _enable(self, reference_raw: int | None, now_ns: int) -> list[Frame]:
        """Return the next step towards closed loop; `reference_raw` is what went out in this tick."""
        if self._held_raw is not None:
            return []
        if self.drive_state is not DriveState.DISABLED:  # it has torque by another's word
            self._is_set, self._references = False, 0
            return self._ask_idle(now_ns)
        node, config = self.config.node, self.config
        if self._is_set and reference_raw is None:  # nothing is asked for without a fresh angle
            return []
        if self._references >= FIRST_REFERENCES:
            self._held_raw, self._closed_asked_ns = reference_raw, now_ns
            return [wire.set_axis_state(node, AxisState.CLOSED_LOOP_CONTROL)]
        self._is_set = True
        velocity = abs(config.velocity_limit_rad_per_s * config.rev_per_pulley_rev) / (2.0 * math.pi)
        return [wire.set_position_control(node), wire.set_limits(node, velocity, config.current_limit_A)]

    def _ask_idle(self, now_ns: int) -> list[Frame]:
        if self._idle_first_ns is None:
            self._idle_first_ns = now_ns
        elif now_ns - self._idle_last_ns < REPEAT_NS:
            return []
        self._idle_last_ns = now_ns
        return [wire.set_axis_state(self.config.node, AxisState.IDLE)]

    def _identify(self, now_ns: int) -> None:
        missing = [
            words
            for words, value in (
                ("heartbeats", self._heartbeat if self._has_pace else None),
                ("encoder estimates", self._position_rev),
                ("Iq", self._current),
            )
            if value is None
        ]
        is_busy = self.drive_state is DriveState.ARMED  # calibrates, looks for an index, homes
        is_over = now_ns - self._since_ns > IDENTIFY_NS
        if not missing and not is_busy and self._estimates_rate.is_one_drive:
            self._fire("complete")
        elif not missing and is_over and self._estimates_rate.is_one_drive is False:
            interval_ms = (self._estimates_rate.interval_ns or 0.0) / 1e6
            self.refusal = (
                f"encoder estimates of node {self.config.node} come every {interval_ms:.2g} ms, and "
                f"motor_driver.feedback_period_s is {self.config.feedback_period_ns / 1e6:g} ms: another drive has the "
                "same node id, or the rig another period than the drive; give each drive an id of its own, or correct "
                "the rig"
            )
            self._fire("refuse")
        elif is_busy and not missing and is_over and self._heartbeat is not None:
            state = self._heartbeat.axis_state
            self.refusal = (
                f"node {self.config.node} is calibrating or homing (axis state {state}); wait until it is idle"
            )
            self._fire("refuse")
        elif self._has_pace and missing and is_over:
            key = "iq_rate_ms" if self.config.firmware == "0.5" else "iq_msg_rate_ms"
            self.refusal = (
                f"node {self.config.node} sends heartbeats, but no {' and no '.join(missing)}; set its cyclic messages "
                f"with odrivetool, among them axis0.config.can.{key}, and save the configuration"
            )
            self._fire("refuse")

    def _see_heartbeat(self, heartbeat: wire.Heartbeat | None, now_ns: int) -> None:
        if heartbeat is None:
            self.counters["bad_length"] += 1
            return
        self._see_pace(now_ns)
        self._heartbeat, self._heartbeat_ns = heartbeat, now_ns
        if self.phase is HostPhase.IDENTIFYING and not self._has_pace:
            return
        self._see_state(heartbeat, now_ns)

    def _see_state(self, heartbeat: wire.Heartbeat, now_ns: int) -> None:
        closed = heartbeat.axis_state == AxisState.CLOSED_LOOP_CONTROL
        has_torque = heartbeat.axis_state not in {AxisState.UNDEFINED, AxisState.IDLE}
        if heartbeat.axis_error:
            self.drive_state = DriveState.ARMED if has_torque else DriveState.FAULT
            self._fire("fault")
            return
        self._clears = False
        if closed:
            self.drive_state = DriveState.OPERATIONAL
        elif has_torque:  # calibrates, looks for an index, homes
            self.drive_state = DriveState.ARMED
        elif not self._wants_idle or self._is_behind_idle(now_ns):
            self.drive_state = DriveState.DISABLED
        if self.phase is HostPhase.FAULT:
            self._since_ns = now_ns
        self._fire("cleared")
        if not closed:
            self._fire("left")
            if self._held_raw is not None and now_ns - self._closed_asked_ns >= FLIGHT_NS:
                self._held_raw = None  # the request was lost, or refused: once more, from where the motor is now
        elif self._held_raw is not None:  # else it is in closed loop by somebody else's word
            self._fire("closed loop")

    def _see_pace(self, now_ns: int) -> None:
        if self._has_pace or self._heartbeat is None:
            return
        if now_ns - self._heartbeat_ns >= MIN_HEARTBEAT_NS:
            self._has_pace = True
            return
        self._hasty += 1
        if self._hasty >= MAX_HASTY_HEARTBEATS_IN_A_ROW:
            node = self.config.node
            self.refusal = (
                f"frames with the id of node {node}'s heartbeats ({wire.frame_id(node, Command.HEARTBEAT):03X}h) come "
                f"less than {MIN_HEARTBEAT_NS / 1e6:g} ms apart: another device sends them, or the "
                "heartbeat period is too short; check motor_driver.profile and node_id, and the drive's heartbeat "
                "period"
            )
            self._fire("refuse")

    def _is_behind_idle(self, now_ns: int) -> bool:
        """Whether a heartbeat was made after idle was asked for, as far as its arrival tells."""
        return self._idle_first_ns is not None and now_ns - self._idle_first_ns >= FLIGHT_NS

    def _see_estimates(self, estimates: wire.Estimates | None, now_ns: int) -> None:
        if estimates is None:
            self.counters["bad_length"] += 1
            return
        self._estimates_rate.receive(now_ns)
        if estimates == (0.0, 0.0) and self._position_rev not in (None, 0.0):
            self.counters["no_estimate"] += 1
            return
        self._position_rev = estimates.position_rev
        if now_ns <= self._stamp_ns or (self._pending is not None and now_ns <= self._pending[1]):
            self.counters["not_increasing"] += 1
            return
        self._complete()  # with the current of before: none came behind it
        self._pending = (estimates.position_rev, now_ns)

    def _complete(self) -> None:
        """Make a sample of the position that waits, if one does, with the newest current."""
        if self._pending is None:
            return
        (position_rev, at_ns), self._pending = self._pending, None
        config, current = self.config, self._current
        if current is None or abs(at_ns - self._current_ns) > MAX_CURRENT_AGE_PERIODS * config.iq_period_ns:
            self.counters["without_current"] += 1
            return
        is_taken = self._samples.append(
            stamp_ns=at_ns,
            received_ns=at_ns,
            pulley_rev=(position_rev - config.zero_rev) / config.rev_per_pulley_rev,
            current_A=math.copysign(1.0, config.rev_per_pulley_rev) * current.measured_A,
            state=self.drive_state,
            setpoint_sequence=self.setpoint_sequence,
        )
        if is_taken:
            self._stamp_ns = at_ns

    def _fire(self, event: str) -> None:
        self.phase = TRANSITIONS.get((self.phase, event), self.phase)
