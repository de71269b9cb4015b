"""A drive in hand: bring it to a state, ask it for values, put everything back."""

from typing import Final, NamedTuple

from firmware_protocol.conformance import wire
from firmware_protocol.conformance.findings import Disturbed, Inconclusive, Violation, require
from firmware_protocol.conformance.port import MS, Margins, Port
from firmware_protocol.conformance.probe import Probe, Sample
from firmware_protocol.frames import BROADCAST_NODE, MAX_NODE, Frame, arbitration_id
from firmware_protocol.messages import Control, DriveState, FaultReason, Function, Identity, ParamOp
from firmware_protocol.parameters import BY_INDEX, DICTIONARY, INT32_MAX, INT32_MIN, Access, Index

LOW: Final = 0
ENABLE: Final = int(Control.ENABLE)
RESET: Final = int(Control.FAULT_RESET)
ANSWER_NS: Final = 10 * MS  # HFP-150
IDENTITY_NS: Final = 35 * MS  # HFP-060

# So generous that no check runs into a limit that it does not mean to test; put back at the end.
BASELINE: Final[dict[int, int]] = {
    Index.WATCHDOG_TIMEOUT: 200_000,
    Index.HOST_HEARTBEAT_TIMEOUT: 500_000,
    Index.ARM_TIMEOUT: 3_000_000,
    Index.MAX_SAMPLE_AGE: 100,
}


class MeasuredTime(NamedTuple):
    """A measured time and what is allowed with all margins."""

    name: str
    measured_us: float
    low_us: float
    high_us: float


class Session(Probe):
    """The drive under test; `originals` are its values as found, `identity` who it is."""

    def __init__(self, port: Port, node: int, margins: Margins) -> None:
        self._position_limits = (INT32_MIN, INT32_MAX)  # as found
        super().__init__(port, node, margins)
        self.home = node
        self.serial_number = 0
        self.period_ns = MS
        self.originals: dict[int, int] = {}
        self.identity: Identity | None = None
        self.timings: list[MeasuredTime] = []
        self._baseline: dict[int, int] = {}
        self._held: dict[int, int] = {}  # what was last written or read, by index
        self._was_inside, self._was_pushed = False, False

    # -- parameters ---------------------------------------------------------------------------------------------------

    def request(self, op: int, index: int, value: int = 0, backlog_ns: int = 0) -> tuple[int, int] | None:
        """Send PARAM_REQUEST; return result and value of the first answer to it, None when there is none in time.

        `backlog_ns`: what the line may need besides for what was sent before.
        """
        self.responses.clear()
        self.send(wire.sealed8(Function.PARAM_REQUEST, self.node, wire.param_body(op, index, value)))
        self.run(ANSWER_NS + self.margins.line_ns + backlog_ns, lambda: self._answer(index) is not None)
        return self._answer(index)

    def _answer(self, index: int) -> tuple[int, int] | None:
        return next(((m.op, m.value) for _, m in self.responses if m.parameter == index), None)

    def read(self, index: int) -> int:
        """Return the value of a parameter; Inconclusive when the drive does not give it."""
        answer = self.request(ParamOp.READ, index) or self.request(ParamOp.READ, index)
        if answer is None or answer[0] != ParamOp.OK:
            raise Inconclusive(f"{BY_INDEX[index].name} could not be read: {answer}")
        return answer[1]

    def write(self, index: int, value: int) -> None:
        """Write a parameter; Inconclusive when the drive does not take it."""
        answer = self.request(ParamOp.WRITE, index, value)
        if answer is None or answer[0] != ParamOp.OK:
            raise Inconclusive(f"{BY_INDEX[index].name} could not be set to {value}: {answer}")
        self._held[index] = value

    def touched(self, index: int) -> None:
        """Say that this parameter may have been changed by the check itself."""
        self._held.pop(index, None)

    def accepted(self) -> int:
        """Return how many references the drive has accepted."""
        return self.read(Index.SETPOINTS_ACCEPTED)

    def rejected(self) -> int:
        """Return how many frames for it the drive has dropped."""
        return self.read(Index.REJECTED)

    # -- states -------------------------------------------------------------------------------------------------------

    def heartbeat(self, control: int, advance: int = 1, major: int = 1, minor: int = 0) -> int:
        """Send HOST_HEARTBEAT and give it time to arrive before anything else does; return when it went."""
        time_ns = self.send_heartbeat(control, advance, major, minor)
        self.run(self.margins.gap_ns)
        return time_ns

    def pause(self) -> None:
        """Give all that was sent time to arrive and to show in a measurement."""
        self.run(self.margins.line_ns + self.period_ns)
        mark_ns = self.now_ns()
        self.run(20 * self.period_ns, lambda: self.newest is not None and self.newest.time_ns > mark_ns)

    def observe(self) -> DriveState | int:
        """Return the state that the drive is in after all that was sent."""
        self.pause()
        return self.state

    def wait_state(self, state: DriveState, within_ns: int = 0) -> bool:
        """Wait until the drive says that it is in a state."""
        within_ns = within_ns or 5 * MS + 3 * self.period_ns + 2 * self.margins.line_ns
        return self.run(within_ns, lambda: self.state == state)

    def time_of(self, state: DriveState, since_ns: int, within_ns: int) -> int:
        """Return how long after `since_ns` the drive first said it was in a state; Violation when it never did."""
        if not self.run(within_ns, lambda: self.state == state):
            raise Violation(f"not {state.name} {within_ns // MS} ms later, but {self.state_name()}")
        time_ns = self.now_ns()
        for sample in reversed(self.samples):
            if sample.state != state or sample.time_ns < since_ns:
                break
            time_ns = sample.time_ns
        return time_ns - since_ns

    def state_name(self) -> str:
        """Name the state and the reason last reported."""
        names = {int(s): s.name for s in DriveState}
        reasons = {int(f): f.name for f in FaultReason}
        return f"{names.get(self.state, str(self.state))}/{reasons.get(self.fault, str(self.fault))}"

    def arm(self) -> int:
        """Lead the drive to ARMED; return when ENABLE went."""
        self.reference = None
        self.heartbeat(LOW)
        time_ns = self.heartbeat(ENABLE)
        require(self.wait_state(DriveState.ARMED), f"the drive could not be armed: {self.state_name()}")
        return time_ns

    def operate(self) -> int:
        """Lead the drive to OPERATIONAL at the angle where it is, which is then held; return that angle."""
        self.arm()
        self.fresh()
        theta = self.measured().theta_m
        self.setpoint_sequence = self.measured().echo
        self.send_setpoint(theta)
        self.reference = theta
        require(self.wait_state(DriveState.OPERATIONAL), f"no OPERATIONAL: {self.state_name()}")
        return theta

    def fresh(self) -> None:
        """Wait for the next measurement and return at once, while it is the newest."""
        before = self.newest
        tick_ns = min(self.margins.tick_ns, self.period_ns // 10)
        self.run(30 * self.period_ns, lambda: self.newest is not before, tick_ns)

    def measured(self) -> Sample:
        """Return the newest measurement; Inconclusive when there never was one."""
        if self.newest is None:
            raise Inconclusive("the drive sends no measurements")
        return self.newest

    def listen(self) -> None:
        """Forget the answers so far: what comes from now on is the answer to what comes now."""
        self.responses.clear()
        self.identities.clear()

    def rest(self) -> int:
        """Wait until the motor stands still; return the range of the angle over 20 samples."""
        for _ in range(60):
            begin = len(self.samples)
            self.run(50 * MS + 20 * self.period_ns)
            angles = [s.theta_m for s in self.samples[begin:]][-20:]
            if angles and max(angles) - min(angles) <= 64:
                return max(angles) - min(angles)
        raise Inconclusive("the motor does not come to rest without torque")

    def estop(self) -> int:
        """Send ESTOP to the drive; return when it went."""
        self.reference = None
        return self.send(Frame(arbitration_id(Function.ESTOP, self.node), b""))

    def fail(self) -> None:
        """Lead the drive to FAULT."""
        self.estop()
        require(self.wait_state(DriveState.FAULT), f"no FAULT after ESTOP: {self.state_name()}")

    def reset(self) -> None:
        """Lead the drive from FAULT to DISABLED, all control bits low."""
        self.reference = None
        self.heartbeat(LOW)
        self.heartbeat(RESET)
        self.heartbeat(LOW)
        require(self.wait_state(DriveState.DISABLED), f"no reset: {self.state_name()}")

    def disable(self) -> None:
        """Lead the drive to DISABLED, one way or the other."""
        self.reference = None
        self.heartbeat(LOW)
        if self.state == DriveState.FAULT or not self.wait_state(DriveState.DISABLED) or self.state_now_faulty():
            self.fail()
            self.reset()

    def state_now_faulty(self) -> bool:
        """Look once more whether the drive is in FAULT."""
        return self.observe() == DriveState.FAULT

    def silence(self) -> None:
        """Say nothing until the drive has lost its host."""
        beating, self.beating, self.reference = self.beating, False, None
        timeout_us = self._held.get(Index.HOST_HEARTBEAT_TIMEOUT) or BY_INDEX[Index.HOST_HEARTBEAT_TIMEOUT].maximum
        self.run(round(timeout_us * 1100) + 2 * self.margins.line_ns + self.margins.granularity_ns)
        self.beating = beating

    # -- order --------------------------------------------------------------------------------------------------------

    def recover(self) -> None:
        """Bring the drive back to its node, DISABLED, without fault, at the baseline; Inconclusive when it can't be."""
        self.reference = None
        for attempt in range(3):
            self.beating = True
            try:
                self._come_home(attempt)
                self._to_disabled()
                self._put(self._baseline)
            except Inconclusive as reason:
                last = reason
                self.silence()
            else:
                return
        raise Inconclusive(f"the drive could not be restored: {last}")

    def _to_disabled(self) -> None:
        self.heartbeat(LOW)
        if self.observe() != DriveState.DISABLED:
            self.fail()
            self.reset()
        require(self.observe() == DriveState.DISABLED, self.state_name())
        answer = self.request(ParamOp.READ, Index.NODE)
        require(answer == (ParamOp.OK, self.home), f"node {self.home} answers {answer}")

    def _come_home(self, attempt: int) -> None:
        """Give the drive its node id back if it has another."""
        if self.node == self.home and not attempt:
            return
        self.follow(self.find())
        if self.node != self.home:
            self.heartbeat(LOW)
            self.move(self.home)

    def find(self) -> int:
        """Return the node id at which the drive with our serial number answers DISCOVER."""
        self.identities.clear()
        self.send(Frame(arbitration_id(Function.DISCOVER, BROADCAST_NODE), b""))
        self.run(2 * IDENTITY_NS + self.margins.line_ns)
        for _, identity in self.identities:
            if self.identity is None or identity.serial_number == self.identity.serial_number:
                return identity.node
        raise Inconclusive("the drive does not answer DISCOVER")

    def move(self, node: int) -> None:
        """Give the drive another node id and follow it there; Inconclusive when it does not go."""
        self.send(wire.sealed8(Function.ASSIGN_NODE, BROADCAST_NODE, wire.assign_body(self.serial_number, node)))
        self.run(self.margins.gap_ns)
        self.follow(node)
        self.send_heartbeat(LOW)
        require(
            self.request(ParamOp.READ, Index.NODE) == (ParamOp.OK, node), f"the drive does not answer as node {node}"
        )

    def follow(self, node: int) -> None:
        """Look for the drive at another node id from now on."""
        self.node = node
        self.monitor.restart()

    def free_nodes(self) -> list[int]:
        """Return the node ids that nobody else was heard on, ours left out."""
        taken = self.others | {self.home, self.node} | {m.node for _, m in self.identities}
        return [node for node in range(1, MAX_NODE + 1) if node not in taken]

    def _put(self, values: dict[int, int]) -> None:
        """Write what differs, twice where one limit has to go before the other can."""
        for _ in range(2):
            for index, value in values.items():
                if self._held.get(index) != value and self.request(ParamOp.WRITE, index, value) == (ParamOp.OK, value):
                    self._held[index] = value
        wrong = [BY_INDEX[index].name for index, value in values.items() if self._held.get(index) != value]
        require(not wrong, f"could not be put back: {', '.join(wrong)}")

    def open(self) -> None:
        """Get to know the drive and bring it to the baseline; Inconclusive when that fails."""
        self.silence()
        self.home = self.node
        for row in DICTIONARY:
            self.originals[int(row.number)] = self.read(row.number)
        self.fd = self.monitor.is_fd = bool(self.originals[Index.FD])
        self.serial_number = self.originals[Index.SERIAL_LOW] | self.originals[Index.SERIAL_HIGH] << 24
        self.period_ns = self.originals[Index.SAMPLE_PERIOD] * 1000
        writable = {
            int(row.number): self.originals[row.number] for row in DICTIONARY if row.access is not Access.READ_ONLY
        }
        self._held = dict(writable)
        self._baseline = {**writable, **BASELINE}
        self._position_limits = (self.originals[Index.THETA_MIN], self.originals[Index.THETA_MAX])
        self.find()
        self.identity = next((m for _, m in self.identities if m.node == self.node), None)
        require(self.identity is not None, "the drive does not answer DISCOVER")
        self.recover()

    def require_judgeable(self, moves: bool) -> None:
        """Inconclusive where the drive is in no position to be judged, with what to do about it.

        Checks hold the angle against what it was: without torque the motor has to stand still, inside its limits; and
        with room for a step where it is to move. What the drive itself does wrong is for the checks to say: a motor
        that moves by a current, and no measurements at all.
        """
        begin = len(self.samples)
        self.run(50 * MS + 20 * self.period_ns)
        if len(self.samples) == begin:
            return
        try:
            self.rest()
        except Inconclusive as reason:
            if any(abs(each.current) > self.margins.idle_current_raw for each in self.samples[begin:]):
                return
            raise Inconclusive(f"{reason}; take the load off the jaw, or hold it") from None
        theta, (low, high) = self.measured().theta_m, self._position_limits
        inside = f"the motor is at {theta}, its limits are {low} to {high} (2^-24 rev)"
        require(low <= theta <= high, f"{inside}; move it within, or change theta_min_raw and theta_max_raw")
        step = self.margins.move_raw
        has_room = theta + step <= high or theta - step >= low
        require(has_room or not moves, f"{inside}: no room for the motion of {step}; move it, or change the limits")

    def _on_sample(self, sample: Sample) -> None:
        """Note who took the motor beyond its limits: the drive, or something outside."""
        low, high = self._position_limits
        if low <= sample.theta_m <= high:
            self._was_inside, self._was_pushed = True, False
        elif self._was_inside:
            self._was_inside = False
            no_current = abs(sample.current) <= self.margins.idle_current_raw
            self._was_pushed = no_current and sample.state != DriveState.OPERATIONAL
        super()._on_sample(sample)

    def require_undisturbed(self) -> None:
        """Disturbed where something has pushed the motor beyond its limits, while the drive gave it no torque."""
        if self._was_pushed:
            low, high = self._position_limits
            raise Disturbed(
                f"an external torque moved the motor to {self.measured().theta_m}, beyond its limits {low} to {high} "
                "(2^-24 "
                "rev), while the drive gave no torque; take the load off the jaw, or hold it"
            )

    def close(self) -> None:
        """Leave the drive as it was found, DISABLED, and say nothing more."""
        try:
            self.recover()
            self._put({index: self.originals[index] for index in self._baseline})
        finally:
            self.beating = False

    # -- evidence -----------------------------------------------------------------------------------------------------

    def timing(self, name: str, measured_ns: int, low_ns: int, high_ns: int) -> str:
        """Record a measured time with what is allowed; Violation when it is outside."""
        self.timings.append(MeasuredTime(name, measured_ns / 1000, low_ns / 1000, high_ns / 1000))
        said = f"{name}: {measured_ns / MS:.3f} ms, allowed {low_ns / MS:.3f} to {high_ns / MS:.3f} ms"
        if not low_ns <= measured_ns <= high_ns:
            raise Violation(said)
        return said

    def timeout(self, name: str, measured_ns: int, nominal_us: int) -> str:
        """Judge a time-out, from the sending of what fed it to the arrival of the news that it is over."""
        slack_ns = nominal_us * self.margins.clock_ppm // 1000
        late_ns = self.margins.granularity_ns + self.period_ns + self.margins.line_ns
        return self.timing(name, measured_ns, nominal_us * 1000 - slack_ns, nominal_us * 1000 + slack_ns + late_ns)
