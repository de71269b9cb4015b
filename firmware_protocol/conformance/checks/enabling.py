"""Enabling: HFP-091 to HFP-099."""

from firmware_protocol.conformance.findings import Violation, expect, require
from firmware_protocol.conformance.port import MS
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import ENABLE, LOW, Session
from firmware_protocol.messages import PROTOCOL_MAJOR, DriveState, FaultReason
from firmware_protocol.parameters import Index
from firmware_protocol.scales import wrap_int32

OTHER_MAJORS = tuple(major for major in range(256) if major != PROTOCOL_MAJOR)


def room(s: Session, theta: int, amount: int) -> int:
    """Return the amount with the sign that stays within the position limits; Inconclusive when neither does."""
    low, high = s.originals[Index.THETA_MIN], s.originals[Index.THETA_MAX]
    for sign in (1, -1):
        if low <= theta + sign * amount <= high:
            return sign * amount
    raise_for = f"no room for a motion of {amount} within {low} to {high} at {theta}"
    require(False, raise_for)
    return 0


def kick(s: Session) -> None:
    """Go OPERATIONAL and ask for a step, so that current flows; Inconclusive when none is measured."""
    s.write(Index.MAX_STEP, max(s.margins.move_raw, s.originals[Index.MAX_STEP]))
    theta = s.operate()
    begin = len(s.samples)
    s.reference = theta + room(s, theta, s.margins.move_raw)
    s.run(100 * MS, lambda: any(abs(x.current) > s.margins.idle_current_raw for x in s.samples[begin:]), s.period_ns)
    peak = max((abs(x.current) for x in s.samples[begin:]), default=0)
    require(peak > s.margins.idle_current_raw, f"a step of the reference gave a current of {peak} only")


def no_current(s: Session, where: str, wait_ns: int = 20 * MS) -> None:
    """Judge the current from `wait_ns` on."""
    s.run(wait_ns)
    begin = len(s.samples)
    s.run(20 * s.period_ns)
    peak = max((abs(x.current) for x in s.samples[begin:]), default=0)
    expect(peak <= s.margins.idle_current_raw, f"a current of {peak} x 0.2 mA in {where}")


@check(91, Need.MOTION)
def torque_in_operational_only(s: Session) -> str:
    no_current(s, "DISABLED, before")
    kick(s)
    s.disable()
    no_current(s, "DISABLED, after")
    s.rest()
    kick(s)
    s.estop()
    no_current(s, "FAULT, after ESTOP")
    s.reset()
    s.rest()
    s.arm()
    no_current(s, "ARMED")
    return "no current in DISABLED, ARMED and FAULT, also right after it flowed"


@check(92)
def rising_enable_arms(s: Session) -> str:
    minors = s.dense(range(256), (0, 1, 127, 255))
    for minor in minors:
        s.heartbeat(LOW)
        s.heartbeat(ENABLE, minor=minor)
        expect(s.wait_state(DriveState.ARMED), f"ENABLE of minor version {minor}: {s.state_name()}")
        s.disable()
    return f"armed by hosts of {len(minors)} minor versions"


@check(93)
def enable_that_stays_high_does_not_enable(s: Session) -> str:
    s.write(Index.HOST_HEARTBEAT_TIMEOUT, 100_000)
    s.silence()
    for number in range(30):
        s.heartbeat(ENABLE)
        expect(s.observe() == DriveState.DISABLED, f"{s.state_name()} after {number + 1} heartbeats with ENABLE high")
    return "30 heartbeats with ENABLE high and no rise"


@check(94)
def other_major_faults_when_enable_rises(s: Session) -> str:
    majors = s.dense(OTHER_MAJORS, (0, 2, 3, 127, 129, 255))
    for major in majors:
        s.heartbeat(LOW)
        s.heartbeat(ENABLE, major=major)
        faulted = s.wait_state(DriveState.FAULT) and s.fault == FaultReason.VERSION
        expect(faulted, f"ENABLE of major version {major}: {s.state_name()}")
        s.reset()
    return f"{len(majors)} other major versions refused with VERSION"


@check(95)
def other_major_faults_in_armed(s: Session) -> str:
    for major in (0, 2, 3, 255):
        s.arm()
        s.heartbeat(ENABLE, major=major)
        faulted = s.wait_state(DriveState.FAULT) and s.fault == FaultReason.VERSION
        expect(faulted, f"ENABLE of major version {major} in ARMED: {s.state_name()}")
        s.reset()
    return "VERSION in ARMED"


@check(95, Need.MOTION)
def other_major_faults_in_operational(s: Session) -> str:
    for major in (0, 2):
        s.operate()
        s.heartbeat(ENABLE, major=major)
        faulted = s.wait_state(DriveState.FAULT) and s.fault == FaultReason.VERSION
        expect(faulted, f"ENABLE of major version {major} in OPERATIONAL: {s.state_name()}")
        s.reset()
    return "VERSION in OPERATIONAL"


def first_reference(s: Session, offset: int) -> DriveState | int:
    """Arm and send a first reference that far from the angle; return the state it led to, torque taken away again."""
    s.arm()
    s.fresh()
    theta = s.measured().theta_m
    s.send_setpoint(wrap_int32(theta + offset))
    s.run(20 * MS, lambda: s.state != DriveState.ARMED, s.period_ns)
    state = s.state
    if state == DriveState.OPERATIONAL:
        s.heartbeat(LOW)
    return state


def within_limits(s: Session, offset: int) -> bool:
    """Tell whether the angle plus an offset is a position that the drive allows."""
    theta = s.measured().theta_m
    return s.originals[Index.THETA_MIN] <= theta + offset <= s.originals[Index.THETA_MAX]


@check(96, Need.MOTION)
def first_reference_within_tolerance(s: Session) -> str:
    noise = s.rest()
    for tolerance in dict.fromkeys((s.originals[Index.REFERENCE_TOLERANCE], 1000)):
        s.write(Index.REFERENCE_TOLERANCE, tolerance)
        edge = max(tolerance - noise, 0)
        for offset in sorted({0, edge, -edge, edge // 2, max(edge - 1, 0), -max(edge - 1, 0)}):
            s.rest()
            if not within_limits(s, offset):
                continue
            state = first_reference(s, offset)
            expect(
                state == DriveState.OPERATIONAL, f"reference off by {offset}, tolerance {tolerance}: {s.state_name()}"
            )
            s.disable()
    return f"accepted up to the tolerance less {noise} (what the angle wanders)"


@check(97, Need.MOTION)
def first_reference_off(s: Session) -> str:
    noise = s.rest()
    tolerance = s.originals[Index.REFERENCE_TOLERANCE]
    beyond = tolerance + noise + 1
    tried = 0
    for distance in (beyond, beyond + 1, 2 * beyond, 1 << 20, 1 << 22, 1 << 23, 1 << 24, 1 << 25, 1 << 30):
        for offset in (distance, -distance):
            s.rest()
            if not within_limits(s, offset):
                continue
            state = first_reference(s, offset)
            faulted = state == DriveState.FAULT and s.fault == FaultReason.REFERENCE_MISMATCH
            expect(faulted, f"reference off by {offset}, tolerance {tolerance}: {s.state_name()}")
            s.reset()
            tried += 1
    require(tried > 0, "the position limits leave no room beyond the tolerance")
    return f"REFERENCE_MISMATCH at {tried} distances beyond the tolerance"


@check(98)
def arm_timeout(s: Session) -> str:
    said = ""
    for timeout_us in dict.fromkeys((s.originals[Index.ARM_TIMEOUT], 100_000, *s.dense((20_000, 2_000_000), ()))):
        s.write(Index.ARM_TIMEOUT, timeout_us)
        sent_ns = s.arm()
        elapsed = s.time_of(DriveState.FAULT, sent_ns, timeout_us * 1500 + 60 * MS)
        if s.fault != FaultReason.ENABLE_TIMEOUT:
            raise Violation(f"{s.state_name()} without a reference")
        said = s.timeout(f"arm timeout of {timeout_us} us", elapsed, timeout_us)
        s.reset()
    return said


@check(99)
def enable_low_leaves_armed(s: Session) -> str:
    for _ in range(3):
        s.arm()
        s.heartbeat(LOW)
        expect(s.wait_state(DriveState.DISABLED), f"ENABLE low in ARMED: {s.state_name()}")
    return "ARMED to DISABLED"


@check(99, Need.MOTION)
def enable_low_leaves_operational(s: Session) -> str:
    for _ in range(3):
        s.operate()
        s.reference = None
        s.heartbeat(LOW)
        expect(s.wait_state(DriveState.DISABLED), f"ENABLE low in OPERATIONAL: {s.state_name()}")
    return "OPERATIONAL to DISABLED"
