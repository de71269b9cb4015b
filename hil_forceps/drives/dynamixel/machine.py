"""A Dynamixel servo of the X series, protocol 2.0, in current-based position mode, as the host sees it.

    DISCONNECTED -> IDENTIFYING  pings, until the servo answers; torque off; `SetUp`, one request at a time
    IDENTIFYING  -> READY        the feedback that was set up comes
    IDENTIFYING  -> REFUSED      another model, an answer that doesn't come or comes too late, a refusal by the servo
    READY        -> ENABLING     goal current 0; the measured angle goes out as the reference; torque on; the same
                                 reference again, now under torque; goal current as the limit. Whatever the servo makes
                                 of a goal that it gets without torque, nothing moves: there is no current before the
                                 goal is the measured angle.
    ENABLING     -> RUNNING      the servo has taken the limit
    RUNNING      -> READY        it says that it has no torque
    any          -> FAULT        it says a hardware error, or that its bus watchdog tripped or isn't what was set
    FAULT        -> IDENTIFYING  it was told to reboot
    any          -> DISCONNECTED nothing for `SILENCE_NS`, or it was restarted and has lost what was set up

A servo says nothing by itself, and any packet feeds its bus watchdog. So under torque it is asked in ticks with a
reference, right behind that. Where an answer is lost or a reference denied, there is nothing fresh and would be nothing
to ask with; then it is asked again without a reference, for half the watchdog's time since the last one and not a tick
longer. A host that has no references falls silent then. So a servo stops at the latest one and a half of the watchdog's
time behind the last reference, and a host that still gets answers knows that the watchdog has not tripped.

It stops, it does not let go: a tripped watchdog leaves torque on, the maker says (Bus Watchdog (98)). `disable` takes
it off.

Nothing is stamped (Realtime Tick (120) counts ms). A sample's stamp is the first instant at which the servo can have
had the whole question, by the line's rate; angle and current are of one answer.
"""

import math
from typing import Final, NamedTuple

from firmware_protocol.frames import Frame
from firmware_protocol.host.samples import RawBench, RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV
from firmware_protocol.states import HostPhase
from hil_forceps.drives import sample_queue
from hil_forceps.drives.dynamixel import control_table as table
from hil_forceps.drives.dynamixel import exchange
from hil_forceps.drives.dynamixel import packets as wire
from hil_forceps.drives.dynamixel.enabling import Enabling, Step
from hil_forceps.drives.dynamixel.exchange import Answer, HalfDuplex, Purpose, Request
from hil_forceps.drives.dynamixel.set_up import SetUp
from hil_forceps.drives.port import NO_TORQUE, SEQUENCE_MASK
from hil_forceps.drives.transitions import COMMON, P

SILENCE_NS: Final = 350_000_000
ANSWER_NS: Final = 50_000_000  # for a request of the set-up: three times what an FTDI adapter holds back by default
MAX_TRIES: Final = 4
FEEDBACK_NS: Final = 5_000_000  # for feedback; an adapter that takes longer is refused
MIN_FEEDBACK_PERIODS: Final = 3  # an answer is seen at the next
REBOOT_NS: Final = 500_000_000  # before it is asked again
MAX_RESTARTS: Final = 3  # of the set-up, where its feedback doesn't come
UNWATCHED_NS: Final = 50_000_000  # for asking again, where the watchdog is off

GOAL_BYTES: Final = wire.OVERHEAD_BYTES + 10  # SYNC WRITE of a goal position
READ_BYTES: Final = wire.OVERHEAD_BYTES + 5
FEEDBACK_BYTES: Final = wire.OVERHEAD_BYTES + 2 + table.INDIRECT_DATA.size

_NS_PER_S: Final = 1_000_000_000

COUNTERS: Final = (
    "setpoints_sent",
    "asked_again",  # without a reference, under torque
    "restarts",
    "alerts",
    "not_increasing",
    *exchange.COUNTERS,
    *sample_queue.COUNTERS,
)

# Besides what every drive has.
TRANSITIONS: Final = COMMON | {
    (P.ENABLING, "limit taken"): P.RUNNING,
    (P.ENABLING, "refuse"): P.REFUSED,
    (P.RUNNING, "left"): P.READY,
    (P.FAULT, "reboot"): P.IDENTIFYING,
}


class DynamixelConfig(NamedTuple):
    """One servo and how its horn sits on the motor pulley."""

    node: int
    counts_per_pulley_rev: float  # with the sign of the direction
    zero_counts: float  # what Present Position (132) is at the angle 0 of the motor pulley
    current_limit_A: float
    watchdog: int  # as Bus Watchdog (98) takes it, in 20 ms; 0: off
    period_ns: int  # of the host's loop
    baudrate_bit_per_s: int


class Dynamixel:
    """One servo; a `DriveMachine`."""

    def __init__(self, config: DynamixelConfig) -> None:
        """ValueError for a servo that can't be."""
        is_servo = 0 <= config.node <= wire.MAX_ID and config.counts_per_pulley_rev != 0.0
        if not is_servo or not 0 <= config.watchdog <= table.MAX_WATCHDOG_UNITS:
            raise ValueError(f"no servo: {config}")
        self.config = config
        self.phase = HostPhase.DISCONNECTED
        self.refusal = ""
        self.drive_state: DriveState | None = None
        self.setpoint_sequence = 0
        self.counters = dict.fromkeys(COUNTERS, 0)
        self._line = HalfDuplex(config.node, self.counters)
        self._samples = sample_queue.SampleQueue(self.counters)
        self._set_up = self._new_set_up()
        self._set_up_restarts = 0
        self._tries = 0
        self._waits_until_ns = 0  # for a servo that reboots
        self._round_trips_ns: list[int] = []  # of the set-up
        self._heard_ns = 0
        self._feedback: table.Feedback | None = None
        self._stamp_ns = -1
        self._enabling = Enabling(0)
        self._ordered = (table.TORQUE_ENABLE, 0)
        self._references_before = 0  # sent when the last tick was over
        self._reference_ns = 0  # tick of the last one
        self._wants_off = False
        self._off_taken = False  # the servo has taken the order; what it says of its torque is still to be read
        self._wants_reboot = False
        watchdog_ns = round(config.watchdog * table.WATCHDOG_UNIT_S * _NS_PER_S)
        self._unreferenced_ns = watchdog_ns // 2 or UNWATCHED_NS
        self._feedback_timeout_ns = max(FEEDBACK_NS, MIN_FEEDBACK_PERIODS * config.period_ns)
        self._feedback_request = Request(
            "feedback",
            wire.read(config.node, table.INDIRECT_DATA.address, table.INDIRECT_DATA.size),
            table.INDIRECT_DATA.size,
            self._feedback_timeout_ns,
            self._line_ns(FEEDBACK_BYTES),
        )

    def connect(self, now_ns: int) -> None:
        """Look for the servo and set it up, from the beginning."""
        self._fire("connect")
        if self.phase is HostPhase.IDENTIFYING:
            self.refusal, self._set_up_restarts, self._wants_off = "", 0, False
            self._begin_set_up(now_ns)

    def enable(self) -> None:
        """Ask for torque; ValueError unless READY."""
        if self.phase is not HostPhase.READY:
            raise ValueError(f"a servo that is {self.phase.name} can't be enabled")
        assert self._set_up.model is not None
        self._enabling = Enabling(round(self.config.current_limit_A / self._set_up.model.current_unit_A))
        self._wants_off = False
        self._fire("enable")

    def disable(self) -> None:
        """Ask for no torque, until the servo is read to have none."""
        if self.phase in {HostPhase.ENABLING, HostPhase.RUNNING}:
            self.drive_state = None  # torque may have been asked for and not be in an answer yet
        self._wants_off, self._off_taken = True, False
        self._fire("disable")

    def reset_fault(self) -> None:
        """Reboot the servo and set it up anew; ValueError unless in FAULT."""
        if self.phase is not HostPhase.FAULT:
            raise ValueError("there is no fault to reset")
        self._wants_reboot = True

    def estop_frame(self) -> Frame:
        """Return the order for no torque that isn't answered."""
        return wire.write_unanswered(self.config.node, table.TORQUE_ENABLE.address, b"\x00")

    def fault_words(self) -> str:
        """Return what the servo says is wrong."""
        feedback = self._feedback
        if feedback is None:
            return "no error was read"
        if feedback.hardware_error:
            return table.hardware_error_words(feedback.hardware_error)
        if feedback.bus_watchdog == table.WATCHDOG_TRIPPED:
            return f"bus watchdog tripped: no packet for {self.config.watchdog * table.WATCHDOG_UNIT_S:g} s"
        return f"{table.BUS_WATCHDOG} is {feedback.bus_watchdog}, not {self.config.watchdog}: another program wrote it"

    def take_samples(self) -> list[RawSample]:
        """Hand over the samples since the last call, oldest first."""
        return self._samples.take()

    def take_bench(self) -> list[RawBench]:
        """Return nothing: a servo has no bench sensors."""
        return []

    def setpoint(self, theta_m_ref_raw: int) -> Frame | None:
        """Return the goal position; while enabling, the angle at which that began."""
        if self._line.waiting_for is not None:
            return None  # it may be answering
        if self.phase is HostPhase.ENABLING:
            held_raw = self._enabling.reference(theta_m_ref_raw)
            if held_raw is None:
                return None
            theta_m_ref_raw = held_raw
        elif self.phase is not HostPhase.RUNNING:
            return None
        config = self.config
        counts = round(config.zero_counts + theta_m_ref_raw / ANGLE_LSB_PER_REV * config.counts_per_pulley_rev)
        if abs(counts) > table.MAX_GOAL_COUNTS:
            self.counters["out_of_range"] += 1
            return None
        self.setpoint_sequence = self.setpoint_sequence + 1 & SEQUENCE_MASK
        self.counters["setpoints_sent"] += 1
        data = counts.to_bytes(table.GOAL_POSITION.size, "little", signed=True)
        return self._line.announce(wire.write_unanswered(config.node, table.GOAL_POSITION.address, data))

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take one packet from the line."""
        answer = self._line.receive(frame, now_ns)
        if answer is None:
            return
        self._heard_ns, self._tries = now_ns, 0
        self.counters["alerts"] += answer.status.alert
        purpose = answer.request.purpose
        if purpose == "feedback":
            self._see_feedback(answer)
        elif purpose == "set up" and self.phase is HostPhase.IDENTIFYING:
            self._round_trips_ns.append(answer.received_ns - answer.sent_ns)
            self._set_up.answer(answer.status)
            self._check_set_up()
        elif purpose == "order" and self.phase is HostPhase.ENABLING:
            self._see_order(answer.status)
        elif purpose == "off":
            self._off_taken = not answer.status.error
        elif purpose == "is off":
            self._see_torque(answer.status)
        elif purpose == "reboot":
            self._see_reboot(now_ns)

    def poll(self, now_ns: int) -> list[Frame]:
        """Return what is due: at most one request."""
        has_reference = self.counters["setpoints_sent"] != self._references_before
        if has_reference:
            self._references_before, self._reference_ns = self.counters["setpoints_sent"], now_ns
        lost = self._line.gives_up(now_ns)
        if lost is not None:
            self._miss(lost, now_ns)
        is_known = self.phase not in {HostPhase.DISCONNECTED, HostPhase.REFUSED, HostPhase.IDENTIFYING}
        if is_known and now_ns - self._heard_ns > SILENCE_NS:
            self.drive_state = None
            self._fire("gone")
        if self._line.waiting_for is not None:
            return []
        request = self._next(now_ns, has_reference)
        return [] if request is None else [self._line.send(request, now_ns)]

    def _next(self, now_ns: int, has_reference: bool) -> Request | None:
        if self._wants_off and self.drive_state not in NO_TORQUE:
            return self._off()
        if self._wants_reboot:
            return Request("reboot", wire.reboot(self.config.node), 0, ANSWER_NS)
        if self.phase is HostPhase.IDENTIFYING:
            return self._next_of_set_up(now_ns)
        if self.phase is HostPhase.ENABLING:
            order = self._enabling.order()
            if order is not None:
                self._ordered = order
                return self._write("order", *order)
        if self.phase in {HostPhase.DISCONNECTED, HostPhase.REFUSED}:
            return None
        return self._feedback_request if self._may_ask(now_ns, has_reference) else None

    def _may_ask(self, now_ns: int, has_reference: bool) -> bool:
        """Whether feedback may be asked for: without torque always, under torque behind a reference, or soon after."""
        if has_reference or (self.phase is not HostPhase.RUNNING and self.drive_state in NO_TORQUE):
            return True
        if self.phase is HostPhase.FAULT or now_ns - self._reference_ns > self._unreferenced_ns:
            return False
        self.counters["asked_again"] += 1
        return True

    def _off(self) -> Request:
        node, item = self.config.node, table.TORQUE_ENABLE
        if self._off_taken:
            return Request("is off", wire.read(node, item.address, item.size), item.size, self._feedback_timeout_ns)
        return self._write("off", item, 0)._replace(timeout_ns=self._feedback_timeout_ns)

    def _see_torque(self, status: wire.Status) -> None:
        if status.data != b"\x00":
            self._off_taken = False
            return
        has_error = self._feedback is not None and self._feedback.hardware_error
        self.drive_state = DriveState.FAULT if has_error else DriveState.DISABLED

    def _see_reboot(self, now_ns: int) -> None:
        self._wants_reboot = False
        self._fire("reboot")
        self._begin_set_up(now_ns + REBOOT_NS)

    def _new_set_up(self) -> SetUp:
        return SetUp(self.config.node, self.config.current_limit_A, self.config.watchdog)

    def _begin_set_up(self, at_ns: int) -> None:
        self._set_up, self._tries, self._round_trips_ns = self._new_set_up(), 0, []
        self._waits_until_ns, self._feedback = at_ns, None
        self._line.forget()
        self.drive_state = None

    def _next_of_set_up(self, now_ns: int) -> Request | None:
        if now_ns < self._waits_until_ns:
            return None
        wanted = self._set_up.request()
        if wanted is None:
            return self._feedback_request
        frame, size = wanted
        if size is None:
            self._set_up.told()
        return Request("set up", frame, size, ANSWER_NS)

    def _check_set_up(self) -> None:
        if self._set_up.refusal:
            self._refuse(self._set_up.refusal)
        elif self._set_up.request() is None:
            middle_ns = sorted(self._round_trips_ns)[len(self._round_trips_ns) // 2]
            if middle_ns > self._feedback_timeout_ns:
                self._refuse(
                    f"servo {self.config.node} answers after {middle_ns / 1e6:.0f} ms, but "
                    f"{self._feedback_timeout_ns / 1e6:g} ms is the maximum: its adapter delays data (an FTDI's "
                    "latency timer: `echo 1 > /sys/bus/usb-serial/devices/ttyUSB0/latency_timer`), or its Return "
                    "Delay Time was reset"
                )

    def _see_order(self, status: wire.Status) -> None:
        item, value = self._ordered
        if status.error:
            self._refuse(f"servo {self.config.node} refuses {item} = {value}: {wire.error_words(status.error)}")
            return
        self._enabling.taken()
        if self._enabling.step is Step.DONE:
            self._fire("limit taken")
        elif item is table.TORQUE_ENABLE:
            self.drive_state = DriveState.ARMED

    def _miss(self, request: Request, now_ns: int) -> None:
        """An answer didn't come."""
        if request.purpose == "reboot":
            self._see_reboot(now_ns)
        if request.purpose not in {"set up", "order"} or self._wants_off:
            return
        self._tries += 1
        if self._tries < MAX_TRIES:
            return
        if request.purpose == "order" or self._set_up.model is not None:
            subject = "orders" if request.purpose == "order" else f"requests for {self._set_up.subject()}"
            self._refuse(f"servo {self.config.node} no longer answers {subject}")

    def _see_feedback(self, answer: Answer) -> None:
        feedback = table.parse_feedback(answer.status.data)
        if feedback is None or feedback.status_return_level != table.STATUS_OF_ALL:
            self._see_restart(answer.received_ns)
            return
        self._feedback = feedback
        self._see_state(feedback)
        if self.phase is HostPhase.IDENTIFYING:
            self._fire("complete")
        config, model = self.config, self._set_up.model
        latched_ns = answer.sent_ns + self._line_ns(READ_BYTES + GOAL_BYTES * (self._reference_ns == answer.sent_ns))
        stamp_ns = min(latched_ns, answer.received_ns)
        if stamp_ns <= self._stamp_ns or model is None:
            self.counters["not_increasing"] += 1
            return
        self._stamp_ns = stamp_ns
        self._samples.append(
            stamp_ns=stamp_ns,
            received_ns=answer.received_ns,
            pulley_rev=(feedback.position - config.zero_counts) / config.counts_per_pulley_rev,
            current_A=feedback.current * model.current_unit_A * math.copysign(1.0, config.counts_per_pulley_rev),
            state=self.drive_state,
            setpoint_sequence=self.setpoint_sequence,
        )

    def _see_state(self, feedback: table.Feedback) -> None:
        has_torque, is_faulty = feedback.torque_enable != 0, feedback.hardware_error != 0
        if is_faulty or feedback.bus_watchdog != self.config.watchdog:
            self._fire("fault")
        if has_torque:
            is_running = self.phase is HostPhase.RUNNING
            self.drive_state = DriveState.OPERATIONAL if is_running else DriveState.ARMED
            return
        if not self._wants_off or self.drive_state in NO_TORQUE:  # else it is to be read by itself
            self.drive_state = DriveState.FAULT if is_faulty else DriveState.DISABLED
        self._fire("left")
        if self.phase is HostPhase.ENABLING:
            self._enabling.without_torque()

    def _see_restart(self, now_ns: int) -> None:
        self.counters["restarts"] += 1
        if self.phase is not HostPhase.IDENTIFYING:
            self.drive_state = None
            self._fire("gone")
            return
        self._set_up_restarts += 1
        if self._set_up_restarts >= MAX_RESTARTS:
            self._refuse(f"servo {self.config.node} accepts {table.INDIRECT_ADDRESSES}, but does not answer with them")
        else:
            self._begin_set_up(now_ns)

    def _refuse(self, words: str) -> None:
        self.refusal = words
        self._fire("refuse")

    def _write(self, purpose: Purpose, item: table.Item, value: int) -> Request:
        data = value.to_bytes(item.size, "little")
        return Request(purpose, wire.write(self.config.node, item.address, data), 0, ANSWER_NS)

    def _line_ns(self, size: int) -> int:
        return size * wire.BITS_PER_BYTE * _NS_PER_S // self.config.baudrate_bit_per_s

    def _fire(self, event: str) -> None:
        self.phase = TRANSITIONS.get((self.phase, event), self.phase)
