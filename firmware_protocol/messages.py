"""The messages of protocol version 1 as plain data; every field is the raw integer of the wire."""

from enum import IntEnum, IntFlag
from typing import NamedTuple

PROTOCOL_MAJOR = 1
PROTOCOL_MINOR = 0


class Function(IntEnum):
    """Function code: the upper six bits of the arbitration id, in order of urgency."""

    ESTOP = 0x00
    SETPOINT = 0x02
    FD_SETPOINT = 0x03
    FEEDBACK = 0x04
    TIMING = 0x05
    FD_FEEDBACK = 0x06
    HOST_HEARTBEAT = 0x08
    DRIVE_HEARTBEAT = 0x09
    BENCH_SENSOR = 0x0A
    PARAM_REQUEST = 0x10
    PARAM_RESPONSE = 0x11
    DISCOVER = 0x18
    IDENTITY = 0x19
    ASSIGN_NODE = 0x1A


class DriveState(IntEnum):
    """State of the drive, carried in TIMING, FD_FEEDBACK and DRIVE_HEARTBEAT."""

    DISABLED = 0  # no torque
    ARMED = 1  # enable accepted, still no torque: waits for a first reference equal to the measured angle
    OPERATIONAL = 2  # follows fresh references
    FAULT = 3  # latched, no torque, reason kept


class FaultReason(IntEnum):
    """Why the drive latched; kept until the fault is reset."""

    NONE = 0
    ESTOP = 1
    WATCHDOG = 2
    HOST_HEARTBEAT_LOST = 3
    REFERENCE_MISMATCH = 4
    REFERENCE_POSITION = 5
    REFERENCE_RATE = 6
    ENABLE_TIMEOUT = 7
    VERSION = 8
    OVERCURRENT = 9
    ENCODER = 10
    SUPPLY = 11
    OVERTEMPERATURE = 12
    BUS_OFF = 13
    INTERNAL = 14


_FAULT_WORDS = {
    FaultReason.NONE: "no reason given",
    FaultReason.ESTOP: "emergency stop",
    FaultReason.WATCHDOG: "watchdog: no fresh reference in time",
    FaultReason.HOST_HEARTBEAT_LOST: "the host's heartbeat was lost",
    FaultReason.REFERENCE_MISMATCH: "the first reference was not the measured angle",
    FaultReason.REFERENCE_POSITION: "reference outside the drive's position limits",
    FaultReason.REFERENCE_RATE: "reference changed faster than the drive allows",
    FaultReason.ENABLE_TIMEOUT: "enabled, but no first reference came in time",
    FaultReason.VERSION: "protocol versions don't fit",
    FaultReason.OVERCURRENT: "overcurrent",
    FaultReason.ENCODER: "encoder",
    FaultReason.SUPPLY: "supply voltage",
    FaultReason.OVERTEMPERATURE: "overtemperature",
    FaultReason.BUS_OFF: "the drive's bus controller went off the bus",
    FaultReason.INTERNAL: "internal fault of the drive",
}


def fault_words(fault: int) -> str:
    """Return a fault reason in words; one this version doesn't know by its number."""
    try:
        return f"{FaultReason(fault).name} ({_FAULT_WORDS[FaultReason(fault)]})"
    except ValueError:
        return f"reason {fault}, unknown to this version"


class Control(IntFlag):
    """Control bits in HOST_HEARTBEAT: levels, of which ENABLE and FAULT_RESET act on their rising edge."""

    NONE = 0
    ENABLE = 1
    FAULT_RESET = 2


class Setpoint(NamedTuple):
    """SETPOINT / FD_SETPOINT, host to drive, cyclic: the compensated motor angle."""

    node: int
    theta_m_ref: int
    sequence: int
    sample_sequence: int  # sequence of the feedback this reference was computed from


class Feedback(NamedTuple):
    """FEEDBACK, drive to host, cyclic: what was measured at one instant."""

    node: int
    theta_m: int
    current: int
    sequence: int


class Timing(NamedTuple):
    """TIMING, drive to host, cyclic, same sequence as its FEEDBACK: when it was measured, and in which state."""

    node: int
    stamp_us: int
    sequence: int
    setpoint_sequence: int  # last setpoint the drive accepted
    state: int  # DriveState
    fault: int  # FaultReason


class FdFeedback(NamedTuple):
    """FD_FEEDBACK, drive to host, cyclic: FEEDBACK and TIMING in one CAN FD frame."""

    node: int
    theta_m: int
    current: int
    stamp_us: int
    sequence: int
    setpoint_sequence: int
    state: int
    fault: int


class HostHeartbeat(NamedTuple):
    """HOST_HEARTBEAT, host to drive, cyclic: control bits and the host's protocol version."""

    node: int
    control: int
    protocol_major: int
    protocol_minor: int
    sequence: int


class DriveHeartbeat(NamedTuple):
    """DRIVE_HEARTBEAT, drive to host, cyclic, in every state."""

    node: int
    state: int
    fault: int
    protocol_major: int
    protocol_minor: int
    rejected: int  # frames dropped by the drive, saturating
    setpoints_lost: int  # setpoints skipped by sequence since power-up, modulo 256
    sequence: int


class BenchSensor(NamedTuple):
    """BENCH_SENSOR, bench to host, cyclic: jaw encoder and load cell of a bench, absent on a real forceps."""

    node: int
    theta_j: int  # 24 bits, half a revolution either way
    tau_w: int  # 24 bits
    sequence: int  # that of the feedback sampled at the same instant


class Estop(NamedTuple):
    """ESTOP, host to one drive or to all: accepted in every state, with any payload."""

    node: int


class ParamOp(IntEnum):
    """Operation of a PARAM_REQUEST, result of a PARAM_RESPONSE."""

    READ = 0
    WRITE = 1
    OK = 0x10
    UNKNOWN_INDEX = 0x11
    READ_ONLY = 0x12
    OUT_OF_RANGE = 0x13
    WRONG_STATE = 0x14
    UNKNOWN_OP = 0x15


class ParamRequest(NamedTuple):
    """PARAM_REQUEST, host to drive."""

    node: int
    op: int  # ParamOp
    parameter: int  # index in the dictionary of `parameters`
    value: int


class ParamResponse(NamedTuple):
    """PARAM_RESPONSE, drive to host."""

    node: int
    op: int  # ParamOp
    parameter: int  # index in the dictionary of `parameters`
    value: int


class Discover(NamedTuple):
    """DISCOVER, host to one node or to all: each answers IDENTITY after a delay derived from its serial number."""

    node: int


class Identity(NamedTuple):
    """IDENTITY, drive to host."""

    node: int
    serial_number: int  # 48 bits
    protocol_major: int
    protocol_minor: int


class AssignNode(NamedTuple):
    """ASSIGN_NODE, host to all: the drive with this serial number takes the new node id; only while DISABLED."""

    node: int  # always BROADCAST_NODE
    serial_number: int
    new_node: int


Message = (
    Setpoint
    | Feedback
    | Timing
    | FdFeedback
    | HostHeartbeat
    | DriveHeartbeat
    | BenchSensor
    | Estop
    | ParamRequest
    | ParamResponse
    | Discover
    | Identity
    | AssignNode
)
