"""Vectors of the codec and of the serial framing: every message at its bounds and at random, and what is refused."""

import random
from binascii import crc_hqx
from typing import Final

from cobs import cobs

from firmware_protocol import codec
from firmware_protocol.frames import MAX_NODE, Frame, arbitration_id
from firmware_protocol.layouts import FUNCTION_OF, LAYOUTS
from firmware_protocol.messages import Function, Message, ParamRequest, Setpoint
from firmware_protocol.serial_framing import FD_FLAG, SerialReader, encode_serial

_SEED: Final = 1
_RANDOM_EACH: Final = 8

# Width in bits by field name, negative where signed; `node` is drawn apart.
_BITS: Final = {
    "theta_m_ref": -32,
    "theta_m": -32,
    "theta_j": -24,
    "tau_w": -24,
    "current": -16,
    "value": -32,
    "stamp_us": 32,
    "serial_number": 48,
    "parameter": 16,
    "rejected": 16,
    "state": 4,
    "fault": 4,
}

Row = dict[str, object]


def field_range(name: str) -> tuple[int, int]:
    """Return the smallest and the largest raw value that a field carries."""
    bits = _BITS.get(name, 8)
    return (-(1 << -bits - 1), (1 << -bits - 1) - 1) if bits < 0 else (0, (1 << bits) - 1)


def draw_messages(rng: random.Random, each: int) -> list[tuple[Message, bool]]:
    """Return (message, fd) for every message: all fields least, all most, then `each` at random."""
    drawn: list[tuple[Message, bool]] = []
    for kind, function in FUNCTION_OF.items():
        layout = LAYOUTS[function]
        ranges = [field_range(name) for name in kind._fields[1:]]  # type: ignore[attr-defined]
        nodes = (layout.lowest_node, layout.highest_node)
        rows = [(nodes[0], *(low for low, _ in ranges)), (nodes[1], *(high for _, high in ranges))]
        rows += [(rng.randint(*nodes), *(rng.randint(*bounds) for bounds in ranges)) for _ in range(each)]
        variants = (False, True) if kind is Setpoint else (False,)
        drawn += [(kind(*row), fd) for row in rows for fd in variants]
    return drawn


def messages() -> list[Row]:
    """Return one row a message: fields, frame, serial packet."""
    rows: list[Row] = []
    for message, fd in draw_messages(random.Random(_SEED), _RANDOM_EACH):
        frame = codec.encode(message, fd)
        name = Function(frame.arbitration_id >> 5).name
        fields = {key: int(value) for key, value in message._asdict().items()}
        rows.append({"message": name, "fields": fields, **frame_row(frame), "serial": encode_serial(frame).hex()})
    return rows


def frame_row(frame: Frame) -> Row:
    """Return a frame as JSON holds it."""
    return {"id": frame.arbitration_id, "fd": frame.is_fd, "payload": frame.data.hex()}


def rejects() -> list[Row]:
    """Return frames that must be dropped, each with the counter that must advance."""
    good = codec.encode_setpoint(5, 1_000_000, 7, 9)
    fd_good = codec.encode_setpoint(5, 1_000_000, 7, 9, fd=True)
    cases = {
        "other id than the CRC-8 was made for": (good._replace(arbitration_id=good.arbitration_id + 1), "bad_crc"),
        "other id than the CRC-16 was made for": (
            fd_good._replace(arbitration_id=fd_good.arbitration_id + 1),
            "bad_crc",
        ),
        "one bit flipped": (good._replace(data=bytes((good.data[0] ^ 1,)) + good.data[1:]), "bad_crc"),
        "CRC-8 inverted": (good._replace(data=good.data[:-1] + bytes((good.data[-1] ^ 0xFF,))), "bad_crc"),
        "CRC-16 with its bytes swapped": (fd_good._replace(data=fd_good.data[:-2] + fd_good.data[:-3:-1]), "bad_crc"),
        "one byte short": (good._replace(data=good.data[:-1]), "bad_length"),
        "empty": (good._replace(data=b""), "bad_length"),
        "DISCOVER with a payload": (Frame(arbitration_id(Function.DISCOVER, 0), b"\x00"), "bad_length"),
        "classic message as FD": (good._replace(is_fd=True), "bad_format"),
        "FD message as classic": (fd_good._replace(is_fd=False), "bad_format"),
        "function that does not exist": (Frame(0x3F << 5 | 1, bytes(8)), "unknown_id"),
        "reserved node 31": (Frame(arbitration_id(Function.SETPOINT, MAX_NODE + 1), good.data), "unknown_id"),
        "SETPOINT to all": (Frame(arbitration_id(Function.SETPOINT, 0), good.data), "unknown_id"),
        "ASSIGN_NODE to one": (Frame(arbitration_id(Function.ASSIGN_NODE, 1), bytes(8)), "unknown_id"),
    }
    return [{"case": case, **frame_row(frame), "counter": counter} for case, (frame, counter) in cases.items()]


def serial_streams() -> list[Row]:
    """Return byte streams with the frames and counters a reader must make of them, however they are cut."""
    first = encode_serial(codec.encode_setpoint(1, -1, 0, 0))
    second = encode_serial(codec.encode(ParamRequest(1, 0, 0x0101, 0)))
    fd = encode_serial(codec.encode_fd_feedback(1, 2, 3, 4, 5, 6, 2, 0))
    streams = {
        "two packets": first + second,
        "classic and FD": first + fd,
        "joined in the middle of a packet": first[4:] + second,
        "delimiters to flush": b"\x00\x00" + first + b"\x00" + second,
        "one byte damaged": first[:3] + bytes((first[3] ^ 0x10,)) + first[4:] + second,
        "a byte lost": first[:5] + first[6:] + second,
        "a byte too many": first[:5] + b"\x55" + first[5:] + second,
        "delimiter lost": first[:-1] + second + first,
        "shorter than id and CRC": b"\x03\x41\x42\x00" + first,
        "longer than any packet": b"\x55" * 100 + b"\x00" + first,
        "longer than any packet, without an end": b"\x55" * 100,
        "id above 11 bits": _raw_packet(0x0841, bytes(8)) + first,
        "nine bytes in a classic frame": _raw_packet(0x41, bytes(9)) + first,
        "nine bytes in an FD frame": _raw_packet(FD_FLAG | 0x41, bytes(9)) + first,
    }
    rows: list[Row] = []
    for case, stream in streams.items():
        reader = SerialReader()
        frames = [frame_row(frame) for frame in reader.feed(stream)]
        rows.append({"case": case, "stream": stream.hex(), "frames": frames, "counters": dict(reader.counters)})
    return rows


def _raw_packet(word: int, payload: bytes) -> bytes:
    """Return a packet whose CRC is right and whose header is taken as it is."""
    packet = word.to_bytes(2, "little") + payload
    encoded: bytes = cobs.encode(packet + crc_hqx(packet, codec.CRC16_INIT).to_bytes(2, "little"))
    return encoded + b"\x00"
