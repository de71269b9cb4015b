"""Physical layer and ids: HFP-002, HFP-010 to HFP-013."""

from collections.abc import Iterator

from firmware_protocol.conformance import wire
from firmware_protocol.conformance.findings import expect, require
from firmware_protocol.conformance.port import MS, Capability
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import ANSWER_NS, ENABLE, IDENTITY_NS, LOW, Session
from firmware_protocol.frames import BROADCAST_NODE, MAX_NODE, Frame, arbitration_id
from firmware_protocol.messages import DriveState, Function, ParamOp
from firmware_protocol.parameters import Index
from firmware_protocol.serial_framing import encode_serial

FUNCTIONS = 64
SLOWEST_BYTE_NS = 21_702  # ten bits at 460.8 kbit/s (HFP-167)


def quiet(s: Session, duration_ns: int) -> str:
    """Wait; return what the drive did since `Session.listen` that it does not do by itself, or nothing."""
    s.run(duration_ns)
    s.pause()
    if s.responses:
        return f"answered by {s.responses[0][1]}"
    if s.identities:
        return f"answered by {s.identities[0][1]}"
    return "" if s.state == DriveState.DISABLED else f"went to {s.state_name()}"


def line_time_ns(s: Session, frame: Frame) -> int:
    """Return how long the slowest serial line that there may be is busy with a frame; 0 where there is none."""
    return len(encode_serial(frame)) * SLOWEST_BYTE_NS if s.port.capabilities & Capability.SERIAL else 0


def param_read(function: int, node: int) -> Frame:
    """Ask for the node id, under any function."""
    return wire.sealed8(function, node, wire.param_body(ParamOp.READ, Index.NODE))


@check(2, Need.FOREIGN)
def foreign_frames_ignored(s: Session) -> str:
    node, before = s.node, s.rejected()
    discover = Frame(arbitration_id(Function.DISCOVER, BROADCAST_NODE), b"")
    estop = Frame(arbitration_id(Function.ESTOP, BROADCAST_NODE), b"")
    s.listen()
    for frame in (param_read(Function.PARAM_REQUEST, node), discover, estop):
        s.port.send_foreign(frame, remote=False)
        s.run(s.margins.gap_ns)
        s.port.send_foreign(frame._replace(data=b""), remote=True)
        found = quiet(s, IDENTITY_NS)
        expect(not found, f"extended or remote frame with the id {frame.arbitration_id:#05x}: {found}")
    expect(s.rejected() == before, "extended or remote frames were counted as rejected")
    return "no reaction to PARAM_REQUEST, DISCOVER and ESTOP with extended ids or as remote frames"


@check(10)
def only_the_functions_of_the_table(s: Session) -> str:
    tried = [
        f
        for f in range(FUNCTIONS)
        if f not in wire.DRIVE_FUNCTIONS and f not in (Function.ESTOP, Function.DISCOVER, Function.PARAM_REQUEST)
    ]
    s.listen()
    for function in tried:
        s.send(param_read(function, s.node))
        s.run(s.margins.gap_ns)
    found = quiet(s, ANSWER_NS)
    expect(not found, f"a request under a function that is not PARAM_REQUEST: {found}")
    expect(s.request(ParamOp.READ, Index.NODE) is not None, "no answer under the right function")
    findings = s.monitor.findings(10)
    expect(not findings, findings)
    return f"{len(tried)} other functions without reaction; all that the drive sent had ids of the table"


@check(11)
def every_node_id(s: Session) -> str:
    reported = s.read(Index.NODE)
    expect(reported == s.node, f"the drive at node {s.node} says that it is node {reported}")
    nodes = s.free_nodes()
    for node in s.dense(tuple(nodes), tuple({nodes[0], nodes[-1], nodes[len(nodes) // 2]}) if nodes else ()):
        s.send(wire.sealed8(Function.ASSIGN_NODE, BROADCAST_NODE, wire.assign_body(s.serial_number, node)))
        s.run(s.margins.gap_ns)
        s.follow(node)
        expect(s.request(ParamOp.READ, Index.NODE) == (ParamOp.OK, node), f"not reachable as node {node}")
    return f"reachable as each of {len(nodes)} free node ids and its own"


def _to_others(s: Session, node: int) -> Iterator[Frame]:
    """Everything that would have an effect if it were meant for this drive."""
    yield param_read(Function.PARAM_REQUEST, node)
    if node != BROADCAST_NODE:
        yield Frame(arbitration_id(Function.DISCOVER, node), b"")
    for control in (LOW, ENABLE):
        s.host_sequence = (s.host_sequence + 1) & 0xFF
        yield wire.sealed8(Function.HOST_HEARTBEAT, node, wire.heartbeat_body(control, 1, 0, s.host_sequence))
    yield wire.setpoint(False, node, s.measured().theta_m, 1, s.measured().sequence)
    if node != BROADCAST_NODE:
        yield Frame(arbitration_id(Function.ESTOP, node), b"")


@check(12)
def nothing_done_for_others(s: Session) -> str:
    free = s.free_nodes()
    nodes = (BROADCAST_NODE, *s.dense(tuple(free), tuple(free[:1] + free[-1:])), MAX_NODE + 1)
    s.listen()
    for node in nodes:
        sequence = s.host_sequence
        for frame in _to_others(s, node):
            s.send(frame)
            s.run(s.margins.gap_ns)
        s.host_sequence = sequence
        found = quiet(s, IDENTITY_NS if node in nodes[:2] else 0)
        expect(not found, f"messages to node {node}: {found}")
    body = wire.assign_body(s.serial_number, s.node)
    s.send(wire.sealed8(Function.ASSIGN_NODE, s.node, body))
    found = quiet(s, IDENTITY_NS)
    expect(not found, f"ASSIGN_NODE to node {s.node} instead of 0: {found}")
    return f"no reaction to messages for {len(nodes)} other node ids"


@check(13)
def frames_for_others_not_counted(s: Session) -> str:
    before = s.rejected()
    free = s.free_nodes()
    require(bool(free), "every node id is taken")
    sent = 0
    for node in s.dense(tuple(free), tuple(free[:2])):
        for frame in (
            wire.damaged(param_read(Function.PARAM_REQUEST, node)),
            Frame(arbitration_id(Function.HOST_HEARTBEAT, node), bytes(3)),
            wire.damaged(wire.setpoint(False, node, 0, 0, 0)),
        ):
            s.send(frame)
            s.run(s.margins.gap_ns)
            sent += 1
    for function in (0x01, 0x07, 0x2F, 0x3E):
        s.send(Frame(arbitration_id(function, s.node), bytes(8)))
        s.run(s.margins.gap_ns)
        sent += 1
    s.run(5 * MS)
    grown = s.rejected() - before
    expect(grown == 0, f"{sent} damaged frames for others, and rejected grew by {grown}")
    return f"{sent} damaged frames for others not counted"
