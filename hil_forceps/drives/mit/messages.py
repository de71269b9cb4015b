"""The frames of the mini cheetah protocol ("MIT mode"); pure.

Big-endian bit fields. A command is p16 v12 kp12 kd12 t12 on the motor's id; an answer is the motor's id, p16 v12 t12
and up to two bytes that each maker fills otherwise. Each field is a code over a range that both sides must know:
nothing on the bus tells it. Sources: bgkatz/motorcontrol, `Core/Src/can.c`, `math_ops.c`, `stm32f4xx_it.c` (3586419);
CubeMars, AK Series Actuator Driver Manual V1.0.8, 5.3, and Gimbal Motor Drive User Manual V1.0 for GL II, which
answers as DaMiao's do; DaMiao, manuals of DM-J4310-2EC and DM-H6215.
"""

from enum import IntEnum
from typing import Final, Literal, NamedTuple

from firmware_protocol.frames import Frame

Variant = Literal["bgkatz", "cubemars", "damiao"]

MAX_NODE: Final = 126
MAX_ID: Final = 0x7FF
MAX_POSITION_CODE: Final = (1 << 16) - 1
MAX_CODE: Final = (1 << 12) - 1
# Zero lies half way between two codes. Speed goes to the one above, torque to the one below: so both errors oppose.
ZERO_SPEED_CODE: Final = MAX_CODE // 2 + 1
ZERO_TORQUE_CODE: Final = MAX_CODE // 2
_REPLY_LENGTHS: Final = frozenset({6, 7, 8})
_SPECIAL: Final = b"\xff" * 7


class Special(IntEnum):
    """Last byte behind seven FFh."""

    CLEAR_ERRORS = 0xFB  # DaMiao
    ENTER = 0xFC
    EXIT = 0xFD
    SET_ZERO = 0xFE


_SPECIAL_CODES: Final = frozenset(int(each) for each in Special)
# Upper half of the first byte of a DaMiao's answer; above these are faults.
DISABLED, ENABLED = 0x0, 0x1
FAULT_WORDS: Final[dict[Variant, dict[int, str]]] = {
    "bgkatz": {},
    "cubemars": {
        1: "over temperature",
        2: "over current",
        3: "over voltage",
        4: "under voltage",
        5: "encoder",
        6: "phase currents unbalanced",
    },
    "damiao": {
        0x8: "over voltage",
        0x9: "under voltage",
        0xA: "over current",
        0xB: "transistors too hot",
        0xC: "motor too hot",
        0xD: "communication lost",
        0xE: "overload",
    },
}


class Ranges(NamedTuple):
    """What the codes span: ± for position, speed and torque, from 0 for the gains; of the drive's own shaft."""

    position_rad: float
    speed_rad_per_s: float
    kp_N_m_per_rad: float
    kd_N_m_s_per_rad: float
    torque_N_m: float


class Codes(NamedTuple):
    """A command."""

    position: int
    speed: int
    kp: int
    kd: int
    torque: int


class Reply(NamedTuple):
    """An answer, in codes; `extra` is what its length leaves, at most two bytes."""

    head: int  # the motor's id; a DaMiao has its status in the upper half
    position: int
    speed: int
    torque: int
    extra: bytes


def code_of(value: float, low: float, high: float, codes: int) -> int:
    """Return the nearest code, as drives take codes: `low + code (high - low) / codes`; ValueError beyond the range."""
    if not low <= value <= high:
        raise ValueError(f"{value:g} is beyond {low:g} to {high:g}")
    return round((value - low) / (high - low) * codes)


def value_of(code: int, low: float, high: float, codes: int) -> float:
    """Return what a drive takes a code of a command for."""
    return low + code * (high - low) / codes


def measured(code: int, half_range: float, codes: int) -> float:
    """Return the middle of what a drive gives this code: all known ones cut off, so a code stands for the step above.

    A measured zero is the code below the middle, and so comes out as zero.
    """
    return (code + 0.5) * 2.0 * half_range / codes - half_range


def special(node: int, which: Special) -> Frame:
    """Return a frame without values."""
    return Frame(node, _SPECIAL + bytes((which,)))


def special_of(data: bytes) -> Special | None:
    """Return which frame without values this is; None where it is none."""
    if len(data) != 8 or data[:7] != _SPECIAL or data[7] not in _SPECIAL_CODES:
        return None
    return Special(data[7])


def command(node: int, codes: Codes) -> Frame:
    """Return a command; ValueError for codes that its fields don't hold."""
    position, speed, kp, kd, torque = codes
    if not 0 <= position <= MAX_POSITION_CODE or not all(0 <= code <= MAX_CODE for code in codes[1:]):
        raise ValueError(f"no command: {codes}")
    packed = position << 48 | speed << 36 | kp << 24 | kd << 12 | torque
    return Frame(node, packed.to_bytes(8, "big"))


def parse_command(data: bytes) -> Codes | None:
    """Return the fields of a command; None for another length and for frames without values."""
    if len(data) != 8 or special_of(data) is not None:
        return None
    packed = int.from_bytes(data, "big")
    return Codes(
        packed >> 48, packed >> 36 & MAX_CODE, packed >> 24 & MAX_CODE, packed >> 12 & MAX_CODE, packed & MAX_CODE
    )


def parse_reply(data: bytes) -> Reply | None:
    """Return the fields of an answer; None for another length."""
    if len(data) not in _REPLY_LENGTHS:
        return None
    packed = int.from_bytes(data[1:6], "big")
    return Reply(data[0], packed >> 24, packed >> 12 & MAX_CODE, packed & MAX_CODE, data[6:])


def is_from(variant: Variant, node: int, reply: Reply) -> bool:
    """Tell whether an answer is from this motor; a DaMiao's has the lower half of its id alone."""
    return (reply.head ^ node) & 0xF == 0 if variant == "damiao" else reply.head == node


def status_of(variant: Variant, reply: Reply) -> int | None:
    """Return the status that an answer tells; None where its kind tells none."""
    return reply.head >> 4 if variant == "damiao" else None


def fault_of(variant: Variant, reply: Reply) -> int:
    """Return the fault that an answer tells, 0 for none; a bgkatz tells none."""
    status = status_of(variant, reply)
    if status is not None:
        return 0 if status in {DISABLED, ENABLED} else status
    return reply.extra[1] if variant == "cubemars" and len(reply.extra) == 2 else 0


def fault_words(variant: Variant, fault: int) -> str:
    """Return a fault in words, an unknown one by its number."""
    return f"error {fault:X}h ({FAULT_WORDS[variant].get(fault, 'unknown')})" if fault else "no error reported"
