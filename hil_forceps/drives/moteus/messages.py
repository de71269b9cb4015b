"""The frames of moteus' register protocol that a host of one axis needs; pure.

A frame holds subframes that write or read registers, little-endian, and is filled up with NOPs to a length that CAN FD
has. The arbitration id is source << 8 | destination, with bit 15 where an answer is asked for; it goes as 11 bits where
it fits, else as 29. Sources: mjbots/moteus, `docs/protocol/can.md` and `registers.md`; `fw/fdcan.cc` for the kind of id
(the document says 7FFFh where the firmware parts at 7FFh); mjbots/mjlib, `multiplex/micro_server.cc`, for what is
answered to what.
"""

import math
import struct
from enum import IntEnum
from typing import Final, NamedTuple

from firmware_protocol.frames import MAX_BASE_ID, Frame
from hil_forceps.drives.moteus.subframes import padded, parse_subframes

REGISTER_MAP: Final = 5  # what 0x102 has to say for the registers to be these
HOST_ID: Final = 0  # as the maker's own programs have it; no drive can have this one
MAX_NODE: Final = 126  # 127 is everybody's (mjlib, `multiplex/format.h`), where the document says 0
UNLIMITED: Final = -1.0  # of a velocity or an acceleration: no limit, whatever is configured
_REPLY_WANTED: Final = 0x8000
_EVERYBODY: Final = 127


class Mode(IntEnum):
    """What register 0x000 says."""

    STOPPED = 0
    FAULT = 1
    ENABLING = 2
    CALIBRATING = 3
    CALIBRATION_COMPLETE = 4
    PWM = 5
    VOLTAGE = 6
    VOLTAGE_FOC = 7
    VOLTAGE_DQ = 8
    CURRENT = 9
    POSITION = 10
    TIMEOUT = 11
    ZERO_VELOCITY = 12
    STAY_WITHIN = 13
    MEASURE_INDUCTANCE = 14
    BRAKE = 15


class Register(IntEnum):
    """Registers that are used here."""

    MODE = 0x000
    POSITION = 0x001
    VELOCITY = 0x002
    Q_CURRENT = 0x004
    FAULT = 0x00F
    COMMAND_POSITION = 0x020
    COMMAND_MAX_TORQUE = 0x025
    COMMAND_TIMEOUT = 0x027
    COMMAND_VELOCITY_LIMIT = 0x028
    COMMAND_ACCEL_LIMIT = 0x029
    MILLISECONDS = 0x070
    FIRMWARE_VERSION = 0x101
    REGISTER_MAP_VERSION = 0x102


# Register 0x00f while the mode is FAULT. In other modes it says what limits the torque (96 on), which is no fault.
FAULT_WORDS: Final[dict[int, str]] = {
    32: "calibration fault",
    33: "motor driver fault, often under voltage",
    34: "over voltage",
    35: "encoder fault",
    36: "motor not configured",
    37: "PWM cycle overrun",
    38: "over temperature",
    39: "outside servopos.position_min and position_max at the start",
    40: "under voltage",
    41: "configuration changed",
    42: "theta invalid: no commutation encoder",
    43: "position invalid: no output encoder",
    44: "gate driver could not be enabled",
    45: "stop position deprecated",
    46: "timing violation",
    47: "servo.bemf_feedforward is set, but no acceleration limit: set it to 0",
    48: "servopos.position_min or position_max beyond what a position can be",
    49: "position error above servo.fault_position_error",
    50: "velocity error above servo.fault_velocity_error",
}


class Feedback(NamedTuple):
    """The answer to `QUERY`; position, velocity and current may be NaN, which is how a moteus says that it has none."""

    mode: int
    position_rev: float  # of the output
    velocity_rev_per_s: float
    q_current_A: float
    fault: int
    milliseconds: int  # since it was started, signed 32 bits that wrap


class Identity(NamedTuple):
    """What firmware it is."""

    firmware: int  # one byte each: major, minor, micro
    register_map: int


class Command(NamedTuple):
    """What every position command carries: a moteus forgets all of it with the next."""

    max_torque_N_m: float  # at the output
    watchdog_s: float


_WRITE_POSITION_MODE: Final = bytes((0x01, Register.MODE, Mode.POSITION))
_WRITE_STOPPED: Final = bytes((0x01, Register.MODE, Mode.STOPPED))
_READ_IDENTITY: Final = bytes((0x1A, 0x81, 0x02))  # two int32 from 0x101 on
# One int8, two floats, one float, one int8, one int32: what `Feedback` takes.
QUERY: Final = bytes((
    0x11, Register.MODE, 0x1E, Register.POSITION, 0x1D, Register.Q_CURRENT, 0x11, Register.FAULT,
    0x19, Register.MILLISECONDS,
))  # fmt: skip
# A moteus answers each read with a reply of the same form, in the same order.
_FEEDBACK: Final = struct.Struct("<HbHffHfHbHi")
_FEEDBACK_HEADS: Final = tuple(
    int.from_bytes(bytes((QUERY[at] + 0x10, QUERY[at + 1])), "little") for at in range(0, 10, 2)
)
_FLOAT: Final = struct.Struct("<f")


def request_id(node: int) -> int:
    """Return the id of a frame that wants an answer; it has 29 bits."""
    return _REPLY_WANTED | HOST_ID << 8 | node


def ask_all() -> Frame:
    """Return the question for mode and fault to every moteus on the bus; it writes nothing and feeds no watchdog."""
    return Frame(request_id(_EVERYBODY), bytes((0x11, Register.MODE, 0x11, Register.FAULT)), True, True)


def reply_id(node: int) -> int:
    """Return the id of the answers of a node; it has 29 bits from node 8 on."""
    return node << 8 | HOST_ID


def is_extended(arbitration_id: int) -> bool:
    """Return whether an id goes as 29 bits."""
    return arbitration_id > MAX_BASE_ID


def query(node: int) -> Frame:
    """Return a frame that reads what `Feedback` takes; it commands nothing, and feeds no watchdog."""
    return _request(node, QUERY)


def identify(node: int) -> Frame:
    """Return a query that asks for the version of firmware and registers, too."""
    return _request(node, QUERY + _READ_IDENTITY)


def stop(node: int) -> Frame:
    """Return the command that takes the torque off and clears fault and timeout; with a query."""
    return _request(node, _WRITE_STOPPED + QUERY)


def position_command(node: int, command: Command) -> tuple[int, bytes, bytes]:
    """Return id, bytes before and bytes after the position of a command: no trajectory, no feed-forward, a query.

    Velocity and acceleration limits are switched off in each command, or a moteus would lead its reference to the
    position at those that it has configured (servo.default_accel_limit is 50 rev/s² since firmware of April 2026).
    ValueError for what is no finite positive number: NaN would mean no limit, and no watchdog.
    """
    if not all(math.isfinite(value) and value >= 0.0 for value in command):
        raise ValueError(f"no command for a moteus: {command}")
    head = _WRITE_POSITION_MODE + bytes((0x0D, Register.COMMAND_POSITION))
    limits = struct.pack("<fff", command.watchdog_s, UNLIMITED, UNLIMITED)
    torque = _FLOAT.pack(command.max_torque_N_m)
    tail = bytes((0x0D, Register.COMMAND_MAX_TORQUE)) + torque + bytes((0x0F, Register.COMMAND_TIMEOUT)) + limits
    whole = padded(head + bytes(_FLOAT.size) + tail + QUERY)
    return request_id(node), head, whole[len(head) + _FLOAT.size :]


def pack_position(position_rev: float) -> bytes:
    """Return a position as it stands between the two parts of `position_command`."""
    return _FLOAT.pack(position_rev)


def parse_feedback(data: bytes) -> Feedback | None:
    """Return the answer to `QUERY`, None for another one; what follows it is not looked at."""
    if len(data) < _FEEDBACK.size:
        return None
    mode_head, mode, motion_head, position, velocity, current_head, current, fault_head, fault, time_head, time_ms = (
        _FEEDBACK.unpack_from(data)
    )
    if (mode_head, motion_head, current_head, fault_head, time_head) != _FEEDBACK_HEADS:
        return None
    return Feedback(mode, position, velocity, current, fault, time_ms)


def parse_identity(data: bytes) -> Identity | None:
    """Return the versions in an answer to `identify`; None for an answer without them."""
    values = {
        subframe.register + place: value
        for subframe in parse_subframes(data) or ()
        if subframe.kind == "reply"
        for place, value in enumerate(subframe.values)
    }
    found = values.get(Register.FIRMWARE_VERSION), values.get(Register.REGISTER_MAP_VERSION)
    return Identity(int(found[0]), int(found[1])) if all(map(_is_integer, found)) else None  # type: ignore[arg-type]


def refused_register(data: bytes) -> int | None:
    """Return the first register of which an answer says that there is none; None without such."""
    errors = (each.register for each in parse_subframes(data) or () if each.kind == "read error")
    return next(errors, None)


def fault_words(mode: int, fault: int) -> str:
    """Return why it has no torque, in words."""
    if mode == Mode.TIMEOUT:
        return "watchdog expired (mode 11)"
    return f"fault {fault} ({FAULT_WORDS.get(fault, 'unknown')})" if mode == Mode.FAULT else "no fault reported"


def version_words(firmware: int) -> str:
    """Return a firmware's number as its maker writes it."""
    return f"{firmware >> 16 & 0xFF}.{firmware >> 8 & 0xFF}.{firmware & 0xFF}"


def _request(node: int, data: bytes) -> Frame:
    return Frame(request_id(node), padded(data), True, True)


def _is_integer(value: float | None) -> bool:
    return value is not None and math.isfinite(value)
