"""Sequences: HFP-040 to HFP-043, HFP-046."""

from firmware_protocol.conformance.checks.frames import walk
from firmware_protocol.conformance.findings import expect, require
from firmware_protocol.conformance.port import MS
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import ENABLE, LOW, Session
from firmware_protocol.messages import DriveState, Function
from firmware_protocol.parameters import Index
from firmware_protocol.states import MAX_SEQUENCE_ADVANCE


@check(40, last=True)
def sequences_grow_by_one(s: Session) -> str:
    walk(s)
    measurement = Function.FD_FEEDBACK if s.fd else Function.FEEDBACK
    for function in (measurement, Function.DRIVE_HEARTBEAT):
        found = s.monitor.out_of_step(function)
        expect(not found, found)
    return f"{s.monitor.seen[measurement]} measurements and {s.monitor.seen[Function.DRIVE_HEARTBEAT]} heartbeats"


@check(41, last=True)
def halves_share_a_sequence(s: Session) -> str:
    walk(s)
    for function in (Function.TIMING, Function.BENCH_SENSOR):
        found = s.monitor.out_of_step(function)
        expect(not found, found)
    return f"{s.monitor.seen[Function.TIMING]} TIMING and {s.monitor.seen[Function.BENCH_SENSOR]} BENCH_SENSOR"


def taken(s: Session, advance: int) -> bool:
    """Tell whether the drive takes a HOST_HEARTBEAT of this advance: whether its ENABLE arms."""
    s.heartbeat(LOW)
    before = s.host_sequence
    s.heartbeat(ENABLE, advance & 0xFF)
    armed = s.observe() == DriveState.ARMED
    if not armed:
        s.host_sequence = before
    s.disable()
    return armed


@check(42)
def new_is_1_to_127_ahead(s: Session) -> str:
    s.beating = False
    for advance in s.dense(range(1, 256 - 32), (1, 2, 64, 126, 127, 128, 129, 192)):
        wanted = advance <= MAX_SEQUENCE_ADVANCE
        found = taken(s, advance)
        expect(found == wanted, f"a sequence {advance} ahead was {'taken' if found else 'dropped'}")
    return "HOST_HEARTBEAT 1 to 127 ahead taken, 128 to 223 ahead dropped"


@check(43, Need.MOTION)
def echo_of_the_last_accepted(s: Session) -> str:
    theta = s.operate()
    s.reference = None
    s.pause()
    expect(s.measured().echo == s.setpoint_sequence, "the first reference, taken in ARMED, is not echoed")
    for advance in s.dense(range(1, 120, 7), (1, 100)):
        s.fresh()
        s.send_setpoint(theta, advance)
        s.pause()
        echo = s.measured().echo
        expect(echo == s.setpoint_sequence, f"{s.setpoint_sequence} was sent and {echo} echoed")
        s.send(s.setpoint_frame(theta, s.setpoint_sequence - 3))
        s.send(s.setpoint_frame(theta, s.setpoint_sequence + 1, age=120))
        s.pause()
        echo = s.measured().echo
        expect(echo == s.setpoint_sequence, f"{echo} was echoed, which was not accepted")
    return "echo follows accepted references and no others"


@check(46, Need.MOTION)
def skipped_sequences_are_counted(s: Session) -> str:
    theta = s.operate()
    for skipped in s.dense((0, 1, 2, 7, 8, 9, 63, 100, 126), (0, 1, 9, 126)):
        s.reference = None
        before = s.read(Index.SETPOINTS_LOST)
        s.fresh()
        s.send_setpoint(theta, skipped + 1)
        s.run(s.margins.gap_ns)
        grown = s.read(Index.SETPOINTS_LOST) - before
        expect(grown == skipped, f"{skipped} sequences skipped, and setpoints_lost grew by {grown}")
    lost = s.read(Index.SETPOINTS_LOST)
    s.reference = theta
    s.beats.clear()
    s.run(2 * s.originals[Index.HEARTBEAT_PERIOD] * 1000 + 10 * MS, lambda: bool(s.beats))
    require(bool(s.beats), "no DRIVE_HEARTBEAT")
    told = s.beats[-1][1].setpoints_lost
    expect(told == s.read(Index.SETPOINTS_LOST) & 0xFF, f"DRIVE_HEARTBEAT says {told}, the parameter {lost}")
    return "setpoints_lost grows by what was skipped"
