"""The CANopen frames that a host of one CiA 402 drive needs; pure.

CiA 301: NMT, SYNC, EMCY, expedited SDO, heartbeat, with the predefined connection set. CiA 402: statusword and
controlword.
"""

import struct
from enum import Enum, IntEnum
from typing import Final, NamedTuple

from firmware_protocol.frames import Frame

NMT_ID, SYNC_ID, EMCY_ID = 0x000, 0x080, 0x080
TPDO_IDS: Final = (0x180, 0x280)
RPDO1_ID, SDO_ANSWER_ID, SDO_REQUEST_ID, HEARTBEAT_ID = 0x200, 0x580, 0x600, 0x700


class Nmt(IntEnum):
    """Commands of the network's master."""

    START = 0x01
    PRE_OPERATIONAL = 0x80


class NmtState(IntEnum):
    """What a heartbeat says of its node."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class State(Enum):
    """States of a CiA 402 drive; the value is (mask, bits) of its statusword."""

    NOT_READY = (0x4F, 0x00)
    SWITCH_ON_DISABLED = (0x4F, 0x40)
    READY_TO_SWITCH_ON = (0x6F, 0x21)
    SWITCHED_ON = (0x6F, 0x23)
    OPERATION_ENABLED = (0x6F, 0x27)
    QUICK_STOP = (0x6F, 0x07)
    FAULT_REACTION = (0x4F, 0x0F)
    FAULT = (0x4F, 0x08)


class Control(IntEnum):
    """Controlwords."""

    DISABLE_VOLTAGE = 0x00
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE_OPERATION = 0x0F
    FAULT_RESET = 0x80


# What leads from each state one step nearer to OPERATION_ENABLED.
TOWARDS_ENABLED: Final[dict[State, Control]] = {
    State.SWITCH_ON_DISABLED: Control.SHUTDOWN,
    State.READY_TO_SWITCH_ON: Control.SWITCH_ON,
    State.SWITCHED_ON: Control.ENABLE_OPERATION,
    State.OPERATION_ENABLED: Control.ENABLE_OPERATION,
    State.QUICK_STOP: Control.DISABLE_VOLTAGE,
}
TORQUE_FREE: Final = frozenset({State.NOT_READY, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.FAULT})


class Entry(NamedTuple):
    """An object of the dictionary with the value to be written to it."""

    object_index: int
    subindex: int
    size: int  # bytes
    value: int


class SdoAnswer(NamedTuple):
    """What an SDO server said: a value, nothing (a write was taken), or why not."""

    object_index: int
    subindex: int
    value: int | None
    abort: int | None


_ABORT_WORDS: Final = {
    0x05040000: "the transfer timed out",
    0x06010000: "access is not supported",
    0x06010002: "it is read-only",
    0x06020000: "there is no such object",
    0x06040041: "it can't be mapped to a PDO",
    0x06040042: "the PDO would be too long",
    0x06070010: "its length is different",
    0x06090011: "there is no such subindex",
    0x06090030: "the value is out of range",
    0x08000020: "it can't be stored",
    0x08000022: "the device's state forbids it",
}
_DOWNLOAD: Final = {1: 0x2F, 2: 0x2B, 4: 0x23}
_UPLOADED: Final = {0x4F: 1, 0x4B: 2, 0x43: 4}
_EMCY: Final = struct.Struct("<HB5x")


def state_of(statusword: int) -> State | None:
    """Return the state that a statusword says; None where it is none of CiA 402."""
    for state in State:
        mask, bits = state.value
        if statusword & mask == bits:
            return state
    return None


def nmt(command: Nmt, node: int) -> Frame:
    """Return an NMT command to one node."""
    return Frame(NMT_ID, bytes((command, node)))


def sync() -> Frame:
    """Return SYNC."""
    return Frame(SYNC_ID, b"")


def heartbeat(node: int) -> Frame:
    """Return the heartbeat of an operational node."""
    return Frame(HEARTBEAT_ID + node, bytes((NmtState.OPERATIONAL,)))


def sdo_write(node: int, entry: Entry) -> Frame:
    """Return the request for an expedited download."""
    value = (entry.value & ((1 << 8 * entry.size) - 1)).to_bytes(4, "little")
    return Frame(
        SDO_REQUEST_ID + node, struct.pack("<BHB", _DOWNLOAD[entry.size], entry.object_index, entry.subindex) + value
    )


def sdo_read(node: int, index: int, subindex: int) -> Frame:
    """Return the request for an upload."""
    return Frame(SDO_REQUEST_ID + node, struct.pack("<BHB4x", 0x40, index, subindex))


def parse_sdo(data: bytes) -> SdoAnswer | None:
    """Return what an SDO server said; None for what is no expedited answer."""
    if len(data) != 8:
        return None
    command, index, subindex = struct.unpack_from("<BHB", data)
    if command == 0x60:
        return SdoAnswer(index, subindex, None, None)
    if command == 0x80:
        return SdoAnswer(index, subindex, None, int.from_bytes(data[4:], "little"))
    if command in _UPLOADED:
        return SdoAnswer(index, subindex, int.from_bytes(data[4 : 4 + _UPLOADED[command]], "little"), None)
    return None


def parse_emergency(data: bytes) -> int | None:
    """Return the error code of an EMCY; None for another length."""
    return int(_EMCY.unpack(data)[0]) if len(data) == _EMCY.size else None


def abort_words(abort: int) -> str:
    """Return an SDO abort code in words."""
    return f"abort 0x{abort:08x}" + (f": {_ABORT_WORDS[abort]}" if abort in _ABORT_WORDS else "")


def mapped(index: int, subindex: int, bits: int) -> int:
    """Return the entry of a PDO mapping."""
    return index << 16 | subindex << 8 | bits


def pdo_mapping(
    communication: int, mapping: int, cob_id: int, transmission: int, objects: tuple[int, ...]
) -> list[Entry]:
    """Return what sets up a PDO, in the order that CiA 301 asks for: off, empty, filled, on."""
    off = 1 << 31 | cob_id
    return [
        Entry(communication, 1, 4, off),
        Entry(mapping, 0, 1, 0),
        *(Entry(mapping, place, 4, each) for place, each in enumerate(objects, start=1)),
        Entry(mapping, 0, 1, len(objects)),
        Entry(communication, 2, 1, transmission),
        Entry(communication, 1, 4, cob_id),
    ]
