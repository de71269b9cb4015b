"""A moteus over CAN FD, as the host sees it.

    DISCONNECTED -> IDENTIFYING  it is asked who it is; a moteus says nothing unless it is asked
    IDENTIFYING  -> READY        its registers are those that are known here, and it is stopped
    IDENTIFYING  -> REFUSED      its registers are others, or somebody else drives it
    READY        -> ENABLING     the measured angle is sent as the reference, in position mode
    ENABLING     -> RUNNING      an answer says position mode
    RUNNING      -> READY        an answer says another mode, without a fault
    set up       -> REFUSED      it answers more often than it is asked
    any          -> FAULT        an answer says fault, or timeout: its watchdog, which only a stop command ends
    FAULT        -> IDENTIFYING  it is stopped again
    any          -> DISCONNECTED no answer for `silence_ns`, or its clock began anew

Each tick sends one frame: a reference, which asks for feedback in the same frame, or a mere query where there is none.
A query commands nothing and doesn't feed the watchdog (`fw/moteus_controller.cc`: only a frame that writes the mode is
a command), so a lost answer doesn't end in silence on both sides, and an estimator that stalls still stops the motor.

A moteus that was reset would follow the next reference at once, from an angle that may have jumped by whole turns. It
is told by the mode, and by its millisecond counter, which goes with every answer.

A moteus stamps nothing. It reads when the request arrives, so between its sending and the answer's arrival; a sample's
stamp is the middle of these. Angle and current are read one after the other, at most one period of its loop apart.
"""

import math
from typing import Final, NamedTuple

from firmware_protocol.frames import Frame, make
from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV
from firmware_protocol.states import HostPhase
from hil_forceps.drives import sample_queue
from hil_forceps.drives.moteus import messages as wire
from hil_forceps.drives.moteus.messages import Mode
from hil_forceps.drives.port import NO_TORQUE, SEQUENCE_MASK
from hil_forceps.drives.supervision.answer_count import AnswerCount
from hil_forceps.drives.transitions import COMMON, P

IDENTIFY_EVERY_NS: Final = 10_000_000  # a bus where nobody acknowledges repeats each frame by itself
FLIGHT_NS: Final = 10_000_000  # for a stop to arrive and be obeyed, and for answers from before it to have come
# A millisecond counter that is less behind is of a late answer, else of another start.
MAX_COUNTER_STEP_BACK_MS: Final = 50
_HALF32, _MASK32 = 1 << 31, (1 << 32) - 1
_PREPARING: Final = frozenset({Mode.ENABLING, Mode.CALIBRATING, Mode.CALIBRATION_COMPLETE})
_LATCHED: Final = frozenset({Mode.FAULT, Mode.TIMEOUT})
_SILENT: Final = frozenset({HostPhase.DISCONNECTED, HostPhase.REFUSED})

COUNTERS: Final = (
    "setpoints_sent",
    "not_for_us",
    "bad_reply",
    "no_value",  # an angle or a current that is NaN: what a moteus sends where it has none
    "stale",
    "restarts",
    "not_increasing",
    *sample_queue.COUNTERS,
)

# Besides what every drive has.
TRANSITIONS: Final = COMMON | {
    (P.READY, "refuse"): P.REFUSED,
    (P.ENABLING, "refuse"): P.REFUSED,
    (P.RUNNING, "refuse"): P.REFUSED,
    (P.ENABLING, "position"): P.RUNNING,
    (P.RUNNING, "left"): P.READY,
    (P.FAULT, "cleared"): P.IDENTIFYING,
}


class MoteusConfig(NamedTuple):
    """One moteus and how its output sits on the motor pulley."""

    node: int
    rev_per_pulley_rev: float  # of what the moteus calls its output, with the sign of the direction
    zero_rev: float  # what it calls the angle 0 of the motor pulley
    max_torque_N_m: float  # at its output
    watchdog_s: float
    silence_ns: int


class Moteus:
    """One moteus; a `DriveMachine`."""

    def __init__(self, config: MoteusConfig) -> None:
        """ValueError for a node, a ratio or a command that can't be."""
        if not 1 <= config.node <= wire.MAX_NODE or config.rev_per_pulley_rev == 0.0:
            raise ValueError(f"no moteus: {config}")
        self.config = config
        self.phase = HostPhase.DISCONNECTED
        self.refusal = ""
        self.drive_state: DriveState | None = None
        self.setpoint_sequence = 0
        self.counters = dict.fromkeys(COUNTERS, 0)
        command = wire.Command(config.max_torque_N_m, config.watchdog_s)
        self._request_id, self._head, self._tail = wire.position_command(config.node, command)
        self._reply_id = wire.reply_id(config.node)
        self._reply_is_extended = wire.is_extended(self._reply_id)
        self._samples = sample_queue.SampleQueue(self.counters)
        self._feedback: wire.Feedback | None = None
        self._heard_ns: int | None = None
        self._asked_ns: int | None = None  # when the last frame that wants an answer was sent
        self._answers = AnswerCount()
        self._has_asked = False  # a reference of this tick has
        self._stamp_ns = -1
        self._held_raw: int | None = None  # the reference while enabling: the angle when it began
        self._is_commanded = False  # references went out, and no answer from behind a stop has come since
        self._wants_stop = False
        self._stop_ns: int | None = None  # when a stop was first sent
        self._clears = False

    def connect(self, now_ns: int) -> None:  # noqa: ARG002 - it is asked at the next tick
        """Look for the drive."""
        self.refusal = ""
        self._feedback, self._heard_ns, self._asked_ns = None, None, None
        self._answers = AnswerCount()
        self._fire("connect")

    def enable(self) -> None:
        """Ask for position mode; ValueError unless READY."""
        if self.phase is not HostPhase.READY:
            raise ValueError(f"a moteus that is {self.phase.name} can't be enabled")
        self._held_raw, self._wants_stop, self._stop_ns = None, False, None
        self._fire("enable")

    def disable(self) -> None:
        """Send stops, until an answer from behind the first says that it is stopped."""
        if self._is_commanded and self.drive_state is not DriveState.FAULT:
            self.drive_state = None  # a command may be on its way that no answer shows yet
        self._wants_stop, self._stop_ns = True, None
        self._fire("disable")

    def reset_fault(self) -> None:
        """Clear fault or timeout by one stop; ValueError unless in FAULT."""
        if self.phase is not HostPhase.FAULT:
            raise ValueError("there is no fault to clear")
        self._clears = True

    def estop_frame(self) -> Frame:
        """Return the stop command; a moteus has none that is stronger."""
        return wire.stop(self.config.node)

    def fault_words(self) -> str:
        """Return the fault, or the timeout, in words."""
        return (
            "no fault reported"
            if self._feedback is None
            else wire.fault_words(self._feedback.mode, self._feedback.fault)
        )

    def take_samples(self) -> list[RawSample]:
        """Hand over the samples since the last call, oldest first."""
        return self._samples.take()

    def take_bench(self) -> list[RawBench]:
        """Return nothing: a moteus has no bench sensors."""
        return []

    def setpoint(self, theta_m_ref_raw: int) -> Frame | None:
        """Return the position command, which asks for feedback; while enabling, with the angle at which that began."""
        if self.phase is HostPhase.ENABLING:
            if self._held_raw is None:
                self._held_raw = theta_m_ref_raw
            theta_m_ref_raw = self._held_raw
        elif self.phase is not HostPhase.RUNNING:
            return None
        self.setpoint_sequence = self.setpoint_sequence + 1 & SEQUENCE_MASK
        self.counters["setpoints_sent"] += 1
        self._has_asked = self._is_commanded = True
        config = self.config
        position = config.zero_rev + theta_m_ref_raw / ANGLE_LSB_PER_REV * config.rev_per_pulley_rev
        return make(Frame, (self._request_id, self._head + wire.pack_position(position) + self._tail, True, True))

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take one frame from the bus."""
        is_ours = frame.arbitration_id == self._reply_id and frame.is_extended == self._reply_is_extended
        if not is_ours or not frame.is_fd:
            self.counters["not_for_us"] += 1
            return
        self._answers.answer()
        if self._answers.is_too_high:
            self._refuse(
                f"node {self.config.node} sends more answers than requested: two drives have this id, or another "
                f"program uses the same host id, {wire.HOST_ID}; give each drive its own id (id.id), or end the "
                "other program"
            )
        feedback = wire.parse_feedback(frame.data)
        if feedback is None:
            self.counters["bad_reply"] += 1
            self._see_refused_register(frame.data)
            return
        if not self._is_next(feedback):
            return
        self._feedback, self._heard_ns = feedback, now_ns
        if self.phase is HostPhase.IDENTIFYING:
            self._identify(frame.data, feedback)
            return
        self._see_mode(feedback, now_ns)
        self._sample(feedback, now_ns)

    def poll(self, now_ns: int) -> list[Frame]:
        """Return what is due: a stop, or a query where no reference of this tick has asked already."""
        if self.phase is HostPhase.IDENTIFYING:
            if self._asked_ns is not None and now_ns - self._asked_ns < IDENTIFY_EVERY_NS:
                return []
            self._asked_ns = now_ns
            self._answers.ask()
            return [wire.identify(self.config.node)]
        if self._heard_ns is not None and now_ns - self._heard_ns > self.config.silence_ns:
            self.drive_state = None  # an old word
            self._fire("gone")
        has_asked, self._has_asked = self._has_asked, False
        frame = self._due(now_ns, has_asked)
        if frame is None and not has_asked:
            return []
        self._asked_ns = now_ns
        self._answers.ask()
        if frame is None:
            return []
        if has_asked:  # and a stop behind the reference
            self._answers.ask()
        return [frame]

    def _due(self, now_ns: int, has_asked: bool) -> Frame | None:
        if self._clears:
            self._clears = False
            return wire.stop(self.config.node)
        if self._wants_stop and self.drive_state not in NO_TORQUE:
            self._stop_ns = now_ns if self._stop_ns is None else self._stop_ns
            return wire.stop(self.config.node)
        return None if has_asked or self.phase in _SILENT else wire.query(self.config.node)

    def _is_next(self, feedback: wire.Feedback) -> bool:
        """Whether an answer is newer than the last by the drive's own clock, which begins anew where it was reset."""
        if self._feedback is None:
            return True
        step_ms = (feedback.milliseconds - self._feedback.milliseconds + _HALF32 & _MASK32) - _HALF32
        if step_ms < -MAX_COUNTER_STEP_BACK_MS:
            self.counters["restarts"] += 1
            self.drive_state = None
            self._fire("gone")
        elif step_ms < 0:
            self.counters["stale"] += 1
            return False
        return True

    def _identify(self, data: bytes, feedback: wire.Feedback) -> None:
        identity, node = wire.parse_identity(data), self.config.node
        if identity is None:
            self._see_refused_register(data)
        elif identity.register_map != wire.REGISTER_MAP:
            self._refuse(
                f"node {node} has register map version {identity.register_map} (firmware "
                f"{wire.version_words(identity.firmware)}), but version {wire.REGISTER_MAP} is supported; flash a "
                "firmware "
                "that has it with moteus_tool --flash"
            )
        elif feedback.mode in _LATCHED:
            self._see_mode(feedback, 0)
        elif feedback.mode == Mode.STOPPED:
            self.drive_state, self._is_commanded = DriveState.DISABLED, False
            self._fire("complete")
        elif feedback.mode not in _PREPARING:
            self._refuse(
                f"node {node} is already in mode {feedback.mode}, so that another program controls it; end that "
                "program, or stop the "
                f"motor with moteus_tool -t {node} --stop"
            )

    def _see_refused_register(self, data: bytes) -> None:
        register = wire.refused_register(data)
        if self.phase is HostPhase.IDENTIFYING and register is not None:
            self._refuse(
                f"node {self.config.node} has no register 0x{register:03x}: its firmware is too old; "
                "flash a newer one with moteus_tool --flash"
            )

    def _refuse(self, why: str) -> None:
        if not self.refusal:
            self.refusal = why
        self._fire("refuse")

    def _see_mode(self, feedback: wire.Feedback, now_ns: int) -> None:
        mode = feedback.mode
        if mode in _LATCHED:
            # In the timeout mode it damps the motor, unless it is configured otherwise.
            self.drive_state = DriveState.FAULT if mode == Mode.FAULT else DriveState.ARMED
            self._fire("fault")
            return
        if mode != Mode.POSITION:
            self._fire("left")
        elif self._is_commanded:  # else it is in position mode by somebody else's word
            self._fire("position")
        if self._stop_ns is not None and now_ns - self._stop_ns >= FLIGHT_NS:
            self._is_commanded = False
        if mode == Mode.STOPPED:
            self._fire("cleared")
        # An answer shows the mode before its own request: one that is commanded may move with the next.
        if mode == Mode.STOPPED and not self._is_commanded:
            self.drive_state = DriveState.DISABLED
        else:
            self.drive_state = DriveState.OPERATIONAL if self.phase is HostPhase.RUNNING else DriveState.ARMED

    def _sample(self, feedback: wire.Feedback, now_ns: int) -> None:
        if not (math.isfinite(feedback.position_rev) and math.isfinite(feedback.q_current_A)):
            self.counters["no_value"] += 1
            return
        stamp_ns = now_ns if self._asked_ns is None or self._asked_ns > now_ns else (self._asked_ns + now_ns) // 2
        if stamp_ns <= self._stamp_ns:
            self.counters["not_increasing"] += 1
            return
        config = self.config
        is_taken = self._samples.append(
            stamp_ns=stamp_ns,
            received_ns=now_ns,
            pulley_rev=(feedback.position_rev - config.zero_rev) / config.rev_per_pulley_rev,
            current_A=math.copysign(1.0, config.rev_per_pulley_rev) * feedback.q_current_A,
            state=self.drive_state,
            setpoint_sequence=self.setpoint_sequence,
        )
        if is_taken:
            self._stamp_ns = stamp_ns

    def _fire(self, event: str) -> None:
        self.phase = TRANSITIONS.get((self.phase, event), self.phase)
