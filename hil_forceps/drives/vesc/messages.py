"""The frames of a VESC's CAN bus that a host of one motor needs; pure.

Big-endian; the 29-bit arbitration id is command << 8 | id. A command goes to the VESC's id; an answer goes to the id
of who asked, in fragments (`answers.py`). Layouts: the maker's documentation/comm_can.md, and where that refers to the
firmware's source, comm/comm_can.c, comm/commands.c and datatypes.h of firmware 7.01. The firmware truncates towards
zero where it makes integers.
"""

import struct
from enum import IntEnum
from typing import Any, Final, NamedTuple

from firmware_protocol.frames import Frame

HOST_ID: Final = 253  # where one VESC is on the bus; VESC Tool takes 254; 255 is everybody
MAX_NODE: Final = 252
EVERYBODY: Final = 255
MAX_COMMAND: Final = 0xFF


class Command(IntEnum):
    """CAN_PACKET_ID."""

    SET_DUTY = 0
    SET_CURRENT = 1
    SET_CURRENT_BRAKE = 2
    SET_RPM = 3
    SET_POS = 4
    FILL_RX_BUFFER = 5
    PROCESS_RX_BUFFER = 7
    PROCESS_SHORT_BUFFER = 8
    STATUS = 9
    SET_CURRENT_REL = 10
    SET_CURRENT_BRAKE_REL = 11
    SET_CURRENT_HANDBRAKE = 12
    SET_CURRENT_HANDBRAKE_REL = 13
    STATUS_2 = 14
    STATUS_3 = 15
    STATUS_4 = 16
    PING = 17
    PONG = 18
    STATUS_5 = 27
    NOTIFY_BOOT = 57
    STATUS_6 = 58


MOVING: Final = frozenset({
    Command.SET_DUTY, Command.SET_CURRENT, Command.SET_CURRENT_BRAKE, Command.SET_RPM, Command.SET_POS,
    Command.SET_CURRENT_REL, Command.SET_CURRENT_BRAKE_REL, Command.SET_CURRENT_HANDBRAKE,
    Command.SET_CURRENT_HANDBRAKE_REL,
})  # fmt: skip
BROADCAST: Final = frozenset({
    Command.STATUS, Command.STATUS_2, Command.STATUS_3, Command.STATUS_4, Command.STATUS_5, Command.STATUS_6,
})  # fmt: skip

GET_VALUES_SELECTIVE: Final = 50  # COMM_PACKET_ID
_AND_ANSWER: Final = 0  # second byte of PROCESS_SHORT_BUFFER: process, and answer to the sender
_CURRENT_BIT, _FAULT_BIT, _POSITION_BIT, _STATUS_BIT = 1 << 5, 1 << 15, 1 << 16, 1 << 21
MASK: Final = _CURRENT_BIT | _FAULT_BIT | _POSITION_BIT | _STATUS_BIT
TAG_SHIFT: Final = 24  # the bits above, of which firmware 7.01 knows none, come back with the mask

CURRENT_LSB_A: Final = 1e-2  # of avg_iq in an answer
_POSITION_SCALE: Final = 1e6
FULL_TURN_DEG: Final = 360.0
_MICRODEGREES: Final = 360_000_000

_ID_AND_MASK: Final = struct.Struct(">BI")
_VALUES: Final = struct.Struct(">iBiB")
_WORD: Final = struct.Struct(">i")


class Values(NamedTuple):
    """An answer to COMM_GET_VALUES_SELECTIVE with `MASK`, all of one instant."""

    current_A: float  # avg_iq: mean since whoever asked last; positive makes the angle grow; 0: less than a step
    fault: int
    position_rev: float  # 0 to 1: it wraps
    has_timeout: bool  # no command came for longer than the VESC's timeout
    is_killed: bool  # by the kill switch
    tag: int  # of the request


def frame_id(node: int, command: int) -> int:
    """Return the arbitration id of a command."""
    return command << 8 | node


def node_and_command(frame: Frame) -> tuple[int, int] | None:
    """Return what an id says, the command perhaps one that isn't known here; None for what can't be a VESC's."""
    if not frame.is_extended or frame.is_fd or frame.arbitration_id >> 8 > MAX_COMMAND:
        return None
    return frame.arbitration_id & 0xFF, frame.arbitration_id >> 8


def set_position(node: int, position_rev: float) -> Frame:
    """Return SET_POS, of the angle within its turn: the VESC goes there by the shorter way."""
    microdegrees = round(position_rev * FULL_TURN_DEG * _POSITION_SCALE) % _MICRODEGREES
    return _frame(node, Command.SET_POS, _WORD.pack(microdegrees))


def release(node: int) -> Frame:
    """Return SET_CURRENT of 0 A: below the VESC's minimum current, so it stops its modulation."""
    return _frame(node, Command.SET_CURRENT, _WORD.pack(0))


def request(node: int, tag: int = 0, host_id: int = HOST_ID) -> Frame:
    """Return the request of current, angle, fault and state; it doesn't feed the VESC's timeout."""
    data = bytes((host_id, _AND_ANSWER)) + _ID_AND_MASK.pack(GET_VALUES_SELECTIVE, MASK | tag << TAG_SHIFT)
    return _frame(node, Command.PROCESS_SHORT_BUFFER, data)


def parse_values(payload: bytes) -> Values | None:
    """Return an answer's values; None for another answer and for an angle that is none."""
    if len(payload) != _ID_AND_MASK.size + _VALUES.size or not _is_answer(payload):
        return None
    current, fault, position, status = _VALUES.unpack_from(payload, _ID_AND_MASK.size)
    if not 0 <= position <= _MICRODEGREES:
        return None
    return Values(
        _middle(current) * CURRENT_LSB_A,
        fault,
        position / _POSITION_SCALE / FULL_TURN_DEG,
        bool(status & 1),
        bool(status & 2),
        payload[1],
    )


def _middle(truncated: int) -> float:
    """Return the middle of the numbers that are truncated to this one: without it, currents are half a step small."""
    return truncated + 0.5 * ((truncated > 0) - (truncated < 0))


def lacks_status(payload: bytes) -> bool:
    """Tell whether an answer is that of a firmware before 5.03, which leaves out what it doesn't know."""
    return len(payload) == _ID_AND_MASK.size + _VALUES.size - 1 and _is_answer(payload)


def _is_answer(payload: bytes) -> bool:
    packet, mask = _ID_AND_MASK.unpack_from(payload)
    return (packet, mask & ((1 << TAG_SHIFT) - 1)) == (GET_VALUES_SELECTIVE, MASK)


def _frame(node: int, command: Command, data: bytes) -> Frame:
    return Frame(frame_id(node, command), data, is_extended=True)


class _Layout(NamedTuple):
    format: struct.Struct
    fields: tuple[tuple[str, float], ...]  # name with unit, units on the wire to one


def _layout(form: str, *fields: tuple[str, float]) -> _Layout:
    return _Layout(struct.Struct(form), fields)


# What has one layout only, for people: commands and broadcasts.
LAYOUTS: Final[dict[Command, _Layout]] = {
    Command.SET_DUTY: _layout(">i", ("duty", 1e5)),
    Command.SET_CURRENT: _layout(">i", ("current_A", 1e3)),
    Command.SET_CURRENT_BRAKE: _layout(">i", ("current_A", 1e3)),
    Command.SET_RPM: _layout(">i", ("erpm", 1)),
    Command.SET_POS: _layout(">i", ("position_deg", 1e6)),
    Command.SET_CURRENT_REL: _layout(">i", ("share", 1e5)),
    Command.SET_CURRENT_BRAKE_REL: _layout(">i", ("share", 1e5)),
    Command.SET_CURRENT_HANDBRAKE: _layout(">i", ("current_A", 1e3)),
    Command.SET_CURRENT_HANDBRAKE_REL: _layout(">i", ("share", 1e5)),
    Command.STATUS: _layout(">ihh", ("erpm", 1), ("current_without_direction_A", 10), ("duty", 1e3)),
    Command.STATUS_2: _layout(">ii", ("used_Ah", 1e4), ("charged_Ah", 1e4)),
    Command.STATUS_3: _layout(">ii", ("used_Wh", 1e4), ("charged_Wh", 1e4)),
    Command.STATUS_4: _layout(
        ">hhhh", ("fet_degC", 10), ("motor_degC", 10), ("input_current_A", 10), ("position_deg", 50)
    ),
    Command.STATUS_5: _layout(">ih2x", ("electrical_rev", 6), ("input_V", 10)),
    Command.STATUS_6: _layout(">hhhh", ("adc1_V", 1e3), ("adc2_V", 1e3), ("adc3_V", 1e3), ("ppm", 1e3)),
}


def parse_plain(command: Command, data: bytes) -> dict[str, Any] | None:
    """Return the values of a command or broadcast by `LAYOUTS`; None for another one, or another length."""
    layout = LAYOUTS.get(command)
    if layout is None or len(data) != layout.format.size:
        return None
    numbers = layout.format.unpack(data)
    return {
        name: number if scale == 1 else number / scale
        for (name, scale), number in zip(layout.fields, numbers, strict=True)
    }
