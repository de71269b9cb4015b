"""Parameter access: HFP-150 to HFP-159."""

from firmware_protocol.conformance import wire
from firmware_protocol.conformance.checks.heartbeats import judge_intervals
from firmware_protocol.conformance.findings import expect
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import ANSWER_NS, Session
from firmware_protocol.messages import DriveState, Function, ParamOp
from firmware_protocol.parameters import BY_INDEX, DICTIONARY, INT32_MAX, INT32_MIN, Access, Index, Parameter

WRITABLE = tuple(row for row in DICTIONARY if row.access is not Access.READ_ONLY)
COUNTED = (Index.REJECTED, Index.SETPOINTS_ACCEPTED, Index.SETPOINTS_LOST)
Answer = tuple[int, int] | None


def result_of(answer: Answer) -> int | None:
    """Return the result of an answer, None when there was none."""
    return None if answer is None else answer[0]


def unknown_indices(s: Session) -> tuple[int, ...]:
    """Return indices that the dictionary does not have: all near those it has, and some of the others."""
    near = {known + step for known in BY_INDEX for step in (-1, 1)} | {1 << bit for bit in range(16)} | {0, 0xFFFF}
    swapped = {(known & 0xFF) << 8 | known >> 8 for known in BY_INDEX}
    many = near | swapped | set(range(0, 0x500, 3)) | set(range(0, 0x10000, 509)) if s.thorough else near
    return tuple(sorted(i for i in many if 0 <= i <= 0xFFFF and i not in BY_INDEX))


@check(150)
def one_answer_to_each_request(s: Session) -> str:
    for row in DICTIONARY:
        for op in (ParamOp.READ, 0x7F):
            s.responses.clear()
            sent_ns = s.send(wire.sealed8(Function.PARAM_REQUEST, s.node, wire.param_body(op, row.number)))
            s.run(ANSWER_NS + s.margins.line_ns)
            count = len(s.responses)
            expect(count == 1, f"{count} answers to op {op:#04x} of {row.name}")
            elapsed, answer = s.responses[0][0] - sent_ns, s.responses[0][1]
            expect(answer.parameter == row.number, f"asked for {row.number:#06x}, answered {answer}")
            s.timing("PARAM_RESPONSE", elapsed, 0, ANSWER_NS + s.margins.line_ns)
    return f"{2 * len(DICTIONARY)} requests answered once each"


def _read_all(s: Session, known: dict[int, int], where: str) -> None:
    for row in DICTIONARY:
        answer = s.request(ParamOp.READ, row.number, 0x5A5A5A5A)
        expect(result_of(answer) == ParamOp.OK, f"READ of {row.name} in {where}: {answer}")
        assert answer is not None
        if row.number not in COUNTED:
            wanted = known.get(row.number, answer[1])
            expect(answer[1] == wanted, f"{row.name} in {where} is {answer[1]} and should be {wanted}")


@check(151)
def read_in_every_state(s: Session) -> str:
    known = {**s.originals, Index.NODE: s.node}
    for row in WRITABLE:
        value = max(row.minimum, min(row.maximum, s.read(row.number) - 1))
        s.write(row.number, value)
        known[row.number] = value
    _read_all(s, known, "DISABLED")
    s.arm()
    _read_all(s, known, "ARMED")
    s.disable()
    s.fail()
    _read_all(s, known, "FAULT")
    s.reset()
    return f"all {len(DICTIONARY)} parameters in DISABLED, ARMED and FAULT"


@check(151, Need.MOTION)
def read_in_operational(s: Session) -> str:
    s.operate()
    _read_all(s, {}, "OPERATIONAL")
    return f"all {len(DICTIONARY)} parameters in OPERATIONAL"


@check(152)
def unknown_index(s: Session) -> str:
    indices = unknown_indices(s)
    for index in indices:
        for op in (ParamOp.READ, ParamOp.WRITE):
            answer = s.request(op, index, 7)
            expect(answer == (ParamOp.UNKNOWN_INDEX, 0), f"{op.name} of index {index:#06x}: {answer}")
    return f"READ and WRITE of {len(indices)} unknown indices"


@check(153)
def read_only(s: Session) -> str:
    rows = [row for row in DICTIONARY if row.access is Access.READ_ONLY]
    for row in rows:
        for value in (s.read(row.number), row.minimum, row.maximum, INT32_MIN):
            answer = s.request(ParamOp.WRITE, row.number, value)
            expect(result_of(answer) == ParamOp.READ_ONLY, f"WRITE of {value} to {row.name}: {answer}")
    return f"{len(rows)} read-only parameters"


def _not_here(s: Session, where: str) -> None:
    for row in WRITABLE:
        answer = s.request(ParamOp.WRITE, row.number, s.read(row.number))
        expect(result_of(answer) == ParamOp.WRONG_STATE, f"WRITE to {row.name} in {where}: {answer}")


@check(154)
def write_while_disabled_only(s: Session) -> str:
    s.arm()
    _not_here(s, "ARMED")
    s.disable()
    s.fail()
    _not_here(s, "FAULT")
    s.reset()
    return "WRONG_STATE in ARMED and FAULT"


@check(154, Need.MOTION)
def no_write_in_operational(s: Session) -> str:
    s.operate()
    _not_here(s, "OPERATIONAL")
    return "WRONG_STATE in OPERATIONAL"


def _bounds(s: Session, row: Parameter) -> None:
    for value in (row.minimum, row.maximum):
        answer = s.request(ParamOp.WRITE, row.number, value)
        s.touched(row.number)
        expect(result_of(answer) == ParamOp.OK, f"WRITE of {value} to {row.name}, within its bounds: {answer}")
    for value in (row.minimum - 1, row.maximum + 1, INT32_MIN, INT32_MAX, 0, -1):
        if INT32_MIN <= value <= INT32_MAX and not row.minimum <= value <= row.maximum:
            answer = s.request(ParamOp.WRITE, row.number, value)
            expect(result_of(answer) == ParamOp.OUT_OF_RANGE, f"WRITE of {value} to {row.name}: {answer}")


@check(155)
def out_of_range(s: Session) -> str:
    """Bounds of all but the watchdog, which has a requirement of its own (HFP-124)."""
    for row in WRITABLE:
        if row.number not in (Index.WATCHDOG_TIMEOUT, Index.THETA_MIN, Index.THETA_MAX):
            _bounds(s, row)
    s.write(Index.THETA_MIN, INT32_MIN)
    s.write(Index.THETA_MAX, INT32_MAX)
    s.write(Index.THETA_MIN, -1000)
    s.write(Index.THETA_MAX, 1000)
    for index, value in ((Index.THETA_MIN, 1001), (Index.THETA_MAX, -1001), (Index.THETA_MIN, INT32_MAX)):
        answer = s.request(ParamOp.WRITE, index, value)
        s.touched(index)
        expect(result_of(answer) == ParamOp.OUT_OF_RANGE, f"WRITE that lets the limits cross: {answer}")
    for index, value in ((Index.THETA_MIN, 1000), (Index.THETA_MIN, -1000), (Index.THETA_MAX, -1000)):
        answer = s.request(ParamOp.WRITE, index, value)
        s.touched(index)
        expect(result_of(answer) == ParamOp.OK, f"WRITE that lets the limits meet: {answer}")
    return "both bounds accepted and nothing beyond; limits may meet and not cross"


@check(156)
def unknown_op(s: Session) -> str:
    ops = s.dense(range(2, 256), (2, 3, 0x10, 0x11, 0x15, 0x7F, 0x80, 0xFF))
    for op in ops:
        for index in (Index.MAX_STEP, 0x0777):
            answer = s.request(op, index, 1)
            expect(result_of(answer) == ParamOp.UNKNOWN_OP, f"op {op:#04x} of index {index:#06x}: {answer}")
    return f"{len(ops)} ops on known and unknown indices"


@check(157)
def order_of_refusals(s: Session) -> str:
    s.arm()
    cases = (
        (0x0777, 0, ParamOp.UNKNOWN_INDEX),
        (Index.SERIAL_LOW, INT32_MIN, ParamOp.READ_ONLY),
        (Index.MAX_STEP, INT32_MIN, ParamOp.WRONG_STATE),
    )
    for index, value, wanted in cases:
        answer = s.request(ParamOp.WRITE, index, value)
        expect(result_of(answer) == wanted, f"WRITE of {value} to {int(index):#06x} in ARMED: {answer}")
    return "index before access before state before range"


@check(158)
def refusal_changes_nothing(s: Session) -> str:
    held = s.read(Index.MAX_STEP)
    serial = s.originals[Index.SERIAL_LOW]
    cases = (
        (ParamOp.WRITE, Index.MAX_STEP, INT32_MIN, held),
        (ParamOp.WRITE, Index.MAX_STEP, BY_INDEX[Index.MAX_STEP].maximum + 1, held),
        (ParamOp.WRITE, Index.SERIAL_LOW, serial + 1, serial),
        (0x33, Index.MAX_STEP, 5, held),
        (ParamOp.READ, 0x0777, 5, 0),
    )
    for op, index, value, wanted in cases:
        before = s.rejected()
        answer = s.request(op, index, value)
        said = f"op {int(op):#04x} of {int(index):#06x} with {value}: {answer}"
        expect(answer is not None and answer[1] == wanted, f"{said}, where the value is {wanted}")
        grown = s.rejected() - before
        expect(grown == 1, f"{said}, and rejected grew by {grown}")
        expect(s.read(Index.MAX_STEP) == held, f"{said} changed it")
    expect(s.state == DriveState.DISABLED, s.state_name())
    return "value in force returned and kept, each refusal counted once"


@check(159)
def write_is_in_force_at_once(s: Session) -> str:
    for row in WRITABLE:
        value = max(row.minimum, min(row.maximum, s.read(row.number) - 3))
        answer = s.request(ParamOp.WRITE, row.number, value)
        s.touched(row.number)
        expect(answer == (ParamOp.OK, value), f"WRITE of {value} to {row.name}: {answer}")
    for period_us in (50_000, 20_000):
        s.write(Index.HEARTBEAT_PERIOD, period_us)
        judge_intervals(s, DriveState.DISABLED, period_us * 1000)
    return "new value returned; DRIVE_HEARTBEAT follows its period at once"
