"""Frames that no codec of a well-behaved host would make: right checks on wrong lengths, ids and fields."""

import struct
from binascii import crc_hqx
from typing import Final

from fastcrc.crc8 import autosar

from firmware_protocol.codec import CRC16_INIT
from firmware_protocol.frames import Frame, arbitration_id
from firmware_protocol.messages import Function

DRIVE_FUNCTIONS: Final = frozenset(
    {
        Function.FEEDBACK,
        Function.TIMING,
        Function.FD_FEEDBACK,
        Function.DRIVE_HEARTBEAT,
        Function.BENCH_SENSOR,
        Function.PARAM_RESPONSE,
        Function.IDENTITY,
    }
)


def sealed8(function: int, node: int, body: bytes, is_fd: bool = False) -> Frame:
    """Return a frame that ends in the CRC-8 of its id and body, whatever the two are."""
    identifier = arbitration_id(function, node)
    check = autosar(identifier.to_bytes(2, "little") + body)
    return Frame(identifier, body + bytes((check,)), is_fd)


def sealed16(function: int, node: int, body: bytes, is_fd: bool = True) -> Frame:
    """Return a frame that ends in the CRC-16 of its id and body, whatever the two are."""
    identifier = arbitration_id(function, node)
    check = crc_hqx(identifier.to_bytes(2, "little") + body, CRC16_INIT)
    return Frame(identifier, body + check.to_bytes(2, "little"), is_fd)


def param_body(op: int, parameter: int, value: int = 0) -> bytes:
    """Return PARAM_REQUEST without its check."""
    return struct.pack("<BHi", op, parameter, value)


def heartbeat_body(control: int, major: int, minor: int, sequence: int, reserved: bytes = bytes(3)) -> bytes:
    """Return HOST_HEARTBEAT without its check."""
    return bytes((control, major, minor)) + reserved + bytes((sequence & 0xFF,))


def assign_body(serial_number: int, new_node: int) -> bytes:
    """Return ASSIGN_NODE without its check."""
    return serial_number.to_bytes(6, "little") + bytes((new_node,))


def setpoint(
    fd: bool, node: int, theta_raw: int, sequence: int, sample_sequence: int, reserved: int | None = None
) -> Frame:
    """Return SETPOINT or FD_SETPOINT; `reserved` (SETPOINT only) fills its reserved byte."""
    body = struct.pack("<iBB", theta_raw, sequence & 0xFF, sample_sequence & 0xFF)
    if fd:
        return sealed16(Function.FD_SETPOINT, node, body)
    return sealed8(Function.SETPOINT, node, body + bytes((reserved or 0,)))


def damaged(frame: Frame, mask: int = 0x55, position: int = -1) -> Frame:
    """Return the frame with bits of one byte flipped, of the check by default."""
    data = bytearray(frame.data)
    data[position] ^= mask
    return frame._replace(data=bytes(data))
