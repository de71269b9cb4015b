"""Discovery: HFP-060 to HFP-066, HFP-068."""

from firmware_protocol.conformance import wire
from firmware_protocol.conformance.findings import expect, require
from firmware_protocol.conformance.port import MS
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import IDENTITY_NS, Session
from firmware_protocol.drive.discovery import identity_delay_us
from firmware_protocol.frames import BROADCAST_NODE, MAX_NODE, Frame, arbitration_id
from firmware_protocol.messages import Function, Identity, ParamOp
from firmware_protocol.parameters import Index

ROUNDS = 16
MAX_ASSIGN_ANSWER_NS = 5 * MS


def ask(s: Session, node: int) -> int:
    """Send DISCOVER; return when."""
    s.identities.clear()
    return s.send(Frame(arbitration_id(Function.DISCOVER, node), b""))


def answers(s: Session) -> list[tuple[int, Identity]]:
    """Return the answers of this drive, with their times."""
    own = s.identity
    return [a for a in s.identities if own is not None and a[1].serial_number == own.serial_number]


def _answered(s: Session, where: str) -> None:
    for node in (BROADCAST_NODE, s.node):
        sent_ns = ask(s, node)
        s.run(IDENTITY_NS + s.margins.line_ns + MS, lambda: bool(answers(s)))
        expect(bool(answers(s)), f"no answer to DISCOVER to node {node} in {where}")
        s.timing(f"IDENTITY in {where}", answers(s)[0][0] - sent_ns, 0, IDENTITY_NS + s.margins.line_ns)


@check(60)
def discovered_in_every_state(s: Session) -> str:
    _answered(s, "DISABLED")
    s.arm()
    _answered(s, "ARMED")
    s.disable()
    s.fail()
    _answered(s, "FAULT")
    s.reset()
    return "answered in DISABLED, ARMED and FAULT"


@check(60, Need.MOTION)
def discovered_in_operational(s: Session) -> str:
    s.operate()
    _answered(s, "OPERATIONAL")
    return "answered in OPERATIONAL"


@check(61)
def answer_waits_as_its_number_says(s: Session) -> str:
    """How many answers came before is not known: one of the 256 counts must explain all delays."""
    delays = [_delay(s) for _ in range(ROUNDS)]
    said = ", ".join(f"{delay / MS:.2f}" for delay in delays)
    return f"delays in ms, from answer {_first_count(s, delays)} on: {said}"


def _delay(s: Session) -> int:
    """Send DISCOVER; return how long the answer took."""
    sent_ns = ask(s, BROADCAST_NODE)
    s.run(IDENTITY_NS + s.margins.line_ns + MS, lambda: bool(answers(s)))
    require(bool(answers(s)), "no answer to DISCOVER")
    delay_ns = answers(s)[0][0] - sent_ns
    s.run(2 * MS)
    return delay_ns


def _first_count(s: Session, delays: list[int]) -> int:
    """Return the number of answers before the first of these that explains them all; Violation when none does."""
    late_ns = MS + s.margins.line_ns

    def explains(count: int) -> bool:
        wanted = (1000 * identity_delay_us(s.serial_number, count + i) for i in range(len(delays)))
        return all(0 <= delay - due <= late_ns for delay, due in zip(delays, wanted, strict=True))

    counts = [count for count in range(256) if explains(count)]
    said = ", ".join(f"{delay / MS:.2f}" for delay in delays)
    expect(bool(counts), f"no count of answers explains the delays in ms: {said}")
    return counts[0]


@check(62)
def one_answer_at_a_time(s: Session) -> str:
    clear = 0
    for _ in range(40):
        sent_ns = ask(s, BROADCAST_NODE)
        for _ in range(3):
            s.run(s.margins.gap_ns)
            last_ns = s.send(Frame(arbitration_id(Function.DISCOVER, s.node), b""))
        s.run(s.margins.gap_ns)
        s.request(ParamOp.READ, Index.NODE)
        s.run(2 * IDENTITY_NS + s.margins.line_ns)
        got = answers(s)
        require(bool(got), "no answer to DISCOVER")
        # On a line that is slow for a moment, what was asked after them and answered before proves the same.
        answered_ns = s.responses[0][0] if s.responses else got[0][0]
        if got[0][0] < last_ns + s.margins.line_ns and got[0][0] <= answered_ns:
            continue  # it answered before it had them all
        clear += 1
        expect(len(got) == 1, f"{len(got)} answers to four DISCOVER within {(last_ns - sent_ns) / MS:.1f} ms")
        if clear == 5:
            break
    require(clear > 0, "it always answered too soon")
    return f"one answer to four DISCOVER, {clear} times"


def _assign(s: Session, node: int, serial_number: int) -> int:
    s.identities.clear()
    return s.send(wire.sealed8(Function.ASSIGN_NODE, BROADCAST_NODE, wire.assign_body(serial_number, node)))


@check(68)
def assignments_are_no_answers(s: Session) -> str:
    home, other = s.node, _free(s)
    delays = []
    for number in range(ROUNDS):
        _assign(s, home if number % 2 else other, s.serial_number)
        s.follow(home if number % 2 else other)
        s.run(IDENTITY_NS + s.margins.line_ns, lambda: bool(answers(s)))
        require(bool(answers(s)), "no IDENTITY after ASSIGN_NODE")
        delays.append(_delay(s))
    first = _first_count(s, delays)
    return f"{ROUNDS} ASSIGN_NODE between answers {first} to {(first + ROUNDS - 1) % 256} to DISCOVER"


def _free(s: Session) -> int:
    nodes = s.free_nodes()
    require(bool(nodes), "every node id is taken")
    return nodes[len(nodes) // 2]


@check(63)
def assigned_node_is_taken(s: Session) -> str:
    old, new = s.node, _free(s)
    for node in (new, old):
        before = s.node
        sent_ns = _assign(s, node, s.serial_number)
        s.follow(node)
        s.run(MAX_ASSIGN_ANSWER_NS + s.margins.line_ns + MS, lambda: bool(answers(s)))
        expect(bool(answers(s)), f"no IDENTITY after ASSIGN_NODE to {node}")
        time_ns, identity = answers(s)[0]
        expect(identity.node == node, f"IDENTITY from node {identity.node} after ASSIGN_NODE to {node}")
        s.timing("IDENTITY after ASSIGN_NODE", time_ns - sent_ns, 0, MAX_ASSIGN_ANSWER_NS + s.margins.line_ns)
        answer = s.request(ParamOp.READ, Index.NODE)
        expect(answer == (ParamOp.OK, node), f"as node {node} it answers {answer}")
        s.follow(before)
        expect(s.request(ParamOp.READ, Index.NODE) is None, f"it still answers as node {before}")
        s.follow(node)
    return f"node {old} to {new} and back, each with IDENTITY from there"


def _refused(s: Session, node: int, why: str) -> None:
    before = s.rejected()
    _assign(s, node, s.serial_number)
    s.run(MAX_ASSIGN_ANSWER_NS)
    expect(not answers(s), f"ASSIGN_NODE to {node} {why} was answered")
    answer = s.request(ParamOp.READ, Index.NODE)
    expect(answer == (ParamOp.OK, s.node), f"ASSIGN_NODE to {node} {why}: as node {s.node} it answers {answer}")
    grown = s.rejected() - before
    expect(grown == 1, f"ASSIGN_NODE to {node} {why}: rejected grew by {grown}")


@check(64)
def assign_refused_unless_disabled(s: Session) -> str:
    node = _free(s)
    s.arm()
    _refused(s, node, "in ARMED")
    s.disable()
    s.fail()
    _refused(s, node, "in FAULT")
    s.reset()
    return "refused and counted in ARMED and FAULT"


@check(64, Need.MOTION)
def assign_refused_in_operational(s: Session) -> str:
    s.operate()
    _refused(s, _free(s), "in OPERATIONAL")
    return "refused and counted in OPERATIONAL"


@check(65)
def impossible_node_refused(s: Session) -> str:
    nodes = s.dense((0, *range(MAX_NODE + 1, 256)), (0, 31, 32, 127, 128, 255))
    for node in nodes:
        _refused(s, node, "")
    return f"{len(nodes)} impossible node ids refused and counted"


@check(66)
def assign_for_another_ignored(s: Session) -> str:
    node, before = _free(s), s.rejected()
    bits = s.dense(range(48), (0, 23, 24, 47))
    for bit in bits:
        _assign(s, node, s.serial_number ^ 1 << bit)
        s.run(s.margins.gap_ns)
    s.run(MAX_ASSIGN_ANSWER_NS)
    expect(not answers(s), "ASSIGN_NODE for another serial number was answered")
    answer = s.request(ParamOp.READ, Index.NODE)
    expect(answer == (ParamOp.OK, s.node), f"ASSIGN_NODE for another: as node {s.node} it answers {answer}")
    grown = s.rejected() - before
    expect(grown == 0, f"ASSIGN_NODE for another: rejected grew by {grown}")
    return f"{len(bits)} serial numbers that differ in one bit ignored"
