"""Watchdog: HFP-120 to HFP-124. The motor is held where it is, or moved by one step."""

from collections.abc import Callable

from firmware_protocol.conformance import wire
from firmware_protocol.conformance.checks.enabling import room
from firmware_protocol.conformance.checks.ids import param_read
from firmware_protocol.conformance.findings import expect, require
from firmware_protocol.conformance.port import MS
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import ENABLE, Session
from firmware_protocol.frames import BROADCAST_NODE, Frame, arbitration_id
from firmware_protocol.messages import DriveState, FaultReason, Function, ParamOp
from firmware_protocol.parameters import BY_INDEX, Index

MIN_TIMEOUT_US, MAX_TIMEOUT_US = 1_000, 500_000  # of `watchdog_timeout_us` in the parameter dictionary


def expires(s: Session, timeout_us: int) -> int:
    """Hold the angle a while, fall silent, return how long after the last reference the drive faulted."""
    s.write(Index.HOST_HEARTBEAT_TIMEOUT, BY_INDEX[Index.HOST_HEARTBEAT_TIMEOUT].maximum)
    theta = s.operate()
    s.run(40 * MS)
    s.reference = None
    s.beating = False  # whether heartbeats feed it is another question
    s.fresh()
    last_ns = s.send_setpoint(theta)
    return s.time_of(DriveState.FAULT, last_ns, timeout_us * 1500 + 60 * MS)


@check(120, Need.MOTION)
def watchdog_timeout(s: Session) -> str:
    said = ""
    original = s.originals[Index.WATCHDOG_TIMEOUT]
    for timeout_us in dict.fromkeys((original, 50_000, *s.dense((5_000, 10_000, 100_000, 300_000), ()))):
        s.write(Index.WATCHDOG_TIMEOUT, timeout_us)
        elapsed = expires(s, timeout_us)
        expect(s.fault == FaultReason.WATCHDOG, f"{s.state_name()} after the references stopped")
        said = s.timeout(f"watchdog of {timeout_us} us", elapsed, timeout_us)
        s.beating = True
        s.reset()
    return said


@check(121, Need.MOTION)
def late_reference_does_not_help(s: Session) -> str:
    """At every phase of the sample period: a drive that looks at its watchdog only now and then shows at some."""
    timeout_us = 20_000
    s.write(Index.WATCHDOG_TIMEOUT, timeout_us)
    phases = s.dense(range(10), (0, 3, 6))
    gap_ns = timeout_us * 1000 + s.margins.jitter_ns
    for phase in phases:
        theta = s.operate()
        s.reference = None
        s.beating = False
        s.fresh()
        s.run(phase * s.period_ns // 10, tick_ns=s.period_ns // 10)
        first_ns = s.send_setpoint(theta)
        s.wait_until(first_ns + gap_ns)
        s.send_setpoint(theta)
        s.pause()
        expect(s.state == DriveState.FAULT, f"a reference {gap_ns / MS:.3f} ms after the last one saved it")
        s.beating = True
        s.disable()
    return f"references {gap_ns / MS:.3f} ms after the last one came too late at {len(phases)} phases"


def _feeds(s: Session, theta: int) -> dict[str, Callable[[], Frame]]:
    """What must not feed the watchdog."""
    other = (s.free_nodes() or [s.node % 30 + 1])[0]

    def beat() -> Frame:
        s.host_sequence = (s.host_sequence + 1) & 0xFF
        body = wire.heartbeat_body(ENABLE, 1, 0, s.host_sequence)
        return wire.sealed8(Function.HOST_HEARTBEAT, s.node, body)

    def next_one() -> Frame:
        return s.setpoint_frame(theta, s.setpoint_sequence + 1)

    return {
        "heartbeats": beat,
        "parameter requests": lambda: param_read(Function.PARAM_REQUEST, s.node),
        "DISCOVER": lambda: Frame(arbitration_id(Function.DISCOVER, BROADCAST_NODE), b""),
        "repeated references": lambda: s.setpoint_frame(theta, s.setpoint_sequence),
        "old references": lambda: s.setpoint_frame(theta, s.setpoint_sequence - 3),
        "references from old samples": lambda: s.setpoint_frame(theta, s.setpoint_sequence + 1, age=110),
        "damaged references": lambda: wire.damaged(next_one()),
        "references for others": lambda: wire.setpoint(
            s.fd, other, theta, s.setpoint_sequence + 1, s.measured().sequence
        ),
    }


@check(122, Need.MOTION)
def nothing_else_feeds_the_watchdog(s: Session) -> str:
    timeout_us = 50_000
    s.write(Index.WATCHDOG_TIMEOUT, timeout_us)
    kinds = list(_feeds(s, 0))
    for kind in kinds:
        theta = s.operate()
        s.run(10 * MS)
        s.reference = None
        feed = _feeds(s, theta)[kind]
        end_ns = s.now_ns() + 2 * timeout_us * 1000
        while s.now_ns() < end_ns and s.state != DriveState.FAULT:
            s.send(feed())
            s.run(3 * MS, lambda: s.state == DriveState.FAULT)
        expect(s.observe() == DriveState.FAULT, f"{kind} kept it OPERATIONAL")
        s.reset()
    return f"WATCHDOG in spite of {', '.join(kinds)}"


@check(123, Need.MOTION)
def torque_gone_after_the_watchdog(s: Session) -> str:
    """The last reference is a step, so current flows when the time is over, and none may a millisecond later."""
    timeout_us = 5_000 if s.virtual else 10_000
    s.write(Index.MAX_STEP, max(s.margins.move_raw, s.originals[Index.MAX_STEP]))
    s.write(Index.WATCHDOG_TIMEOUT, timeout_us)
    theta = s.operate()
    s.reference = None
    s.send_setpoint(theta + room(s, theta, s.margins.move_raw))
    begin = len(s.samples)
    s.run(timeout_us * 2000 + 40 * MS)
    after = [x for x in s.samples[begin:] if x.state == DriveState.FAULT]
    expect(bool(after), f"no fault: {s.state_name()}")
    before = [x.current for x in s.samples[begin:] if x.state == DriveState.OPERATIONAL]
    peak = max(map(abs, before), default=0)
    require(peak > s.margins.idle_current_raw, f"a step of the reference gave a current of {peak} only")
    limit_us = 1000 + s.period_ns // 1000
    ages = [((x.stamp_us - after[0].stamp_us) & 0xFFFF_FFFF, x.current) for x in after]
    late = [(age, current) for age, current in ages if age >= limit_us and abs(current) > s.margins.idle_current_raw]
    expect(not late, f"current x 0.2 mA at us after the fault: {late[-1:]}")
    return f"current {before[-1]} at the timeout, none {limit_us} us after"


@check(124, Need.MOTION)
def watchdog_can_not_be_switched_off(s: Session) -> str:
    before = s.read(Index.WATCHDOG_TIMEOUT)
    for value in (0, 1, MIN_TIMEOUT_US - 1, MAX_TIMEOUT_US + 1, -1, -(1 << 31), (1 << 31) - 1):
        answer = s.request(ParamOp.WRITE, Index.WATCHDOG_TIMEOUT, value)
        refused = answer is not None and answer[0] == ParamOp.OUT_OF_RANGE
        s.touched(Index.WATCHDOG_TIMEOUT)
        expect(refused, f"a watchdog timeout of {value} us: {answer}")
        expect(s.read(Index.WATCHDOG_TIMEOUT) == before, f"the refused {value} us was taken all the same")
    for value in (MIN_TIMEOUT_US, MAX_TIMEOUT_US):
        answer = s.request(ParamOp.WRITE, Index.WATCHDOG_TIMEOUT, value)
        s.touched(Index.WATCHDOG_TIMEOUT)
        expect(answer == (ParamOp.OK, value), f"a watchdog timeout of {value} us: {answer}")
    expires(s, MAX_TIMEOUT_US)
    return "1 and 500 ms accepted, nothing beyond; at 500 ms it still acts"
