"""Heartbeats: HFP-081 to HFP-086, HFP-088."""

from collections.abc import Callable
from itertools import pairwise

from firmware_protocol.conformance import wire
from firmware_protocol.conformance.checks.sequences import taken
from firmware_protocol.conformance.findings import expect, require
from firmware_protocol.conformance.port import MS
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import ENABLE, IDENTITY_NS, LOW, RESET, Session
from firmware_protocol.frames import Frame, arbitration_id
from firmware_protocol.messages import DriveState, FaultReason, Function, ParamOp
from firmware_protocol.parameters import Index

CHANGE_NS = 5 * MS
REJECTED_MAX = 0xFFFF


def intervals(s: Session, state: DriveState, period_ns: int, count: int = 4) -> list[int]:
    """Return the intervals of DRIVE_HEARTBEAT, far from any change of state; their arrival is judged."""
    s.run(20 * MS)
    begin = len(s.beats)
    s.run((count + 1) * period_ns + 2 * s.margins.line_ns)
    times = [time_ns for time_ns, beat in s.beats[begin:] if beat.state == state]
    expect(len(times) >= count, f"{len(times)} DRIVE_HEARTBEAT in {state.name} in {count + 1} periods")
    return [b - a for a, b in pairwise(times)]


def judge_intervals(s: Session, state: DriveState, period_ns: int) -> None:
    """Compare the intervals with the period: one more poll and the line are granted."""
    slack_ns = period_ns * s.margins.clock_ppm // 1_000_000 + s.margins.line_ns
    for measured_ns in intervals(s, state, period_ns):
        high_ns = period_ns + slack_ns + s.margins.granularity_ns
        s.timing(
            f"DRIVE_HEARTBEAT in {state.name}", measured_ns, period_ns - slack_ns - s.margins.granularity_ns, high_ns
        )


@check(81)
def drive_heartbeat_each_period(s: Session) -> str:
    period_ns = s.originals[Index.HEARTBEAT_PERIOD] * 1000
    judge_intervals(s, DriveState.DISABLED, period_ns)
    s.arm()
    judge_intervals(s, DriveState.ARMED, period_ns)
    s.disable()
    s.fail()
    judge_intervals(s, DriveState.FAULT, period_ns)
    s.reset()
    return f"each {period_ns // MS} ms in DISABLED, ARMED and FAULT"


@check(81, Need.MOTION)
def drive_heartbeat_in_operational(s: Session) -> str:
    period_ns = s.originals[Index.HEARTBEAT_PERIOD] * 1000
    s.operate()
    judge_intervals(s, DriveState.OPERATIONAL, period_ns)
    return f"each {period_ns // MS} ms in OPERATIONAL"


def _announced(s: Session, change: Callable[[], int], state: DriveState) -> int:
    """Judge one change of state; return 0 when there was none, which is for others to judge."""
    s.run(20 * MS)
    s.beats.clear()
    sent_ns = change()
    s.run(CHANGE_NS + s.margins.line_ns + MS, lambda: any(beat.state == state for _, beat in s.beats))
    times = [time_ns for time_ns, beat in s.beats if beat.state == state]
    if s.observe() != state:
        return 0
    expect(bool(times), f"no DRIVE_HEARTBEAT after the change to {state.name}")
    s.timing(f"DRIVE_HEARTBEAT after the change to {state.name}", times[0] - sent_ns, 0, CHANGE_NS + s.margins.line_ns)
    return 1


@check(82)
def change_of_state_is_announced(s: Session) -> str:
    changes = 0
    for _ in range(3):
        s.heartbeat(LOW)
        changes += _announced(s, lambda: s.heartbeat(ENABLE), DriveState.ARMED)
        changes += _announced(s, lambda: s.heartbeat(LOW), DriveState.DISABLED)
        changes += _announced(s, s.estop, DriveState.FAULT)
        s.heartbeat(LOW)
        changes += _announced(s, lambda: s.heartbeat(RESET), DriveState.DISABLED)
    require(changes > 0, "its state does not change")
    return f"{changes} changes between DISABLED, ARMED and FAULT announced"


@check(82, Need.MOTION)
def operational_is_announced(s: Session) -> str:
    s.arm()
    s.run(20 * MS)

    def first_reference() -> int:
        s.fresh()
        s.reference = s.measured().theta_m
        return s.send_setpoint(s.reference)

    changes = _announced(s, first_reference, DriveState.OPERATIONAL)
    changes += _announced(s, lambda: s.heartbeat(LOW), DriveState.DISABLED)
    require(changes > 0, "its state does not change")
    return "changes to and from OPERATIONAL announced"


@check(83)
def old_heartbeats_dropped(s: Session) -> str:
    s.beating = False
    for advance in s.dense(range(-31, 1), (0, -1, -2, -31)):
        expect(not taken(s, advance), f"HOST_HEARTBEAT with a sequence {-advance} behind was taken")
    return "HOST_HEARTBEAT with sequences repeated or up to 31 behind dropped"


def host_lost(s: Session, last_beat_ns: int, timeout_us: int, where: str) -> str:
    """Judge the fault after the last heartbeat."""
    elapsed = s.time_of(DriveState.FAULT, last_beat_ns, timeout_us * 1500 + 60 * MS)
    expect(s.fault == FaultReason.HOST_HEARTBEAT_LOST, f"{s.state_name()} after the host fell silent in {where}")
    return s.timeout(f"host heartbeat timeout of {timeout_us} us in {where}", elapsed, timeout_us)


@check(84)
def host_timeout_in_armed(s: Session) -> str:
    said = ""
    original = s.originals[Index.HOST_HEARTBEAT_TIMEOUT]
    for timeout_us in dict.fromkeys((original, *s.dense((10_000, 50_000, 300_000), (50_000,)))):
        s.write(Index.HOST_HEARTBEAT_TIMEOUT, timeout_us)
        s.beating = False
        s.silence()
        said = host_lost(s, s.arm(), timeout_us, "ARMED")
        s.beating = True
        s.reset()
    return said


@check(84, Need.MOTION)
def host_timeout_in_operational(s: Session) -> str:
    timeout_us = s.originals[Index.HOST_HEARTBEAT_TIMEOUT]
    s.write(Index.HOST_HEARTBEAT_TIMEOUT, timeout_us)
    s.operate()
    s.beating = False
    last_ns = s.heartbeat(ENABLE)
    return host_lost(s, last_ns, timeout_us, "OPERATIONAL")


def starts_over(s: Session, where: str) -> None:
    """Judge the first heartbeat after the host was lost: taken whatever its sequence, and ENABLE does not rise."""
    s.beating = False
    before = s.rejected()
    s.heartbeat(ENABLE, advance=-5)
    expect(s.rejected() == before, f"the first heartbeat {where}, 5 behind, was dropped")
    expect(s.observe() == DriveState.DISABLED, f"ENABLE high in the first heartbeat {where}: {s.state_name()}")
    s.heartbeat(LOW)
    s.heartbeat(ENABLE)
    expect(s.wait_state(DriveState.ARMED), f"ENABLE that fell and rose {where} did not arm: {s.state_name()}")
    s.disable()


@check(85)
def host_starts_over(s: Session) -> str:
    s.write(Index.HOST_HEARTBEAT_TIMEOUT, 50_000)
    s.heartbeat(LOW)
    s.silence()
    starts_over(s, "after a silence in DISABLED")
    s.fail()
    s.silence()
    before = s.rejected()
    s.heartbeat(RESET, advance=-5)
    expect(s.rejected() == before, "the first heartbeat after a silence in FAULT, 5 behind, was dropped")
    expect(s.observe() == DriveState.FAULT, "FAULT_RESET high in the first heartbeat after a silence reset the fault")
    s.reset()
    nodes = s.free_nodes()
    if nodes:
        s.heartbeat(LOW)
        s.beating = False
        body = wire.assign_body(s.serial_number, nodes[0])
        s.send(wire.sealed8(Function.ASSIGN_NODE, 0, body))
        s.run(s.margins.gap_ns)
        s.follow(nodes[0])
        starts_over(s, "after a change of node")
    return "after silence in DISABLED and FAULT, and after a change of node"


@check(88)
def host_starts_over_on_the_same_node(s: Session) -> str:
    s.heartbeat(LOW)
    s.beating = False
    s.listen()
    s.send(wire.sealed8(Function.ASSIGN_NODE, 0, wire.assign_body(s.serial_number, s.node)))
    answered = s.run(IDENTITY_NS + s.margins.line_ns, lambda: bool(s.identities))
    expect(answered, f"no IDENTITY after ASSIGN_NODE to {s.node}, which it is")
    starts_over(s, "after ASSIGN_NODE to the node that it is")
    return "answered, the next sequence taken, control bits high before it"


def _told(s: Session) -> tuple[int, int]:
    """Return `rejected` of the next DRIVE_HEARTBEAT and of the parameter."""
    s.beats.clear()
    s.run(2 * s.originals[Index.HEARTBEAT_PERIOD] * 1000 + 20 * MS, lambda: bool(s.beats))
    require(bool(s.beats), "no DRIVE_HEARTBEAT")
    return s.beats[-1][1].rejected, s.rejected()


@check(86)
def rejected_is_told(s: Session) -> str:
    for _ in range(300 if s.thorough else 30):
        s.send(Frame(arbitration_id(Function.PARAM_REQUEST, s.node), b""))
        s.run(s.margins.gap_ns)
    told, counted = _told(s)
    expect(told == min(counted, REJECTED_MAX), f"DRIVE_HEARTBEAT says {told}, the parameter {counted}")
    return f"DRIVE_HEARTBEAT and parameter agree on {counted}"


@check(86, last=True)
def rejected_saturates(s: Session) -> str:
    """A flood of the shortest frames there are, until 65535 are dropped; at the end, because it can't be undone."""
    start_ns, sent = s.now_ns(), 0
    counted = s.rejected()
    shortest = Frame(arbitration_id(Function.PARAM_REQUEST, s.node), b"")
    while counted <= REJECTED_MAX:
        require(
            s.now_ns() - start_ns < s.margins.flood_ns,
            f"{counted} frames dropped after {s.margins.flood_ns // MS} ms of flood; 65536 are needed (--flood-s)",
        )
        for _ in range(min(REJECTED_MAX + 1 - counted, 2000)):
            s.send(shortest)
            sent += 1
            if sent % 16 == 0:
                s.run(0)
        s.run(20 * MS)
        # A line that takes frames faster than it brings them has them all to bring first.
        answer = s.request(ParamOp.READ, Index.REJECTED, 0, max(0, start_ns + s.margins.flood_ns - s.now_ns()))
        require(answer is not None, "no answer to what was asked after a flood")
        assert answer is not None
        counted = answer[1]
    told, counted = _told(s)
    expect(told == REJECTED_MAX, f"DRIVE_HEARTBEAT says {told} after {counted} dropped frames")
    expect(s.observe() == DriveState.DISABLED, f"{s.state_name()} after the flood")
    expect(s.request(ParamOp.READ, Index.NODE) == (ParamOp.OK, s.node), "no answer after the flood")
    return f"65535 after {counted} dropped frames, {sent} of them in one flood"
