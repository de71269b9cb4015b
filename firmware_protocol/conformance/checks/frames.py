"""Frames and their checks: HFP-020 to HFP-025, HFP-030 to HFP-032."""

import random
from collections.abc import Iterator

from fastcrc.crc8 import autosar

from firmware_protocol.conformance import wire
from firmware_protocol.conformance.checks.ids import line_time_ns, param_read, quiet
from firmware_protocol.conformance.findings import expect, require
from firmware_protocol.conformance.port import MS, Capability
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import ENABLE, IDENTITY_NS, LOW, Session
from firmware_protocol.frames import BROADCAST_NODE, Frame, arbitration_id
from firmware_protocol.messages import DriveState, Function, ParamOp
from firmware_protocol.parameters import DICTIONARY, Index
from firmware_protocol.serial_framing import FD_LENGTHS

GARBAGE_FRAMES = 2000


def walk(s: Session) -> None:
    """Make the drive send every message it has, in three states, and something of each stream."""
    s.find()
    s.arm()
    s.run(300 * MS)
    s.disable()
    s.fail()
    s.run(300 * MS)
    s.reset()
    s.read(Index.NODE)
    s.run(300 * MS)


@check(20)
def fields_in_their_places(s: Session) -> str:
    s.find()
    identity = next((m for _, m in s.identities if m.node == s.node), None)
    require(identity is not None, "no IDENTITY")
    assert identity is not None
    expect(
        identity.serial_number == s.serial_number,
        f"IDENTITY has the serial number {identity.serial_number:#x}, the parameters have {s.serial_number:#x}",
    )
    versions = (s.read(Index.PROTOCOL_MAJOR), s.read(Index.PROTOCOL_MINOR))
    expect(identity[2:] == versions, f"IDENTITY has version {identity[2:]}, the parameters have {versions}")
    for row in DICTIONARY:
        value = s.read(row.number)
        expect(row.minimum <= value <= row.maximum, f"{row.name} is {value}, which its range does not have")
    s.run(3 * s.originals[Index.HEARTBEAT_PERIOD] * 1000)
    require(bool(s.beats), "no DRIVE_HEARTBEAT")
    beat = s.beats[-1][1]
    expect((beat.protocol_major, beat.protocol_minor) == versions, f"DRIVE_HEARTBEAT has another version: {beat}")
    findings = s.monitor.findings(20)
    expect(not findings, findings)
    return "IDENTITY, DRIVE_HEARTBEAT and parameters agree; every length is that of the table"


def _effective(s: Session) -> Iterator[tuple[str, int, int, bytes]]:
    """Messages that would show if they were taken: name, function, node, body before the check."""
    yield "PARAM_REQUEST", Function.PARAM_REQUEST, s.node, wire.param_body(ParamOp.READ, Index.NODE)
    beat = wire.heartbeat_body(ENABLE, 1, 0, s.host_sequence + 1)
    yield "HOST_HEARTBEAT", Function.HOST_HEARTBEAT, s.node, beat
    node = (s.free_nodes() or [s.node])[0]
    yield "ASSIGN_NODE", Function.ASSIGN_NODE, BROADCAST_NODE, wire.assign_body(s.serial_number, node)


def _dropped(s: Session, name: str, frame: Frame) -> None:
    s.listen()
    s.send(frame)
    found = quiet(s, 0)
    expect(not found, f"{name} {frame.data.hex(' ') or '(empty)'}, fd {frame.is_fd}: {found}")


@check(21)
def wrong_length_dropped(s: Session) -> str:
    tried = 0
    s.heartbeat(LOW)
    for name, function, node, body in list(_effective(s)):
        for length in s.dense(range(8), (0, 1, 4, 6, 7)):
            short = (
                wire.sealed8(function, node, body[: length - 1])
                if length
                else Frame(arbitration_id(function, node), b"")
            )
            _dropped(s, name, short)
            tried += 1
    for length in range(1, 9):
        _dropped(s, "DISCOVER", Frame(arbitration_id(Function.DISCOVER, BROADCAST_NODE), bytes(length)))
        tried += 1
    found = quiet(s, IDENTITY_NS)
    expect(not found, f"DISCOVER that is not empty: {found}")
    return f"{tried} frames of wrong length without effect"


@check(22, Need.FD_LINE)
def wrong_format_dropped(s: Session) -> str:
    s.heartbeat(LOW)
    for name, function, node, body in list(_effective(s)):
        _dropped(s, name, wire.sealed8(function, node, body, is_fd=True))
        _dropped(s, name, wire.sealed16(function, node, body[:6], is_fd=True))
        longer = wire.sealed8(function, node, body + bytes(4), is_fd=True)
        _dropped(s, name, longer)
    _dropped(s, "DISCOVER", Frame(arbitration_id(Function.DISCOVER, BROADCAST_NODE), b"", True))
    found = quiet(s, IDENTITY_NS)
    expect(not found, f"DISCOVER as an FD frame: {found}")
    return "PARAM_REQUEST, HOST_HEARTBEAT, ASSIGN_NODE and DISCOVER as FD frames without effect"


@check(23, Need.FD_DRIVE, last=True)
def reserved_bits_sent_as_zero(s: Session) -> str:
    walk(s)
    findings = s.monitor.findings(23)
    expect(not findings, findings)
    return f"byte 13 of {s.monitor.seen[Function.FD_FEEDBACK]} FD_FEEDBACK was 0"


@check(24)
def reserved_bits_of_heartbeats_ignored(s: Session) -> str:
    patterns = ((0xFC, b"\xff\xff\xff"), (0x04, bytes(3)), (0x80, bytes(3)), (0, b"\x01\0\0"), (0, b"\0\0\x80"))
    for bits, reserved in patterns:
        s.heartbeat(LOW)
        s.host_sequence = (s.host_sequence + 1) & 0xFF
        s.control = ENABLE
        body = wire.heartbeat_body(ENABLE | bits, 1, 0, s.host_sequence, reserved)
        s.send(wire.sealed8(Function.HOST_HEARTBEAT, s.node, body))
        armed = s.wait_state(DriveState.ARMED)
        expect(armed, f"HOST_HEARTBEAT {body.hex(' ')} was not taken: {s.state_name()}")
        s.disable()
    return f"{len(patterns)} patterns of reserved bits in HOST_HEARTBEAT ignored"


@check(24, Need.MOTION | Need.CLASSIC_DRIVE)
def reserved_byte_of_setpoints_ignored(s: Session) -> str:
    theta = s.operate()
    for reserved in (0x01, 0x80, 0xFF):
        s.reference = None
        before = s.accepted()
        s.fresh()
        s.setpoint_sequence = (s.setpoint_sequence + 1) & 0xFF
        s.send(wire.setpoint(s.fd, s.node, theta, s.setpoint_sequence, s.measured().sequence, reserved))
        s.run(s.margins.gap_ns)
        expect(s.accepted() == before + 1, f"SETPOINT with reserved byte {reserved:#04x} was not taken")
    return "reserved byte of SETPOINT ignored"


def _drops(s: Session) -> Iterator[tuple[str, Frame]]:
    """Frames for this drive that it must drop, each in another way."""
    request = param_read(Function.PARAM_REQUEST, s.node)
    for mask in (0x01, 0x80, 0xFF):
        yield "damaged PARAM_REQUEST", wire.damaged(request, mask)
    for position in range(7):
        yield "damaged PARAM_REQUEST", wire.damaged(request, 0x10, position)
    yield "short PARAM_REQUEST", wire.sealed8(Function.PARAM_REQUEST, s.node, bytes(6))
    beat = wire.sealed8(Function.HOST_HEARTBEAT, s.node, wire.heartbeat_body(ENABLE, 1, 0, s.host_sequence + 1))
    yield "damaged HOST_HEARTBEAT", wire.damaged(beat)
    s.heartbeat(LOW)  # the last may be longer ago than the drive remembers it
    again = wire.heartbeat_body(ENABLE, 1, 0, s.host_sequence)
    yield "repeated HOST_HEARTBEAT", wire.sealed8(Function.HOST_HEARTBEAT, s.node, again)
    yield "reference while DISABLED", s.setpoint_frame(s.measured().theta_m, 1)
    yield (
        "damaged ASSIGN_NODE",
        wire.damaged(wire.sealed8(Function.ASSIGN_NODE, BROADCAST_NODE, wire.assign_body(s.serial_number, 30))),
    )
    if s.port.capabilities & Capability.FD:
        yield "PARAM_REQUEST as FD frame", request._replace(is_fd=True)


@check(25)
def dropped_frames_are_counted_once(s: Session) -> str:
    s.heartbeat(LOW)
    s.beating = False
    kinds = 0
    for name, frame in _drops(s):
        kinds += 1
        before = s.rejected()
        _dropped(s, name, frame)
        grown = s.rejected() - before
        expect(grown == 1, f"{name} {frame.data.hex(' ')}: rejected grew by {grown}")
    return f"{kinds} kinds of dropped frames counted once each, without any other effect"


@check(25)
def garbage_changes_nothing(s: Session) -> str:
    """Random payloads under the ids that the drive listens to; one in 256 may be right by chance and is left out."""
    chance = random.Random(25)
    before, expected = s.rejected(), 0
    ids = (Function.FD_SETPOINT if s.fd else Function.SETPOINT, Function.HOST_HEARTBEAT, Function.PARAM_REQUEST)
    s.listen()
    can_fd = bool(s.port.capabilities & Capability.FD)
    for _ in range(s.dense((GARBAGE_FRAMES,), (GARBAGE_FRAMES // 4,))[0]):
        function = chance.choice(ids)
        is_fd = can_fd and chance.random() < 0.3
        data = chance.randbytes(chance.choice(sorted(FD_LENGTHS)) if is_fd else chance.randrange(9))
        frame = Frame(arbitration_id(function, s.node), data, is_fd)
        if data and wire.sealed8(function, s.node, data[:-1]).data == data:
            continue
        s.send(frame)
        expected += 1
        s.run(s.margins.gap_ns + line_time_ns(s, frame))
    found = quiet(s, 5 * MS)
    expect(not found, f"after garbage: {found}")
    grown = s.rejected() - before
    expect(grown == expected, f"{expected} frames of garbage, and rejected grew by {grown}")
    return f"{expected} frames of garbage counted, none with an effect"


@check(30, last=True)
def crc8_of_what_is_sent(s: Session) -> str:
    walk(s)
    findings = s.monitor.findings(30)
    expect(not findings, findings)
    return f"CRC-8 right in all of {sum(s.monitor.seen.values())} frames"


@check(31, Need.FD_DRIVE, last=True)
def crc16_of_what_is_sent(s: Session) -> str:
    walk(s)
    findings = s.monitor.findings(31)
    expect(not findings, findings)
    return f"CRC-16 right in {s.monitor.seen[Function.FD_FEEDBACK]} FD_FEEDBACK"


@check(32)
def wrong_check_dropped(s: Session) -> str:
    request = param_read(Function.PARAM_REQUEST, s.node)
    s.listen()
    for mask in s.dense(range(1, 256), (0x01, 0x80, 0x55, 0xFF)):
        s.send(wire.damaged(request, mask))
        s.run(s.margins.gap_ns)
    found = quiet(s, 0)
    expect(not found, f"PARAM_REQUEST with a wrong check: {found}")
    s.heartbeat(LOW)
    tried = 0
    for name, function, node, body in list(_effective(s)):
        right = wire.sealed8(function, node, body)
        for other in (*(n for n in range(1, 31) if n != node), None):
            # A check over the payload alone, or over another id, is as wrong as any.
            check_byte = _crc_without_id(body) if other is None else wire.sealed8(function, other, body).data[-1:]
            if check_byte == right.data[-1:]:
                continue
            s.send(right._replace(data=body + check_byte))
            s.run(s.margins.gap_ns)
            tried += 1
        found = quiet(s, 0)
        expect(not found, f"{name} with the check of another id: {found}")
    return f"no reaction to wrong checks, {tried} of them right for another id"


def _crc_without_id(body: bytes) -> bytes:
    return bytes((autosar(body),))


@check(32, Need.MOTION)
def references_with_wrong_check_dropped(s: Session) -> str:
    theta = s.operate()
    s.reference = None
    before = s.accepted()
    for position in range(8):
        for bit in s.dense(range(8), (0, 7)):
            frame = s.setpoint_frame(theta, s.setpoint_sequence + 1)
            s.send(wire.damaged(frame, 1 << bit, position))
            s.run(s.margins.gap_ns)
        s.run(0)
    grown = s.accepted() - before
    expect(grown == 0, f"{grown} references with one bit flipped were accepted")
    return "references with one bit flipped dropped"
