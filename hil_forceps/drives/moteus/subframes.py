"""Subframes, of which the frames of moteus' register protocol are made: they write, read and tell registers; pure.

Sources: mjbots/moteus, `docs/protocol/can.md`; mjbots/mjlib, `multiplex/format.h`.
"""

import math
import struct
from typing import Final, Literal, NamedTuple

from firmware_protocol.serial_framing import FD_LENGTHS

_NOP: Final = 0x50
_LONGEST: Final = max(FD_LENGTHS)
_KINDS: Final[dict[int, Literal["write", "read", "reply"]]] = {0x00: "write", 0x10: "read", 0x20: "reply"}
_ERRORS: Final[dict[int, Literal["write error", "read error"]]] = {0x30: "write error", 0x31: "read error"}
_VALUES: Final = tuple(struct.Struct(f"<{code}") for code in "bhif")
_SENTINELS: Final = (-(1 << 7), -(1 << 15), -(1 << 31))  # the lowest integer stands for NaN
_VARUINT_BYTES: Final = 5


class Subframe(NamedTuple):
    """A part of a frame: registers from `register` on. `number` of them; reads have no values, errors their code."""

    kind: Literal["write", "read", "reply", "write error", "read error"]
    resolution: int  # 0 to 3: int8, int16, int32, float
    register: int
    values: tuple[float, ...]
    number: int


def padded(data: bytes) -> bytes:
    """Return bytes, filled up with NOPs to a length that CAN FD has."""
    return data.ljust(min(length for length in FD_LENGTHS if length >= len(data)), bytes((_NOP,)))


def parse_subframes(data: bytes) -> list[Subframe] | None:
    """Return the subframes of a frame; None where any is not whole, or of a kind that isn't known here."""
    found: list[Subframe] = []
    at = 0
    while at < len(data):
        code, at = data[at], at + 1
        if code == _NOP:
            continue
        subframe, at = _error(code, data, at) if code in _ERRORS else _registers(code, data, at)
        if subframe is None:
            return None
        found.append(subframe)
    return found


def _error(code: int, data: bytes, at: int) -> tuple[Subframe | None, int]:
    register, at = _varuint(data, at)
    number, at = _varuint(data, at)
    if register is None or number is None:
        return None, at
    return Subframe(_ERRORS[code], 0, register, (float(number),), 1), at


def _registers(code: int, data: bytes, at: int) -> tuple[Subframe | None, int]:
    kind, resolution = _KINDS.get(code & 0xF0), code >> 2 & 3
    count: int | None = code & 3
    if not count:
        count, at = _varuint(data, at)
    register, at = _varuint(data, at)
    if kind is None or not count or count > _LONGEST or register is None:
        return None, at
    if kind == "read":
        return Subframe(kind, resolution, register, (), count), at
    value = _VALUES[resolution]
    end = at + count * value.size
    if end > len(data):
        return None, at
    values = tuple(_value(resolution, value.unpack_from(data, place)[0]) for place in range(at, end, value.size))
    return Subframe(kind, resolution, register, values, count), end


def _value(resolution: int, value: float) -> float:
    return math.nan if resolution < len(_SENTINELS) and value == _SENTINELS[resolution] else value


def _varuint(data: bytes, at: int) -> tuple[int | None, int]:
    """Return a number of seven bits a byte, lowest first, and where it ends; None where it isn't whole."""
    number = 0
    for place, byte in enumerate(data[at : at + _VARUINT_BYTES]):
        number |= (byte & 0x7F) << 7 * place
        if not byte & 0x80:
            return number, at + place + 1
    return None, len(data)
