"""The objects of a CiA 402 drive that the profile writes and maps, and how the drive sits on the motor pulley."""

import struct
from typing import Final, NamedTuple

from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.cia402.messages import Entry

HOST_NODE: Final = 127  # of the first drive on a bus; each has one of its own, by which it knows its host alive
MODE_CSP: Final = 8
DRIVE_HEARTBEAT_MS: Final = 100
TPDO1: Final = struct.Struct("<ihb")  # 6064h, 6041h, 6061h
TPDO2: Final = {16: struct.Struct("<h"), 32: struct.Struct("<i")}  # the current, by its bits
RPDO1: Final = struct.Struct("<Hi")  # 6040h, 607Ah
_SYNCHRONOUS, _AT_ONCE = 1, 255


class Cia402Config(NamedTuple):
    """One drive and how its encoder sits on the motor pulley."""

    node: int
    counts_per_pulley_rev: float  # with the sign of the direction
    zero_counts: float  # what 6064h is at the angle 0 of the motor pulley
    period_ns: int  # of the host's loop, of SYNC, and of the interpolation (60C2h)
    host_timeout_ns: int  # of the host's heartbeat; 0: not watched
    current_object: tuple[int, int] = (0x30D1, 2)  # EPOS4: current actual value
    current_bits: int = 32
    current_lsb_A: float = 1e-3
    host_node: int = HOST_NODE  # whose heartbeat it watches


def entries(config: Cia402Config) -> list[Entry]:
    """Return what is written to a drive before it is started, in this order."""
    node = config.node
    index, subindex = config.current_object
    consumer = (config.host_node << 16 | config.host_timeout_ns // 1_000_000) if config.host_timeout_ns else 0
    position = (wire.mapped(0x6064, 0, 32), wire.mapped(0x6041, 0, 16), wire.mapped(0x6061, 0, 8))
    return [
        Entry(0x1017, 0, 2, DRIVE_HEARTBEAT_MS),
        Entry(0x1016, 1, 4, consumer),
        *wire.pdo_mapping(0x1800, 0x1A00, wire.TPDO_IDS[0] + node, _SYNCHRONOUS, position),
        *wire.pdo_mapping(
            0x1801, 0x1A01, wire.TPDO_IDS[1] + node, _SYNCHRONOUS, (wire.mapped(index, subindex, config.current_bits),)
        ),
        *wire.pdo_mapping(
            0x1400,
            0x1600,
            wire.RPDO1_ID + node,
            _AT_ONCE,
            (wire.mapped(0x6040, 0, 16), wire.mapped(0x607A, 0, 32)),
        ),
        Entry(0x60C2, 1, 1, config.period_ns // 1_000_000),
        Entry(0x60C2, 2, 1, -3),
        Entry(0x6060, 0, 1, MODE_CSP),
    ]
