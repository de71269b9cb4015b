"""The frames of ODrive's CANSimple that a host of one axis needs; pure.

Little-endian; the arbitration id is node << 5 | command. Layouts: ODrive's documentation of its CAN protocol for
firmware 0.5.6 and 0.6; the tests hold every frame against DBC files made by others.
"""

import math
import struct
from enum import IntEnum
from typing import Final, Literal, NamedTuple

from firmware_protocol.frames import Frame

Firmware = Literal["0.5", "0.6"]

MAX_NODE: Final = 0x3E  # 0x3F is everybody's
_COMMAND_BITS: Final = 5


class Command(IntEnum):
    """Commands by their number."""

    HEARTBEAT = 0x01
    ESTOP = 0x02
    SET_AXIS_STATE = 0x07
    ENCODER_ESTIMATES = 0x09
    SET_CONTROLLER_MODE = 0x0B
    SET_INPUT_POS = 0x0C
    SET_LIMITS = 0x0F
    GET_IQ = 0x14
    CLEAR_ERRORS = 0x18


class AxisState(IntEnum):
    """States of an axis that matter here."""

    UNDEFINED = 0
    IDLE = 1
    CLOSED_LOOP_CONTROL = 8


POSITION_CONTROL: Final = 3
PASSTHROUGH: Final = 1

# Bits of Axis_Error (0.5) and Active_Errors (0.6) that a user meets, in words.
ERROR_WORDS: Final[dict[Firmware, dict[int, str]]] = {
    "0.5": {
        0x1: "invalid state requested",
        0x40: "motor failed",
        0x100: "encoder failed",
        0x200: "controller failed",
        0x800: "watchdog expired",
        0x1000: "end stop at the minimum",
        0x2000: "end stop at the maximum",
        0x4000: "emergency stop",
    },
    "0.6": {
        0x1: "initializing",
        0x2: "system level",
        0x4: "timing error",
        0x8: "missing estimate",
        0x10: "bad configuration",
        0x20: "driver fault",
        0x40: "missing input",
        0x100: "DC bus over voltage",
        0x200: "DC bus under voltage",
        0x400: "DC bus over current",
        0x800: "DC bus over regeneration current",
        0x1000: "current limit violation",
        0x2000: "motor over temperature",
        0x4000: "inverter over temperature",
        0x8000: "velocity limit violation",
        0x10000: "position limit violation",
        0x1000000: "watchdog expired",
        0x2000000: "emergency stop",
        0x4000000: "spin out detected",
        0x8000000: "brake resistor disarmed",
        0x10000000: "thermistor disconnected",
        0x40000000: "calibration error",
    },
}


class Heartbeat(NamedTuple):
    """HEARTBEAT, what both firmwares have in common."""

    axis_error: int
    axis_state: int


class Estimates(NamedTuple):
    """ENCODER_ESTIMATES."""

    position_rev: float
    velocity_rev_per_s: float


class Iq(NamedTuple):
    """GET_IQ."""

    setpoint_A: float
    measured_A: float


_PAIR: Final = struct.Struct("<ff")
_HEARTBEAT: Final = struct.Struct("<IB3x")
_INPUT_POS: Final = struct.Struct("<fhh")
_TWO_WORDS: Final = struct.Struct("<II")
_WORD: Final = struct.Struct("<I4x")  # with the padding of the maker's DBC


def frame_id(node: int, command: Command) -> int:
    """Return the arbitration id of a command of a node."""
    return node << _COMMAND_BITS | command


def node_and_command(arbitration_id: int) -> tuple[int, int]:
    """Return what an arbitration id says; the command may be one that isn't known here."""
    return arbitration_id >> _COMMAND_BITS, arbitration_id & ((1 << _COMMAND_BITS) - 1)


def parse_heartbeat(data: bytes) -> Heartbeat | None:
    """Return the heartbeat, None for a frame of another length."""
    return Heartbeat(*_HEARTBEAT.unpack(data)) if len(data) == _HEARTBEAT.size else None


def parse_estimates(data: bytes) -> Estimates | None:
    """Return position and velocity; None for another length and for what is no finite number."""
    values = parse_pair(data)
    return None if values is None else Estimates(*values)


def parse_iq(data: bytes) -> Iq | None:
    """Return both currents; None for another length and for what is no finite number."""
    values = parse_pair(data)
    return None if values is None else Iq(*values)


def parse_input_pos(data: bytes) -> dict[str, float] | None:
    """Return position and feed-forwards of SET_INPUT_POS; None for another length."""
    if len(data) != _INPUT_POS.size:
        return None
    position, velocity, torque = _INPUT_POS.unpack(data)
    return {"position_rev": position, "velocity_ff_rev_per_s": velocity * 1e-3, "torque_ff_N_m": torque * 1e-3}


def set_axis_state(node: int, state: AxisState) -> Frame:
    """Return SET_AXIS_STATE."""
    return Frame(frame_id(node, Command.SET_AXIS_STATE), _WORD.pack(state))


def set_position_control(node: int) -> Frame:
    """Return SET_CONTROLLER_MODE: position control, input passed through."""
    return Frame(frame_id(node, Command.SET_CONTROLLER_MODE), _TWO_WORDS.pack(POSITION_CONTROL, PASSTHROUGH))


def set_limits(node: int, velocity_rev_per_s: float, current_A: float) -> Frame:
    """Return SET_LIMITS."""
    return Frame(frame_id(node, Command.SET_LIMITS), _PAIR.pack(velocity_rev_per_s, current_A))


def set_input_pos(node: int, position_rev: float) -> Frame:
    """Return SET_INPUT_POS without feed-forward."""
    return Frame(frame_id(node, Command.SET_INPUT_POS), _INPUT_POS.pack(position_rev, 0, 0))


def clear_errors(node: int) -> Frame:
    """Return CLEAR_ERRORS; with firmware 0.5 it clears those of every axis of the board."""
    return Frame(frame_id(node, Command.CLEAR_ERRORS), bytes(1))


def estop(node: int) -> Frame:
    """Return ESTOP."""
    return Frame(frame_id(node, Command.ESTOP), b"")


def error_words(firmware: Firmware, error: int) -> str:
    """Return the bits of an axis error in words, unknown ones by their value."""
    known = ERROR_WORDS[firmware]
    words = [known.get(1 << bit, f"0x{1 << bit:x}") for bit in range(32) if error >> bit & 1]
    return f"axis error 0x{error:x} ({', '.join(words)})" if words else "no error reported"


def parse_pair(data: bytes) -> tuple[float, float] | None:
    """Return two 32-bit floats; None for another length and for what is no finite number."""
    if len(data) != _PAIR.size:
        return None
    first, second = _PAIR.unpack(data)
    return (first, second) if math.isfinite(first) and math.isfinite(second) else None
