"""Faults and emergency stop: HFP-130 to HFP-134, HFP-140 to HFP-142."""

from collections.abc import Iterator

from firmware_protocol.conformance.findings import expect
from firmware_protocol.conformance.port import MS, Capability
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import ENABLE, LOW, RESET, Session
from firmware_protocol.frames import BROADCAST_NODE, Frame, arbitration_id
from firmware_protocol.messages import DriveState, FaultReason, Function, ParamOp
from firmware_protocol.parameters import Index

FD_PAYLOADS = (0, 1, 8, 12, 64)


def still_faulty(s: Session, reason: FaultReason, why: str) -> None:
    """Expect FAULT with this reason."""
    s.pause()
    expect(s.state == DriveState.FAULT and s.fault == reason, f"{why}: {s.state_name()}")


@check(130)
def only_a_reset_leaves_fault(s: Session) -> str:
    s.write(Index.HOST_HEARTBEAT_TIMEOUT, 100_000)
    s.fail()
    for control in (LOW, ENABLE, LOW, ENABLE, ENABLE, LOW):
        s.heartbeat(control)
        expect(s.observe() == DriveState.FAULT, f"ENABLE {'high' if control else 'low'}: {s.state_name()}")
    s.fresh()
    s.send_setpoint(s.measured().theta_m)
    s.request(ParamOp.WRITE, Index.MAX_STEP, 1000)
    s.touched(Index.MAX_STEP)
    s.send(Frame(arbitration_id(Function.DISCOVER, s.node), b""))
    s.run(40 * MS)
    expect(s.observe() == DriveState.FAULT, f"a reference, a WRITE and DISCOVER: {s.state_name()}")
    s.silence()
    expect(s.observe() == DriveState.FAULT, f"silence of the host: {s.state_name()}")
    s.reset()
    return "ENABLE, references, requests, DISCOVER and silence leave FAULT as it is; a rising FAULT_RESET does not"


@check(131)
def first_reason_is_kept(s: Session) -> str:
    s.write(Index.HOST_HEARTBEAT_TIMEOUT, 100_000)
    s.fail()
    s.heartbeat(LOW)
    s.heartbeat(ENABLE, major=2)
    still_faulty(s, FaultReason.ESTOP, "another major version in FAULT")
    s.heartbeat(LOW)
    s.silence()
    still_faulty(s, FaultReason.ESTOP, "loss of the host in FAULT")
    s.reset()
    s.heartbeat(ENABLE, major=2)
    still_faulty(s, FaultReason.VERSION, "another major version")
    s.heartbeat(LOW)
    s.silence()
    still_faulty(s, FaultReason.VERSION, "loss of the host in FAULT")
    s.reset()
    return "ESTOP and VERSION kept through other events"


@check(132)
def reset_leads_to_disabled(s: Session) -> str:
    for before, at in ((LOW, RESET), (LOW, RESET | ENABLE), (ENABLE, RESET | ENABLE), (ENABLE, RESET)):
        s.fail()
        s.heartbeat(LOW)
        s.heartbeat(before)
        s.heartbeat(at)
        s.pause()
        fits = s.state == DriveState.DISABLED and s.fault == FaultReason.NONE
        expect(fits, f"control bits {before:#x}, then {at:#x} in FAULT: {s.state_name()}")
        s.heartbeat(LOW)
    return "DISABLED and NONE, with ENABLE low, high before, and rising in the same heartbeat"


@check(133)
def enable_must_fall_after_a_reset(s: Session) -> str:
    s.fail()
    s.heartbeat(LOW)
    s.heartbeat(ENABLE)
    s.heartbeat(ENABLE | RESET)
    s.heartbeat(ENABLE)
    s.heartbeat(ENABLE)
    expect(s.observe() == DriveState.DISABLED, f"ENABLE that stayed high over a reset: {s.state_name()}")
    s.heartbeat(LOW)
    s.heartbeat(ENABLE)
    expect(s.wait_state(DriveState.ARMED), f"ENABLE that fell and rose after a reset: {s.state_name()}")
    return "armed only after ENABLE fell and rose"


@check(134)
def reset_that_stays_high_resets_nothing(s: Session) -> str:
    s.fail()
    s.heartbeat(LOW)
    s.heartbeat(RESET)
    s.heartbeat(RESET)
    s.fail()
    for _ in range(5):
        s.heartbeat(RESET)
        still_faulty(s, FaultReason.ESTOP, "FAULT_RESET that stayed high")
    s.reset()
    return "a later fault outlives a FAULT_RESET that stays high"


def estops(s: Session) -> Iterator[Frame]:
    """ESTOP in every shape: to this node and to all, any payload, both formats where the line has them."""
    for node in (s.node, BROADCAST_NODE):
        identifier = arbitration_id(Function.ESTOP, node)
        for length in s.dense(range(9), (0, 1, 8)):
            yield Frame(identifier, b"\xa5" * length)
        if s.port.capabilities & Capability.FD:
            for length in FD_PAYLOADS:
                yield Frame(identifier, b"\x5a" * length, True)


def _stops(s: Session, frame: Frame, where: str) -> None:
    s.reference = None
    s.send(frame)
    stopped = s.wait_state(DriveState.FAULT) and s.fault == FaultReason.ESTOP
    shape = f"id {frame.arbitration_id:#05x}, {len(frame.data)} bytes, fd {frame.is_fd}"
    expect(stopped, f"ESTOP ({shape}) in {where}: {s.state_name()}")
    s.reset()


@check(140)
def estop_always_stops(s: Session) -> str:
    shapes = list(estops(s))
    for frame in shapes:
        _stops(s, frame, "DISABLED")
        s.arm()
        _stops(s, frame, "ARMED")
    return f"{len(shapes)} shapes of ESTOP in DISABLED and ARMED"


@check(140, Need.MOTION)
def estop_stops_in_operational(s: Session) -> str:
    shapes = list(estops(s))
    for frame in shapes if s.thorough else shapes[::3] + shapes[-1:]:
        s.operate()
        _stops(s, frame, "OPERATIONAL")
    return "ESTOP in OPERATIONAL"


@check(141)
def estop_in_fault_keeps_the_reason(s: Session) -> str:
    s.heartbeat(LOW)
    s.heartbeat(ENABLE, major=2)
    still_faulty(s, FaultReason.VERSION, "another major version")
    for node in (s.node, BROADCAST_NODE):
        s.send(Frame(arbitration_id(Function.ESTOP, node), b""))
        still_faulty(s, FaultReason.VERSION, f"ESTOP to node {node} in FAULT")
    s.reset()
    return "VERSION kept through ESTOP"


@check(142)
def estop_without_heartbeat(s: Session) -> str:
    s.write(Index.HOST_HEARTBEAT_TIMEOUT, 50_000)
    s.silence()
    s.beating = False
    for _ in range(2):
        s.estop()
        stopped = s.wait_state(DriveState.FAULT) and s.fault == FaultReason.ESTOP
        expect(stopped, f"ESTOP without heartbeats: {s.state_name()}")
        s.beating = True
        s.reset()
        s.beating = False
        s.silence()
    s.run(5 * MS)
    return "ESTOP acts when no host is there"
