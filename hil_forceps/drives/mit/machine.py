"""A mini cheetah drive as the host sees it.

    DISCONNECTED -> IDENTIFYING  "exit" is sent each tick: whatever state a drive is in, it answers, and has no torque
    IDENTIFYING  -> READY        answers to "exit" come, with an angle inside the range
    IDENTIFYING  -> REFUSED      they come twice, under another id, with another length, or at the range's end
    READY        -> ENABLING     a command without gains at the measured angle, then "enter", until that is answered;
                                 then commands with gains at the angle measured then
    ENABLING     -> RUNNING      the commands with gains are answered
    RUNNING      -> READY        a DaMiao says disabled; others say nothing of it
    any          -> FAULT        an answer has an error; a bgkatz tells none
    FAULT        -> IDENTIFYING  an answer has none any more
    any          -> DISCONNECTED frames stay unanswered for longer than a restart takes

A drive speaks only when spoken to: one answer to a frame. So each tick asks. While it runs, that is the reference that
the gate let pass. Where a tick has none, because the answer was lost, the last reference is repeated until it is as old
as a sample may be; the drive holds it anyway. Where the answer came and no reference followed, or the time is over, a
command that only damps is sent: nothing pulls on behalf of an estimator that has nothing to say.

Only a DaMiao says whether it is enabled. Of the others is known what was asked and answered: an answer that came
`FLIGHT_NS` after the first of nothing but "exit" is an answer to "exit", and that leaves motor mode unconditionally
(bgkatz/motorcontrol, `fsm.c`, `update_fsm`).

A sample's stamp is the middle between the tick that asked and the arrival: the drive answers at once, with what it
measured last, and both ways take about the same time.
"""

import math
from typing import Final, NamedTuple

from firmware_protocol.frames import Frame
from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV
from firmware_protocol.states import HostPhase
from hil_forceps.drives import sample_queue
from hil_forceps.drives.mit import messages as wire
from hil_forceps.drives.mit.exchange import FLIGHT_NS, Exchange
from hil_forceps.drives.mit.messages import MAX_CODE, MAX_POSITION_CODE, Codes, Special
from hil_forceps.drives.port import NO_TORQUE, SEQUENCE_MASK
from hil_forceps.drives.transitions import COMMON, P

IDENTIFY_NS: Final = 500_000_000  # for an answer that fits
RESTART_NS: Final = 8_000_000  # bgkatz's firmware waits 1 ms eight times before it opens CAN (`main.c`)
MIN_UNANSWERED_TICKS: Final = 3  # however slow the loop
SILENCE_NS: Final = 100_000_000  # without torque a longer gap does no harm
FIRST_REFERENCES: Final = 3  # with gains, before it counts as following: two may be lost
MAX_UNASKED_ANSWERS: Final = 3  # answers to nobody's question while identifying
_DAMIAO_EXTRA: Final = 2  # bytes, temperatures
_ENABLED: Final = frozenset({HostPhase.ENABLING, HostPhase.RUNNING})

COUNTERS: Final = (
    "setpoints_sent",
    "repeats",  # of a reference whose answer did not come
    "releases",  # commands that only damp, while enabled
    "beyond_range",  # references that the position field can't hold
    "not_for_us",
    "bad_length",
    "unasked",  # answers beyond the number of frames sent: another drive with the id, or another host
    "at_range_end",  # angles at the end of the field, where it saturates
    "wrapped",  # angles more than half the field away from the one before
    "not_increasing",
    *sample_queue.COUNTERS,
)

# Besides what every drive has.
TRANSITIONS: Final = COMMON | {
    (P.ENABLING, "follows"): P.RUNNING,
    (P.RUNNING, "left"): P.READY,
    (P.FAULT, "cleared"): P.IDENTIFYING,
}


class MitConfig(NamedTuple):
    """One drive and how it sits on the motor pulley."""

    node: int
    reply_id: int
    variant: wire.Variant
    ranges: wire.Ranges
    current_range_A: float  # of the answer's torque or current, as current of the rig's motor; signed like the ratio
    kp_N_m_per_rad: float  # of the drive's own shaft, as the ranges
    kd_N_m_s_per_rad: float
    rev_per_pulley_rev: float  # of the drive's own shaft, with the sign of the direction
    zero_rev: float  # what the drive calls the angle 0 of the motor pulley
    period_ns: int  # of the host's loop
    max_sample_age_ns: int  # beyond which a reference isn't repeated


class Mit:
    """One mini cheetah drive; a `DriveMachine`."""

    def __init__(self, config: MitConfig) -> None:
        """ValueError for an id, a ratio, a range or a gain that can't be."""
        ids_are_right = 1 <= config.node <= wire.MAX_NODE and 0 <= config.reply_id <= wire.MAX_ID
        if not ids_are_right or config.rev_per_pulley_rev == 0.0 or not all(each > 0.0 for each in config.ranges):
            raise ValueError(f"no mini cheetah drive: {config}")
        ranges = config.ranges
        self._kp = wire.code_of(config.kp_N_m_per_rad, 0.0, ranges.kp_N_m_per_rad, MAX_CODE)
        self._kd = wire.code_of(config.kd_N_m_s_per_rad, 0.0, ranges.kd_N_m_s_per_rad, MAX_CODE)
        self.config = config
        self.phase = HostPhase.DISCONNECTED
        self.refusal = ""
        self.drive_state: DriveState | None = None
        self.setpoint_sequence = 0
        self.counters = dict.fromkeys(COUNTERS, 0)
        self._exchange = Exchange()
        self._samples = sample_queue.SampleQueue(self.counters)
        self._fault = 0
        self._position_rad: float | None = None  # last measured, of the drive's shaft
        self._stamp_ns = -1
        self._since_ns = 0  # of identifying
        self._unfit = ""  # what came instead of an answer, in words
        self._enter_ns: int | None = None  # since when "enter" is sent
        self._has_entered = False
        self._references = 0  # sent while enabling
        self._held_raw: int | None = None  # the reference while enabling
        self._handed = 0  # references since the last poll
        self._reference: Frame | None = None  # the last, until it is answered
        self._reference_ns = 0
        self._wants_off = False
        self._clears = False

    def connect(self, now_ns: int) -> None:
        """Begin to ask."""
        self._fire("connect")
        if self.phase is HostPhase.IDENTIFYING:
            self._since_ns = now_ns
            self._exchange = Exchange()
            self._position_rad, self.refusal, self._unfit = None, "", ""

    def enable(self) -> None:
        """Ask for motor mode; ValueError unless READY."""
        if self.phase is not HostPhase.READY:
            raise ValueError(f"a drive that is {self.phase.name} can't be enabled")
        self._begin_to_enter()
        self._reference, self._wants_off = None, False
        self._fire("enable")

    def disable(self) -> None:
        """Send "exit" until an answer can be to nothing else, and a DaMiao does not say enabled."""
        if self.phase in _ENABLED:
            self.drive_state = DriveState.ARMED
        self._reference, self._wants_off = None, True
        self._fire("disable")

    def reset_fault(self) -> None:
        """Clear a DaMiao's errors once; others are only asked again. ValueError unless in FAULT."""
        if self.phase is not HostPhase.FAULT:
            raise ValueError("there is no fault to clear")
        self._clears = self.config.variant == "damiao"

    def estop_frame(self) -> Frame:
        """Return "exit"."""
        return wire.special(self.config.node, Special.EXIT)

    def fault_words(self) -> str:
        """Return the error of the last answer in words."""
        return wire.fault_words(self.config.variant, self._fault)

    def take_samples(self) -> list[RawSample]:
        """Hand over the samples since the last call, oldest first."""
        return self._samples.take()

    def take_bench(self) -> list[RawBench]:
        """Return nothing: such a drive has no bench sensors."""
        return []

    def setpoint(self, theta_m_ref_raw: int) -> Frame | None:
        """Return a command with gains; while enabling, at the angle at which those began."""
        if self.phase is HostPhase.ENABLING and self._has_entered:
            if self._held_raw is None:
                self._held_raw = theta_m_ref_raw
            theta_m_ref_raw = self._held_raw
        elif self.phase is not HostPhase.RUNNING:
            return None
        config = self.config
        turns = config.zero_rev + theta_m_ref_raw / ANGLE_LSB_PER_REV * config.rev_per_pulley_rev
        position_rad = 2.0 * math.pi * turns
        if abs(position_rad) > config.ranges.position_rad:
            self.counters["beyond_range"] += 1
            return None
        self.setpoint_sequence = self.setpoint_sequence + 1 & SEQUENCE_MASK
        self.counters["setpoints_sent"] += 1
        self._references += 1
        self._handed += 1
        self._reference = self._command(position_rad, self._kp, self._kd)
        return self._reference

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take one frame from the bus."""
        config, reply = self.config, wire.parse_reply(frame.data)
        is_ours = reply is not None and wire.is_from(config.variant, config.node, reply)
        if frame.arbitration_id != config.reply_id or frame.is_fd or frame.is_extended:
            self.counters["not_for_us"] += 1
            if is_ours and frame.arbitration_id != config.node:
                elsewhere = f"{frame.arbitration_id:03X}h, not {config.reply_id:03X}h"
                self._unfit = f"answers have the id {elsewhere}; set motor_driver.reply_id"
        elif reply is None or (is_ours and config.variant == "damiao" and len(reply.extra) != _DAMIAO_EXTRA):
            self.counters["bad_length"] += 1
            self._unfit = f"answers have {len(frame.data)} bytes; check motor_driver.mit_variant and reply_id"
        elif not is_ours:
            self.counters["not_for_us"] += 1
        elif not self._exchange.take_answer():
            self.counters["unasked"] += 1
        else:
            self._reference = None
            self._see_state(reply, now_ns)
            self._see_values(reply, now_ns)

    def poll(self, now_ns: int) -> list[Frame]:
        """Return what is due; a tick in which `setpoint` asked needs no more."""
        frames, off = self._due(now_ns), self.estop_frame()
        only_exit = not self._handed and all(frame == off for frame in frames)
        self._exchange.ask(len(frames) + self._handed, only_exit, now_ns)
        self._handed = 0
        if not only_exit and self.drive_state in NO_TORQUE:
            self.drive_state = DriveState.ARMED
        return frames

    def _due(self, now_ns: int) -> list[Frame]:
        if self.phase is HostPhase.IDENTIFYING:
            self._identify(now_ns)
        elif self._is_silent(now_ns):
            self.drive_state = None  # an old word
            self._fire("gone")
        off = [self.estop_frame()]
        if self.phase in {HostPhase.DISCONNECTED, HostPhase.REFUSED}:
            return off if self._wants_off and self.drive_state not in NO_TORQUE else []
        if self.phase is HostPhase.FAULT and self._clears:
            self._clears = False
            return [wire.special(self.config.node, Special.CLEAR_ERRORS)]
        return self._ask(now_ns) if self.phase in _ENABLED else off

    def _ask(self, now_ns: int) -> list[Frame]:
        """Return what keeps an enabled drive talking where no reference does."""
        assert self._position_rad is not None
        if self.phase is HostPhase.ENABLING and not self._has_entered:
            self._enter_ns = now_ns if self._enter_ns is None else self._enter_ns
            return [self._command(self._position_rad, 0, 0), wire.special(self.config.node, Special.ENTER)]
        if self._handed:
            self._reference_ns = now_ns
            return []
        if self._reference is not None and now_ns - self._reference_ns <= self.config.max_sample_age_ns:
            self.counters["repeats"] += 1
            return [self._reference]
        self.counters["releases"] += 1
        return [self._command(self._position_rad, 0, self._kd)]

    def _is_silent(self, now_ns: int) -> bool:
        longest_ns = SILENCE_NS
        if self.phase in _ENABLED:
            longest_ns = max(RESTART_NS, MIN_UNANSWERED_TICKS * self.config.period_ns)
        return self._exchange.silent_ns(now_ns) > longest_ns

    def _identify(self, now_ns: int) -> None:
        node = self.config.node
        if self._exchange.unasked >= MAX_UNASKED_ANSWERS:
            self._refuse(
                f"node {node} sends more answers than requested: two drives have this id, or another program "
                "commands it"
            )
        elif self.drive_state is DriveState.DISABLED and self._position_rad is not None:
            self._fire("complete")
        elif now_ns - self._since_ns > IDENTIFY_NS and self._unfit:
            self._refuse(f"node {node}: {self._unfit}")

    def _refuse(self, words: str) -> None:
        self.refusal = words
        self._fire("refuse")

    def _see_state(self, reply: wire.Reply, now_ns: int) -> None:
        says = wire.status_of(self.config.variant, reply)
        is_off = self._exchange.is_to_exit(now_ns) and says != wire.ENABLED
        self._fault = wire.fault_of(self.config.variant, reply)
        if self._fault:
            self.drive_state = DriveState.FAULT if is_off else DriveState.ARMED
            self._fire("fault")
            return
        if is_off:
            self.drive_state = DriveState.DISABLED
        elif self.drive_state is None or self.drive_state is DriveState.FAULT:
            self.drive_state = DriveState.ARMED
        if self.phase is HostPhase.FAULT:
            self._since_ns = now_ns
            self._fire("cleared")
        elif self.phase is HostPhase.ENABLING:
            self._see_enabling(says, now_ns)
        elif self.phase is HostPhase.RUNNING and says == wire.DISABLED:
            self.drive_state = DriveState.DISABLED
            self._fire("left")

    def _see_enabling(self, says: int | None, now_ns: int) -> None:
        if not self._has_entered:
            is_answered = self._enter_ns is not None and now_ns - self._enter_ns >= FLIGHT_NS
            self._has_entered = is_answered and says != wire.DISABLED
            self._references = 0
        elif says == wire.DISABLED:
            self._begin_to_enter()
        elif self._references >= FIRST_REFERENCES:
            self.drive_state = DriveState.OPERATIONAL
            self._fire("follows")

    def _begin_to_enter(self) -> None:
        self._enter_ns, self._has_entered, self._references, self._held_raw = None, False, 0, None

    def _see_values(self, reply: wire.Reply, now_ns: int) -> None:
        config, reach_rad = self.config, self.config.ranges.position_rad
        if reply.position in {0, MAX_POSITION_CODE}:
            self.counters["at_range_end"] += 1
            self._unfit = (
                "its angle is at the end of motor_driver.position_range_rad; turn the motor back, or set its zero"
            )
            return
        position_rad = wire.measured(reply.position, reach_rad, MAX_POSITION_CODE)
        if self._position_rad is not None and abs(position_rad - self._position_rad) > reach_rad:
            self.counters["wrapped"] += 1
            return
        self._position_rad = position_rad
        if self.phase is HostPhase.IDENTIFYING:
            return
        stamp_ns = self._exchange.stamp_ns(now_ns)
        if stamp_ns <= self._stamp_ns:
            self.counters["not_increasing"] += 1
            return
        is_taken = self._samples.append(
            stamp_ns=stamp_ns,
            received_ns=now_ns,
            pulley_rev=(position_rad / (2.0 * math.pi) - config.zero_rev) / config.rev_per_pulley_rev,
            current_A=wire.measured(reply.torque, config.current_range_A, MAX_CODE),
            state=self.drive_state,
            setpoint_sequence=self.setpoint_sequence,
        )
        if is_taken:
            self._stamp_ns = stamp_ns

    def _command(self, position_rad: float, kp: int, kd: int) -> Frame:
        reach_rad = self.config.ranges.position_rad
        position = wire.code_of(position_rad, -reach_rad, reach_rad, MAX_POSITION_CODE)
        return wire.command(self.config.node, Codes(position, wire.ZERO_SPEED_CODE, kp, kd, wire.ZERO_TORQUE_CODE))

    def _fire(self, event: str) -> None:
        self.phase = TRANSITIONS.get((self.phase, event), self.phase)
