"""A VESC over CAN, as the host sees it.

    DISCONNECTED -> IDENTIFYING  from now on it is asked for its values at each tick; its timeout is tried
                                 (`timeout_trial.py`)
    IDENTIFYING  -> READY        its timeout is as it should be, it has no fault, no current flows, the turn is known
    IDENTIFYING  -> REFUSED      one of these isn't so
    READY        -> ENABLING     the first reference is the measured angle; a VESC has torque from the first SET_POS on,
                                 so it is sent again as it was until answers from behind it say that it was taken
    ENABLING     -> RUNNING      they do: no timeout, no fault
    RUNNING      -> READY        somebody disables it
    any          -> FAULT        an answer has a fault, an expired timeout or the kill switch, or references stayed away
                                 for as long as the timeout
    FAULT        -> IDENTIFYING  the fault has gone, and was asked to be reset. A VESC forgets it by itself after 500 ms
                                 and takes the next reference as if nothing had been: so none is sent any more
    any          -> REFUSED      somebody else commands this VESC, two answer with its id, or its turn was lost
    any          -> DISCONNECTED no answer for `SILENCE_NS`, or it says that it has booted

Only commands feed a VESC's timeout; the requests don't, so they go on while it runs.

Only answers without current, from behind the release, tell that it has no torque (`release.py`). A motor that is
commanded 0 A and measures none would say the same.

Nothing is stamped, but an answer tells which request it is to (`requests.py`). Angle and current come in one answer,
whose stamp is when its request went out: the values are younger, by the way there. The current is the mean since the
last answer, to whomever that went.
"""

import math
from typing import Final, NamedTuple

from firmware_protocol.frames import Frame
from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV
from firmware_protocol.states import HostPhase
from hil_forceps.drives import sample_queue
from hil_forceps.drives.port import SEQUENCE_MASK
from hil_forceps.drives.transitions import COMMON, P
from hil_forceps.drives.vesc import messages as wire
from hil_forceps.drives.vesc.answers import Answer, Answers
from hil_forceps.drives.vesc.faults import fault_words
from hil_forceps.drives.vesc.messages import Command
from hil_forceps.drives.vesc.references import References
from hil_forceps.drives.vesc.release import Release
from hil_forceps.drives.vesc.requests import Requests
from hil_forceps.drives.vesc.timeout_trial import Stage, TimeoutTrial
from hil_forceps.drives.vesc.turns import Turns, TurnsConfig

SILENCE_NS: Final = 100_000_000  # without an answer; a boot takes longer
IDENTIFY_NS: Final = 1_000_000_000  # for answers to come, or for the current to end

COUNTERS: Final = (
    "setpoints_sent",
    "requests_sent",
    "unanswered",  # requests whose answer was overtaken by that to another
    "unasked",  # answers that no request waits for
    "torn_answers",
    "bad_answers",
    "jumps",  # angles further away than the motor can have come
    "broadcasts",  # STATUS frames: its current has no direction there, and steps of 0.1 A
    "not_for_us",
    *sample_queue.COUNTERS,
)

# Besides what every drive has.
TRANSITIONS: Final = COMMON | {
    (P.READY, "refuse"): P.REFUSED,
    (P.ENABLING, "taken"): P.RUNNING,
    (P.ENABLING, "refuse"): P.REFUSED,
    (P.RUNNING, "refuse"): P.REFUSED,
    (P.FAULT, "cleared"): P.IDENTIFYING,
    (P.FAULT, "refuse"): P.REFUSED,
}
_LIVE: Final = frozenset({P.IDENTIFYING, P.READY, P.ENABLING, P.RUNNING, P.FAULT})
_MAY_HAVE_TORQUE: Final = frozenset({P.ENABLING, P.RUNNING})


class VescConfig(NamedTuple):
    """One VESC and how it sits on the motor pulley."""

    node: int
    rev_per_pulley_rev: float  # of the angle that the VESC tells, with the sign of the direction
    zero_rev: float  # what the VESC calls the angle 0 of the motor pulley
    timeout_ns: int  # of the VESC
    turns: TurnsConfig
    host_id: int = wire.HOST_ID  # to which it answers


class Vesc:
    """One motor of a VESC; a `DriveMachine`."""

    def __init__(self, config: VescConfig) -> None:
        """ValueError for a node, a ratio or a time that can't be."""
        is_node = 0 <= config.node <= wire.MAX_NODE and config.node != config.host_id
        if not is_node or config.rev_per_pulley_rev == 0.0 or config.timeout_ns <= 0:
            raise ValueError(f"no VESC: {config}")
        self.config = config
        self.phase = HostPhase.DISCONNECTED
        self.refusal = ""
        self.drive_state: DriveState | None = None
        self.setpoint_sequence = 0
        self.counters = dict.fromkeys(COUNTERS, 0)
        self._fill_id = wire.frame_id(config.host_id, Command.FILL_RX_BUFFER)
        self._end_id = wire.frame_id(config.host_id, Command.PROCESS_RX_BUFFER)
        self._answers = Answers(self.counters)
        self._requests = Requests(self.counters)
        self._turns = Turns(config.turns)
        self._trial = TimeoutTrial(config.timeout_ns)
        self._samples = sample_queue.SampleQueue(self.counters)
        self._fault = ""
        self._since_ns = 0  # of the phase
        self._answer_ns: int | None = None  # of the last answer
        self._heard_broadcast = False
        self._stamp_ns = -1
        self._release = Release()
        self._references = References(config.timeout_ns)
        self._resets = False

    def connect(self, now_ns: int) -> None:
        """Begin to ask; ValueError while connected."""
        if self.phase not in {HostPhase.DISCONNECTED, HostPhase.REFUSED}:
            raise ValueError(f"a VESC that is {self.phase.name} is connected already")
        self.refusal, self._fault, self._heard_broadcast = "", "", False
        self._answer_ns = None
        self._identify_from(now_ns)
        self._fire("connect")

    def enable(self) -> None:
        """Ask for position control; ValueError unless READY."""
        if self.phase is not HostPhase.READY:
            raise ValueError(f"a VESC that is {self.phase.name} can't be enabled")
        self._references.forget()
        self._release.withdraw()
        self._fire("enable")

    def disable(self) -> None:
        """Order the release, until answers from behind the order have no current."""
        if self._references.held_raw is not None or self.phase in _MAY_HAVE_TORQUE:
            self.drive_state = None  # what the last answer said doesn't count any more
        self._release.want()
        self._fire("disable")

    def reset_fault(self) -> None:
        """Forget the fault once the VESC has, which it does by itself; ValueError unless in FAULT."""
        if self.phase is not HostPhase.FAULT:
            raise ValueError("there is no fault to clear")
        self._resets = True

    def estop_frame(self) -> Frame:
        """Return the order to release the motor."""
        return wire.release(self.config.node)

    def fault_words(self) -> str:
        """Return what the fault was."""
        return self._fault or "no fault reported"

    def take_samples(self) -> list[RawSample]:
        """Hand over the samples since the last call, oldest first."""
        return self._samples.take()

    def take_bench(self) -> list[RawBench]:
        """Return nothing: a VESC has no bench sensors."""
        return []

    def setpoint(self, theta_m_ref_raw: int) -> Frame | None:
        """Return SET_POS; while enabling, with the first reference."""
        if self.phase is HostPhase.ENABLING:
            held_raw = self._references.held_raw
            if held_raw is None and not self._release.is_quiet:
                return None
            theta_m_ref_raw = theta_m_ref_raw if held_raw is None else held_raw
        elif self.phase is not HostPhase.RUNNING:
            return None
        config, angle_rev = self.config, self._turns.angle_rev
        position_rev = config.zero_rev + theta_m_ref_raw / ANGLE_LSB_PER_REV * config.rev_per_pulley_rev
        if angle_rev is None or abs(position_rev - angle_rev) >= 0.5:
            self._refuse(
                f"the reference is half a turn away from the motor of node {config.node}, and a VESC takes the shorter "
                "way; check whether the motor is blocked, and sign and size of encoder_rev_per_pulley_rev"
            )
            return None
        self._references.send(theta_m_ref_raw)
        self.setpoint_sequence = self.setpoint_sequence + 1 & SEQUENCE_MASK
        self.counters["setpoints_sent"] += 1
        return wire.set_position(config.node, position_rev)

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take one frame from the bus."""
        arbitration_id, data, is_fd, is_extended = frame
        if is_extended and not is_fd and arbitration_id == self._fill_id:  # most frames are
            self._answers.fill(data, now_ns)
            return
        if is_extended and not is_fd and arbitration_id == self._end_id:
            answer = self._answers.process(data)
            if answer is not None:
                self._see_answer(answer)
            return
        found = wire.node_and_command(frame)
        if found is None or found[0] not in {self.config.node, wire.EVERYBODY}:
            self.counters["not_for_us"] += 1
        elif found[1] in wire.BROADCAST:
            self.counters["broadcasts"] += 1
            self._heard_broadcast = True
        elif found[1] in wire.MOVING:  # what this host sends doesn't come back to it
            name = Command(found[1]).name
            self._refuse(f"another program commands node {self.config.node}, with {name}; stop it first")
        elif found[1] == Command.NOTIFY_BOOT:
            self._see_boot(now_ns)
        else:
            self.counters["not_for_us"] += 1

    def poll(self, now_ns: int) -> list[Frame]:
        """Return what is due: the release of the motor, and the request."""
        self._references.tick(now_ns)
        self._look_at_time(now_ns)
        frames: list[Frame] = []
        if self._orders_release(now_ns):
            frames.append(wire.release(self.config.node))
        if self.phase in _LIVE or self._release.is_wanted:
            frames.append(wire.request(self.config.node, self._requests.ask(now_ns), self.config.host_id))
        return frames

    def _look_at_time(self, now_ns: int) -> None:
        if self.phase is HostPhase.IDENTIFYING:
            self._identify(now_ns)
        elif self._answer_ns is not None and now_ns - self._answer_ns > SILENCE_NS:
            self.drive_state = None  # an old word
            self._fire("gone")
        elif self.phase is HostPhase.RUNNING and self._references.have_starved(now_ns):
            self._fail(f"no reference for longer than its timeout of {self.config.timeout_ns / 1e6:g} ms")
        elif self.phase is HostPhase.ENABLING and self._references.have_starved(now_ns):
            self._references.forget()  # the motor was released: once more, from where it is now

    def _orders_release(self, now_ns: int) -> bool:
        if self.phase is HostPhase.IDENTIFYING and self._trial.is_due(now_ns):
            return True
        # While enabling: somebody else's current, from before the first reference, or one that nobody feeds any more.
        disturbs = self.phase is HostPhase.ENABLING and self._references.held_raw is None
        return (disturbs or self._release.is_wanted) and self._release.is_due(now_ns)

    def _identify_from(self, now_ns: int) -> None:
        self._since_ns = now_ns
        self._release.forget()
        self._turns.angle_rev = None
        self._trial = TimeoutTrial(self.config.timeout_ns)

    def _identify(self, now_ns: int) -> None:
        node, is_over = self.config.node, now_ns - self._since_ns > IDENTIFY_NS
        if self._answer_ns is None:
            if is_over and self.counters["bad_answers"]:
                self._refuse(f"node {node} answers with other values than requested; use firmware 5.03 to 7.01")
            elif is_over and self._heard_broadcast:
                self._refuse(
                    f"node {node} broadcasts its status, but does not answer; this needs firmware 5.03 or later, and "
                    "App Settings, General, CAN Mode: VESC"
                )
        elif self._trial.is_late(now_ns) and self._trial.stage is Stage.FEEDING:
            self._refuse(
                f"node {node} answers, but accepts no command: its timeout is expired after a command as before"
            )
        elif self._trial.is_late(now_ns):
            timeout_ms = self.config.timeout_ns / 1e6
            self._refuse(
                f"the timeout of node {node} did not expire in time: set App Settings, General, Timeout to "
                f"{timeout_ms:g} ms with VESC Tool (0 is off), as in motor_driver.watchdog_s, or find what else "
                "commands it: another program, or an app of its own (App to Use: No App)"
            )
        elif self._trial.stage is Stage.PASSED and self._release.is_quiet:
            self._fire("complete")
        elif is_over and self._trial.stage is Stage.PASSED:
            self._refuse(
                f"the motor of node {node} has current without a request: set App Settings, General, Timeout Brake "
                "Current to 0 with VESC Tool, or find what moves the motor"
            )

    def _see_answer(self, answer: Answer) -> None:
        if answer.node != self.config.node:
            self.counters["not_for_us"] += 1
            return
        self._requests.end()
        if self._requests.are_answered_too_often:
            self._refuse(
                f"node {self.config.node} sends more answers than requested: two VESCs have this id; give each its "
                "own (App Settings, General, VESC ID)"
            )
        if not answer.payload:
            return
        values = wire.parse_values(answer.payload)
        if values is None:
            self.counters["bad_answers"] += 1
            if wire.lacks_status(answer.payload):
                self._refuse(
                    f"node {self.config.node} does not report its timeout; update its firmware to 5.03 or later"
                )
            return
        asked_ns = self._requests.answer(values.tag)
        if asked_ns is None:
            return
        self._answer_ns = answer.arrived_ns
        self._release.see(values.current_A, asked_ns)
        self._see_state(values, asked_ns)
        self._see_angle(values, asked_ns, answer.arrived_ns)

    def _see_state(self, values: wire.Values, asked_ns: int) -> None:
        is_quiet = self._release.is_quiet
        trouble = _trouble(values, is_driven=self.phase is HostPhase.RUNNING)
        if trouble:
            self._fail(trouble)
        elif self.phase is HostPhase.FAULT and self._resets and is_quiet:
            self._resets = False
            self._identify_from(asked_ns)
            self._fire("cleared")
        elif self.phase is HostPhase.IDENTIFYING:
            self._trial.see(values.has_timeout, asked_ns)
        elif self.phase is HostPhase.ENABLING and self._references.see(values.has_timeout, asked_ns):
            self._fire("taken")
        if self.phase is HostPhase.RUNNING:
            self.drive_state = DriveState.OPERATIONAL
        elif self.phase is HostPhase.ENABLING and self._references.held_raw is not None:
            self.drive_state = DriveState.ARMED
        elif is_quiet:
            self.drive_state = DriveState.FAULT if self.phase is HostPhase.FAULT else DriveState.DISABLED
        elif values.current_A != 0.0:
            self.drive_state = DriveState.ARMED  # torque, by whose word ever

    def _see_angle(self, values: wire.Values, asked_ns: int, received_ns: int) -> None:
        if self._turns.angle_rev is None or (self._turns.is_lost(asked_ns) and self.phase not in _MAY_HAVE_TORQUE):
            starts = self._turns.starts(values.position_rev)
            if len(starts) > 1:
                self._refuse(
                    f"the angle of node {self.config.node} wraps at each turn, and `limits:` allow more than one turn "
                    "for this angle; make them narrower than a turn of the VESC's angle"
                )
                return
            self._turns.start(starts[0], asked_ns)
        elif self._turns.is_lost(asked_ns):
            self.drive_state = None
            self._fire("gone")  # it may have turned half a turn unseen
            return
        elif self._turns.follow(values.position_rev, asked_ns) is None:
            self.counters["jumps"] += 1
            return
        self._sample(values, asked_ns, received_ns)

    def _sample(self, values: wire.Values, asked_ns: int, received_ns: int) -> None:
        config, angle_rev = self.config, self._turns.angle_rev
        if angle_rev is None or asked_ns <= self._stamp_ns:
            return
        is_taken = self._samples.append(
            stamp_ns=asked_ns,
            received_ns=received_ns,
            pulley_rev=(angle_rev - config.zero_rev) / config.rev_per_pulley_rev,
            current_A=math.copysign(1.0, config.rev_per_pulley_rev) * values.current_A,
            state=self.drive_state,
            setpoint_sequence=self.setpoint_sequence,
        )
        if is_taken:
            self._stamp_ns = asked_ns

    def _see_boot(self, now_ns: int) -> None:
        if self.phase is HostPhase.IDENTIFYING:
            self._identify_from(now_ns)
        self.drive_state = None
        self._fire("gone")

    def _fail(self, words: str) -> None:
        if self.phase in _LIVE and self.phase is not HostPhase.FAULT:
            self._fault, self._resets, self.drive_state = words, False, None
        self._fire("fault")

    def _refuse(self, words: str) -> None:
        if self.phase in _LIVE:
            self.refusal = words
        self._fire("refuse")

    def _fire(self, event: str) -> None:
        self.phase = TRANSITIONS.get((self.phase, event), self.phase)


def _trouble(values: wire.Values, *, is_driven: bool) -> str:
    """Return what an answer has against driving on, in words; empty where nothing."""
    if values.fault:
        return fault_words(values.fault)
    if values.is_killed:
        return "its kill switch is on"
    if is_driven and values.has_timeout:
        return "its timeout expired: no reference came in time, and the motor has no torque"
    return ""
