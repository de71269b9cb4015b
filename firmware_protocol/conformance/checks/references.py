"""References: HFP-110 to HFP-118. All but one give torque, of a few units around the angle unless said."""

from firmware_protocol.conformance.checks.enabling import room
from firmware_protocol.conformance.findings import expect, require
from firmware_protocol.conformance.port import MS
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import LOW, Session
from firmware_protocol.messages import DriveState, FaultReason
from firmware_protocol.parameters import INT32_MAX, INT32_MIN, Index
from firmware_protocol.states import MAX_SEQUENCE_ADVANCE

MAX_STEP_COUNTS = 64  # of the angle, as `max_step` is set for these checks
MAX_STEP_FACTOR = 8  # HFP-116


def uncertainty(s: Session) -> int:
    """Return by how many samples the drive may be ahead of what has arrived here."""
    return 0 if s.virtual else -(-s.margins.line_ns // s.period_ns) + 1


def accepts(s: Session, theta: int, sequence: int, age: int) -> bool:
    """Tell whether a reference is accepted, by the drive's own count; one that surely is goes before."""
    s.fresh()
    s.send_setpoint(theta)
    before = s.accepted()
    s.fresh()
    s.send(s.setpoint_frame(theta, s.setpoint_sequence + sequence, age))
    s.run(s.margins.gap_ns)
    grown = s.accepted() - before
    if grown:
        s.setpoint_sequence = (s.setpoint_sequence + sequence) & 0xFF
    require(s.state == DriveState.OPERATIONAL, f"no longer OPERATIONAL but {s.state_name()}")
    return grown > 0


@check(110, Need.MOTION)
def fresh_is_1_to_127_ahead(s: Session) -> str:
    theta = s.operate()
    s.reference = None
    for advance in s.dense(range(256), (0, 1, 2, 126, 127, 128, 129, 192, 254, 255)):
        wanted = 1 <= advance <= MAX_SEQUENCE_ADVANCE
        found = accepts(s, theta, advance, 0)
        expect(found == wanted, f"a reference {advance} ahead was {'accepted' if found else 'dropped'}")
    return "references 1 to 127 ahead accepted, repeated and older ones dropped"


@check(111, Need.MOTION)
def any_sequence_in_armed(s: Session) -> str:
    for advance in (0, -1, -2, 128, 129, 200, 127, 1):
        s.arm()
        s.fresh()
        s.send_setpoint(s.measured().theta_m, advance)
        expect(s.wait_state(DriveState.OPERATIONAL), f"first reference {advance} ahead: {s.state_name()}")
        s.disable()
    return "first reference taken with sequences of any advance"


@check(112, Need.MOTION)
def old_samples_refused(s: Session) -> str:
    unsure = uncertainty(s)
    for limit in s.dense((20, 2, 127), (20,)):
        s.write(Index.MAX_SAMPLE_AGE, limit)
        theta = s.operate()
        s.reference = None
        good = [age for age in s.dense(range(limit + 1), (0, limit // 2, limit - unsure)) if 0 <= age <= limit - unsure]
        bad = [age for age in s.dense(range(limit + 1, 128), (limit + 1, limit + 2, 64, 127)) if age > limit]
        for age in good:
            expect(accepts(s, theta, 1, age), f"a reference {age} samples old was dropped, {limit} allowed")
        for age in bad:
            expect(not accepts(s, theta, 1, age), f"a reference {age} samples old was accepted, {limit} allowed")
        s.disable()
    return "references dropped from the first sample beyond max_sample_age on"


@check(113, Need.MOTION)
def samples_to_come_refused(s: Session) -> str:
    theta = s.operate()
    s.reference = None
    first = 1 + 2 * uncertainty(s)
    for ahead in s.dense(range(1, 128), (first, first + 1, first + 10, 64, 127)):
        expect(not accepts(s, theta, 1, -ahead), f"a reference from a sample {ahead} to come was accepted")
    return f"references from samples {first} to 127 to come dropped"


@check(114)
def references_dropped_without_torque(s: Session) -> str:
    for state in (DriveState.DISABLED, DriveState.FAULT):
        if state == DriveState.FAULT:
            s.fail()
        before = s.accepted()
        for _ in range(5):
            s.fresh()
            s.send_setpoint(s.measured().theta_m)
            s.run(s.margins.gap_ns)
        expect(s.observe() == state, f"references in {state.name} led to {s.state_name()}")
        grown = s.accepted() - before
        expect(grown == 0, f"{grown} references accepted in {state.name}")
    return "references dropped in DISABLED and FAULT"


def _limited(s: Session, width: int) -> tuple[int, int]:
    """Set position limits around the angle; return them."""
    s.rest()
    theta = s.measured().theta_m
    low, high = max(theta - width, INT32_MIN), min(theta + width, INT32_MAX)
    require(low > INT32_MIN and high < INT32_MAX, "the angle is too near to the end of its range")
    s.write(Index.THETA_MIN, low) if high >= s.originals[Index.THETA_MAX] else s.write(Index.THETA_MAX, high)
    s.write(Index.THETA_MIN, low)
    s.write(Index.THETA_MAX, high)
    return low, high


@check(115, Need.MOTION)
def position_limits(s: Session) -> str:
    s.write(Index.REFERENCE_TOLERANCE, 4000)
    s.write(Index.MAX_STEP, 1 << 16)
    for beyond in (0, 1, 2, 300):
        low, high = _limited(s, 1000)
        for reference in (high + beyond, low - beyond):
            wanted = DriveState.FAULT if beyond else DriveState.OPERATIONAL
            s.arm()
            s.fresh()
            s.send_setpoint(reference)
            s.run(20 * MS, lambda: s.state != DriveState.ARMED, s.period_ns)
            _judge_position(s, wanted, f"in ARMED, limits {low} to {high}, reference {reference}")
            s.rest()
            s.operate()
            s.reference = None
            s.fresh()
            s.send_setpoint(reference)
            s.pause()
            _judge_position(s, wanted, f"in OPERATIONAL, limits {low} to {high}, reference {reference}")
            s.rest()
    return "accepted at both limits, REFERENCE_POSITION one unit beyond, in ARMED and OPERATIONAL"


def _judge_position(s: Session, wanted: DriveState, where: str) -> None:
    s.reference = None
    fits = s.state == wanted and (wanted != DriveState.FAULT or s.fault == FaultReason.REFERENCE_POSITION)
    expect(fits, f"{where}: {s.state_name()}")
    s.disable()


@check(118, Need.MOTION)
def position_before_all_else(s: Session) -> str:
    s.write(Index.REFERENCE_TOLERANCE, 100)
    s.write(Index.MAX_STEP, MAX_STEP_COUNTS)
    low, high = _limited(s, 1000)
    for reference in (high + 5000, low - 5000):
        s.arm()
        s.fresh()
        s.send_setpoint(reference)
        s.run(20 * MS, lambda: s.state != DriveState.ARMED, s.period_ns)
        _judge_position(s, DriveState.FAULT, f"in ARMED, 5000 beyond {low} to {high}, tolerance 100")
        s.rest()
        s.operate()
        s.reference = None
        s.fresh()
        s.send_setpoint(reference)
        s.pause()
        _judge_position(s, DriveState.FAULT, f"in OPERATIONAL, 5000 beyond {low} to {high}, max_step {MAX_STEP_COUNTS}")
        s.rest()
    return "REFERENCE_POSITION also where tolerance or step limit are passed, too"


@check(116, Need.MOTION)
def step_limit(s: Session) -> str:
    s.write(Index.MAX_STEP, MAX_STEP_COUNTS)
    advances = s.dense((1, 2, 3, 4, 5, 6, 7, 8, 9, 16, 64, 127), (1, 7, 8, 9, 127))
    for advance in advances:
        allowed = MAX_STEP_COUNTS * min(advance, MAX_STEP_FACTOR)
        for step in (allowed, allowed + 1, -allowed, -allowed - 1):
            theta = s.operate()
            s.reference = None
            s.fresh()
            s.send_setpoint(theta + step, advance)
            s.pause()
            said = f"a step of {step} after an advance of {advance}, max_step {MAX_STEP_COUNTS}: {s.state_name()}"
            if abs(step) <= allowed:
                expect(s.state == DriveState.OPERATIONAL, said)
            else:
                expect(s.state == DriveState.FAULT and s.fault == FaultReason.REFERENCE_RATE, said)
            s.disable()
    return f"max_step x min(a, 8) allowed and no unit more, for {len(advances)} advances, both ways"


@check(117, Need.MOTION)
def motor_follows(s: Session) -> str:
    s.write(Index.MAX_STEP, max(s.margins.move_raw, s.originals[Index.MAX_STEP]))
    s.rest()
    start = s.operate()
    amount = room(s, start, s.margins.move_raw)
    said = ""
    for target in (start + amount, start):
        begin, first = s.reference if s.reference is not None else start, s.now_ns()
        while (passed := s.now_ns() - first) < 200 * MS:
            s.reference = begin + (target - begin) * passed // (200 * MS)
            s.run(2 * MS)
        s.reference = target
        s.run(500 * MS)
        off = s.measured().theta_m - target
        said = f"{off} units off after a motion of {amount}"
        expect(abs(off) <= abs(amount) // 5, said)
        expect(s.state == DriveState.OPERATIONAL, f"while moving: {s.state_name()}")
    s.heartbeat(LOW)
    return said
