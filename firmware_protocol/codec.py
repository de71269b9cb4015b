"""Messages to frames and back; the check value covers the id, so a frame delivered under another id is refused.

CRC-8 AUTOSAR (polynomial 0x2F, init and xor-out 0xFF) ends the classic frames: Hamming distance 4 over the 80 bits it
covers. CRC-16 CCITT (0x1021, init 0xFFFF, no reflection) ends the FD frames and, in `serial_framing`, each packet.
Both run over the arbitration id as two little-endian bytes, then over the payload before them.
"""

import struct
from binascii import crc_hqx
from typing import Final

from fastcrc.crc8 import autosar

from firmware_protocol.frames import MAX_NODE, Frame, arbitration_id, make
from firmware_protocol.layouts import (
    BENCH,
    FD_FEEDBACK,
    FD_SETPOINT,
    FEEDBACK,
    FUNCTION_OF,
    LAYOUTS,
    SETPOINT,
    TIMING,
    Check,
    status_byte,
)
from firmware_protocol.messages import Function, Message, Setpoint

CRC16_INIT: Final = 0xFFFF
DECODE_COUNTERS: Final = ("unknown_id", "bad_length", "bad_format", "bad_crc")

_CRC8_RESIDUE: Final = 0xBD  # what any message followed by its own CRC-8 gives: one call verifies, without slicing
_IDS: Final = 1 << 11
_SEED8: Final = tuple(autosar(i.to_bytes(2, "little")) for i in range(_IDS))
_SEED16: Final = tuple(crc_hqx(i.to_bytes(2, "little"), CRC16_INIT) for i in range(_IDS))
_BYTE: Final = tuple(bytes((i,)) for i in range(256))


def _heads(function: Function) -> dict[int, tuple[int, int]]:
    """Return the id of a function and the CRC seed of that id, by node."""
    seeds = _SEED8 if LAYOUTS[function].check is Check.CRC8 else _SEED16
    return {node: (arbitration_id(function, node), seeds[arbitration_id(function, node)]) for node in _NODES}


_NODES: Final = range(1, MAX_NODE + 1)
_SETPOINT_HEADS: Final = _heads(Function.SETPOINT)
_FD_SETPOINT_HEADS: Final = _heads(Function.FD_SETPOINT)
_FEEDBACK_HEADS: Final = _heads(Function.FEEDBACK)
_TIMING_HEADS: Final = _heads(Function.TIMING)
_FD_FEEDBACK_HEADS: Final = _heads(Function.FD_FEEDBACK)
_BENCH_HEADS: Final = _heads(Function.BENCH_SENSOR)


def _seal8(identifier: int, seed: int, body: bytes) -> Frame:
    return make(Frame, (identifier, body + _BYTE[autosar(body, seed)], False, False))


def _seal16(identifier: int, seed: int, body: bytes) -> Frame:
    return make(Frame, (identifier, body + crc_hqx(body, seed).to_bytes(2, "little"), True, False))


def _unfit(error: Exception) -> ValueError:
    return ValueError(f"a field does not fit its place on the wire: {error}")


def _refusal(node: int, error: Exception) -> ValueError:
    """Return what was wrong with the fields of a message of this node."""
    return ValueError(f"node {node}: must be 1 to {MAX_NODE}") if isinstance(error, KeyError) else _unfit(error)


def encode(message: Message, fd: bool = False) -> Frame:
    """Encode any message; `fd` turns a Setpoint into FD_SETPOINT.

    ValueError when a field does not fit, the node is not allowed for this message, or `fd` has no meaning for it.
    """
    function = FUNCTION_OF.get(type(message))
    if function is None:
        raise TypeError(f"{type(message).__name__} is not a message")
    if fd:
        if not isinstance(message, Setpoint):
            raise ValueError(f"{type(message).__name__} has no FD variant of the same fields")
        function = Function.FD_SETPOINT
    layout = LAYOUTS[function]
    if not layout.lowest_node <= message.node <= layout.highest_node:
        raise ValueError(f"{function.name}: node {message.node} not in {layout.lowest_node}..{layout.highest_node}")
    identifier = arbitration_id(function, message.node)
    try:
        body = layout.pack(message)
    except (struct.error, OverflowError) as error:
        raise _unfit(error) from error
    if layout.check is Check.CRC8:
        return _seal8(identifier, _SEED8[identifier], body)
    return _seal16(identifier, _SEED16[identifier], body) if layout.check is Check.CRC16 else Frame(identifier, body)


def encode_setpoint(node: int, theta_m_ref: int, sequence: int, sample_sequence: int, fd: bool = False) -> Frame:
    """Encode SETPOINT or FD_SETPOINT, the fast way; ValueError as `encode`."""
    try:
        if fd:
            identifier, seed = _FD_SETPOINT_HEADS[node]
            return _seal16(identifier, seed, FD_SETPOINT.pack(theta_m_ref, sequence, sample_sequence))
        identifier, seed = _SETPOINT_HEADS[node]
        body = SETPOINT.pack(theta_m_ref, sequence, sample_sequence)
        return make(Frame, (identifier, body + _BYTE[autosar(body, seed)], False, False))
    except (KeyError, struct.error) as error:
        raise _refusal(node, error) from error


def encode_feedback(node: int, theta_m: int, current: int, sequence: int) -> Frame:
    """Encode FEEDBACK, the fast way; ValueError as `encode`."""
    try:
        identifier, seed = _FEEDBACK_HEADS[node]
        body = FEEDBACK.pack(theta_m, current, sequence)
    except (KeyError, struct.error) as error:
        raise _refusal(node, error) from error
    return make(Frame, (identifier, body + _BYTE[autosar(body, seed)], False, False))


def encode_timing(node: int, stamp_us: int, sequence: int, setpoint_sequence: int, state: int, fault: int) -> Frame:
    """Encode TIMING, the fast way; ValueError as `encode`."""
    try:
        identifier, seed = _TIMING_HEADS[node]
        body = TIMING.pack(stamp_us, sequence, setpoint_sequence, status_byte(state, fault))
    except (KeyError, struct.error) as error:
        raise _refusal(node, error) from error
    return make(Frame, (identifier, body + _BYTE[autosar(body, seed)], False, False))


def encode_fd_feedback(
    node: int, theta_m: int, current: int, stamp_us: int, sequence: int, setpoint_sequence: int, state: int, fault: int
) -> Frame:
    """Encode FD_FEEDBACK, the fast way; ValueError as `encode`."""
    try:
        identifier, seed = _FD_FEEDBACK_HEADS[node]
        status = status_byte(state, fault)
        return _seal16(
            identifier, seed, FD_FEEDBACK.pack(theta_m, current, stamp_us, sequence, setpoint_sequence, status)
        )
    except (KeyError, struct.error) as error:
        raise _refusal(node, error) from error


def encode_bench_sensor(node: int, theta_j: int, tau_w: int, sequence: int) -> Frame:
    """Encode BENCH_SENSOR, the fast way; ValueError as `encode`."""
    try:
        identifier, seed = _BENCH_HEADS[node]
        body = BENCH.pack(theta_j & 0xFFFF, theta_j >> 16, tau_w & 0xFFFF, tau_w >> 16, sequence)
    except (KeyError, struct.error) as error:
        raise _refusal(node, error) from error
    return make(Frame, (identifier, body + _BYTE[autosar(body, seed)], False, False))


# id -> (node, length, format, check, CRC seed of the id, builder)
_ROUTES: Final = {
    arbitration_id(function, node): (
        node,
        layout.length,
        layout.is_fd,
        int(layout.check),
        (_SEED16 if layout.check is Check.CRC16 else _SEED8)[arbitration_id(function, node)],
        layout.build,
    )
    for function, layout in LAYOUTS.items()
    for node in range(layout.lowest_node, layout.highest_node + 1)
}
# Of these, what is cyclic on classic CAN: 8 bytes, the last the CRC-8. id -> (node, CRC seed of the id, builder)
_SHORT_ROUTES: Final = {
    identifier: (node, seed, build)
    for identifier, (node, length, is_fd, check, seed, build) in _ROUTES.items()
    if length == 8 and is_fd is False and check == Check.CRC8
}


class Decoder:
    """Frames to messages; what can't be decoded is counted by reason and dropped, never raised.

    `counters` may be shared with the owner, who then sees these counts among its own.
    """

    def __init__(self, counters: dict[str, int] | None = None) -> None:
        self.counters = {} if counters is None else counters
        for name in DECODE_COUNTERS:
            self.counters.setdefault(name, 0)

    def decode(self, frame: Frame) -> Message | None:
        """Return the message, or None with one counter advanced."""
        identifier, data, is_fd, is_extended = frame
        short = _SHORT_ROUTES.get(identifier)
        if short is not None and not (is_fd or is_extended) and len(data) == 8:
            node, seed, build = short
            if autosar(data, seed) == _CRC8_RESIDUE:
                message: Message = build(node, data)
                return message
        return self._decode_any(frame)

    def _decode_any(self, frame: Frame) -> Message | None:
        identifier, data, is_fd, is_extended = frame
        route = _ROUTES.get(identifier)
        if route is None or is_extended:
            self.counters["unknown_id"] += 1
            return None
        node, length, wanted_fd, check, seed, build = route
        if is_fd != wanted_fd and wanted_fd is not None:
            self.counters["bad_format"] += 1
            return None
        if len(data) != length and length >= 0:
            self.counters["bad_length"] += 1
            return None
        if check == 1:
            intact = autosar(data, seed) == _CRC8_RESIDUE
        elif check == 2:
            intact = crc_hqx(data[:-2], seed) == data[-2] | data[-1] << 8
        else:
            intact = True
        if not intact:
            self.counters["bad_crc"] += 1
            return None
        message: Message = build(node, data)
        return message
