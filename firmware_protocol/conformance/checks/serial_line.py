"""Serial line and UDP: HFP-160 to HFP-166, HFP-180, HFP-181, by bytes that no well-behaved host would send."""

import random
from binascii import crc_hqx

from cobs import cobs

from firmware_protocol.codec import CRC16_INIT
from firmware_protocol.conformance import wire
from firmware_protocol.conformance.checks.frames import walk
from firmware_protocol.conformance.checks.ids import SLOWEST_BYTE_NS, param_read, quiet
from firmware_protocol.conformance.findings import Inconclusive, expect, require
from firmware_protocol.conformance.port import MS
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import ANSWER_NS, Session
from firmware_protocol.frames import arbitration_id
from firmware_protocol.messages import DriveState, Function, ParamOp
from firmware_protocol.parameters import Index
from firmware_protocol.serial_framing import FD_FLAG, encode_serial

MAX_PACKET_BYTES = 69  # before the delimiter: id, 64 bytes, CRC, one of COBS


def packet(word: int, payload: bytes, crc_mask: int = 0) -> bytes:
    """Return a packet with its delimiter, right or wrong as asked for."""
    body = word.to_bytes(2, "little") + payload
    encoded: bytes = cobs.encode(body + (crc_hqx(body, CRC16_INIT) ^ crc_mask).to_bytes(2, "little"))
    return encoded + b"\x00"


def send_bytes(s: Session, data: bytes) -> None:
    """Send bytes, waiting for room."""
    for _ in range(1000):
        if s.port.send_bytes(data):
            return
        s.run(s.margins.gap_ns)
    raise Inconclusive("the line accepts no more bytes")


def answered(s: Session) -> bool:
    """Tell whether the request under way is answered."""
    return s.run(ANSWER_NS + s.margins.line_ns, lambda: bool(s.responses))


def request(s: Session) -> bytes:
    """Return a request as a packet."""
    s.responses.clear()
    return encode_serial(param_read(Function.PARAM_REQUEST, s.node))


@check(160, Need.SERIAL, last=True)
def packets_are_well_formed(s: Session) -> str:
    before = s.port.line_errors()
    walk(s)
    errors = s.port.line_errors() - before
    expect(errors == 0, f"{errors} packets of the drive were damaged or no packets at all")
    return f"{sum(s.monitor.seen.values())} packets of the drive well formed"


@check(180, Need.DATAGRAM, last=True)
def datagrams_hold_whole_packets(s: Session) -> str:
    before = s.port.line_errors()
    walk(s)
    errors = s.port.line_errors() - before
    expect(errors == 0, f"{errors} datagrams of the drive held something else than whole packets")
    return f"{sum(s.monitor.seen.values())} packets of the drive, none torn"


@check(181, Need.DATAGRAM)
def torn_datagrams_spoil_no_other(s: Session) -> str:
    length = len(request(s))
    for cut in range(1, length - 1):
        send_bytes(s, request(s)[:cut])
        s.run(s.margins.gap_ns)
        send_bytes(s, request(s))
        expect(answered(s), f"no answer after a datagram that ended within a packet, after {cut} bytes")
        s.run(s.margins.gap_ns)
    return f"next packet found after each of {length - 2} torn datagrams"


@check(161, Need.SERIAL)
def inner_check_counts(s: Session) -> str:
    before = s.rejected()
    s.listen()
    send_bytes(s, encode_serial(wire.damaged(param_read(Function.PARAM_REQUEST, s.node))))
    found = quiet(s, ANSWER_NS)
    expect(not found, f"a good packet around a damaged payload: {found}")
    expect(s.rejected() == before + 1, "a good packet around a damaged payload was not counted as rejected")
    findings = s.monitor.findings(30) + s.monitor.findings(31)
    expect(not findings, f"payloads of the drive without their own check: {findings}")
    return "payloads carry their own check both ways"


@check(162, Need.SERIAL | Need.STREAM)
def any_chunks(s: Session) -> str:
    s.beating = False  # its bytes would come between
    length = len(request(s))
    for cut in range(1, length):
        data = request(s)
        send_bytes(s, data[:cut])
        s.run(s.margins.gap_ns)
        send_bytes(s, data[cut:])
        expect(answered(s), f"no answer to a packet cut after {cut} bytes")
    for byte in request(s):
        send_bytes(s, bytes((byte,)))
        s.run(s.margins.gap_ns)
    expect(answered(s), "no answer to a packet sent byte by byte")
    send_bytes(s, request(s) * 5)
    s.run(5 * ANSWER_NS + s.margins.line_ns, lambda: len(s.responses) >= 5)
    expect(len(s.responses) == 5, f"{len(s.responses)} answers to 5 packets in one piece")
    return f"{length} cuts, byte by byte, five at once"


@check(163, Need.SERIAL)
def found_again_after_anything(s: Session) -> str:
    chance = random.Random(163)
    tried = 200 if s.thorough else 40
    for number in range(tried):
        junk = chance.randbytes(chance.randrange(1, 300))
        send_bytes(s, junk + b"\x00")
        s.run(s.margins.gap_ns + len(junk) * SLOWEST_BYTE_NS)
        send_bytes(s, request(s))
        expect(answered(s), f"no answer after {len(junk)} bytes of garbage (number {number})")
    expect(s.observe() == DriveState.DISABLED, f"{s.state_name()} after garbage")
    return f"next packet found after each of {tried} pieces of garbage"


@check(164, Need.SERIAL)
def bad_packets_dropped(s: Session) -> str:
    frame = param_read(Function.PARAM_REQUEST, s.node)
    estop = arbitration_id(Function.ESTOP, s.node)
    s.listen()
    for bit in range(16):
        send_bytes(s, packet(frame.arbitration_id, frame.data, crc_mask=1 << bit))
    for bit in range(11, 15):
        send_bytes(s, packet(frame.arbitration_id | 1 << bit, frame.data))
        send_bytes(s, packet(estop | 1 << bit, b""))
    found = quiet(s, ANSWER_NS)
    expect(not found, f"packets with a wrong CRC or an id beyond 11 bits: {found}")
    for length in (9, 10, 12, 16, 64):
        send_bytes(s, packet(estop, bytes(length)))
    for length in (9, 10, 11, 13, 15, 17, 63):
        send_bytes(s, packet(estop | FD_FLAG, bytes(length)))
    found = quiet(s, ANSWER_NS)
    expect(not found, f"packets of a length that no CAN frame has: {found}")
    return "wrong CRC, ids beyond 11 bits and impossible lengths dropped"


@check(165, Need.SERIAL)
def long_packets_skipped(s: Session) -> str:
    """Whatever a reader keeps of a packet that is too long, the end of it is no packet."""
    tail = request(s)
    s.listen()
    for length in s.dense(
        range(MAX_PACKET_BYTES, 4 * MAX_PACKET_BYTES), tuple(range(MAX_PACKET_BYTES - 8, MAX_PACKET_BYTES + 16))
    ):
        if length + len(tail) - 1 > MAX_PACKET_BYTES:
            send_bytes(s, b"\x01" * length + tail)
            s.run(s.margins.gap_ns // 4)
    found = quiet(s, ANSWER_NS)
    expect(not found, f"the end of a packet that is too long: {found}")
    for _ in range(20):
        send_bytes(s, b"\xff" * 500)
        # Or the line has not brought them all when the answer is due.
        s.run(500 * SLOWEST_BYTE_NS + s.margins.line_ns)
    send_bytes(s, b"\x00" + request(s))
    expect(answered(s), "no answer after 10000 bytes without a delimiter")
    return "too long packets skipped whole, the next one found"


@check(166, Need.SERIAL)
def empty_packets_ignored(s: Session) -> str:
    before = s.rejected()
    for zeros in (1, 2, 3, 100):
        send_bytes(s, bytes(zeros) + request(s) + bytes(zeros))
        expect(answered(s), f"no answer to a packet between {zeros} zero bytes")
    require(s.request(ParamOp.READ, Index.NODE) is not None, "no answer")
    s.run(5 * MS)
    expect(s.rejected() == before, "empty packets were counted as rejected")
    return "empty packets ignored"
