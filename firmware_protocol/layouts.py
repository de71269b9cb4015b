"""Where each field lies in the payload: one row a message, as `motor_driver.dbc` says and a test proves.

Every payload is little-endian, without the check value, which is always last and which `codec` adds and verifies.
"""

from collections.abc import Callable
from enum import IntEnum
from struct import Struct
from typing import Any, Final, NamedTuple

from firmware_protocol.frames import BROADCAST_NODE, MAX_NODE, make
from firmware_protocol.messages import (
    AssignNode,
    BenchSensor,
    Discover,
    DriveHeartbeat,
    Estop,
    FdFeedback,
    Feedback,
    Function,
    HostHeartbeat,
    Identity,
    ParamRequest,
    ParamResponse,
    Setpoint,
    Timing,
)

ANY_LENGTH: Final = -1

SETPOINT: Final = Struct("<iBBx")
FD_SETPOINT: Final = Struct("<iBB")
FEEDBACK: Final = Struct("<ihB")
TIMING: Final = Struct("<IBBB")
FD_FEEDBACK: Final = Struct("<ihIBBBx")
_HOST_HEARTBEAT: Final = Struct("<BBBxxxB")
_DRIVE_HEARTBEAT: Final = Struct("<BBBHBB")
_PARAM: Final = Struct("<BHi")
BENCH: Final = Struct("<HbHbB")  # fields of 24 bits, each as its lower 16 and its upper 8 with the sign


class Check(IntEnum):
    """The check value at the end of the payload, by its size in bytes."""

    NONE = 0
    CRC8 = 1
    CRC16 = 2


class Layout(NamedTuple):
    """One message on the wire: `length` counts the check value; `is_fd` None accepts either format."""

    length: int
    is_fd: bool | None
    check: Check
    lowest_node: int
    highest_node: int
    pack: Callable[[Any], bytes]
    build: Callable[[int, bytes], Any]


def status_byte(state: int, fault: int) -> int:
    """Join state (low nibble) and fault reason (high nibble); ValueError when either needs more than four bits."""
    if state >> 4 or fault >> 4:
        raise ValueError(f"state {state} and fault {fault} must each fit four bits")
    return state | fault << 4


def _pack_setpoint(m: Setpoint) -> bytes:
    return SETPOINT.pack(m.theta_m_ref, m.sequence, m.sample_sequence)


def _build_setpoint(node: int, data: bytes) -> Setpoint:
    return make(Setpoint, (node, *SETPOINT.unpack_from(data)))


def _pack_fd_setpoint(m: Setpoint) -> bytes:
    return FD_SETPOINT.pack(m.theta_m_ref, m.sequence, m.sample_sequence)


def _build_fd_setpoint(node: int, data: bytes) -> Setpoint:
    return make(Setpoint, (node, *FD_SETPOINT.unpack_from(data)))


def _pack_feedback(m: Feedback) -> bytes:
    return FEEDBACK.pack(m.theta_m, m.current, m.sequence)


def _build_feedback(node: int, data: bytes) -> Feedback:
    return make(Feedback, (node, *FEEDBACK.unpack_from(data)))


def _pack_timing(m: Timing) -> bytes:
    return TIMING.pack(m.stamp_us, m.sequence, m.setpoint_sequence, status_byte(m.state, m.fault))


def _build_timing(node: int, data: bytes) -> Timing:
    stamp_us, sequence, setpoint_sequence, status = TIMING.unpack_from(data)
    return make(Timing, (node, stamp_us, sequence, setpoint_sequence, status & 15, status >> 4))


def _pack_fd_feedback(m: FdFeedback) -> bytes:
    status = status_byte(m.state, m.fault)
    return FD_FEEDBACK.pack(m.theta_m, m.current, m.stamp_us, m.sequence, m.setpoint_sequence, status)


def _build_fd_feedback(node: int, data: bytes) -> FdFeedback:
    theta_m, current, stamp_us, sequence, setpoint_sequence, status = FD_FEEDBACK.unpack_from(data)
    fields = (node, theta_m, current, stamp_us, sequence, setpoint_sequence, status & 15, status >> 4)
    return make(FdFeedback, fields)


def _pack_host_heartbeat(m: HostHeartbeat) -> bytes:
    return _HOST_HEARTBEAT.pack(m.control, m.protocol_major, m.protocol_minor, m.sequence)


def _build_host_heartbeat(node: int, data: bytes) -> HostHeartbeat:
    return HostHeartbeat(node, *_HOST_HEARTBEAT.unpack_from(data))


def _pack_drive_heartbeat(m: DriveHeartbeat) -> bytes:
    status = status_byte(m.state, m.fault)
    return _DRIVE_HEARTBEAT.pack(status, m.protocol_major, m.protocol_minor, m.rejected, m.setpoints_lost, m.sequence)


def _build_drive_heartbeat(node: int, data: bytes) -> DriveHeartbeat:
    status, *rest = _DRIVE_HEARTBEAT.unpack_from(data)
    return DriveHeartbeat(node, status & 15, status >> 4, *rest)


def _pack_bench(m: BenchSensor) -> bytes:
    return BENCH.pack(m.theta_j & 0xFFFF, m.theta_j >> 16, m.tau_w & 0xFFFF, m.tau_w >> 16, m.sequence)


def _build_bench(node: int, data: bytes) -> BenchSensor:
    theta_j, theta_j_upper, tau_w, tau_w_upper, sequence = BENCH.unpack_from(data)
    return make(BenchSensor, (node, theta_j_upper << 16 | theta_j, tau_w_upper << 16 | tau_w, sequence))


def _pack_param(m: ParamRequest | ParamResponse) -> bytes:
    return _PARAM.pack(m.op, m.parameter, m.value)


def _build_param_request(node: int, data: bytes) -> ParamRequest:
    return ParamRequest(node, *_PARAM.unpack_from(data))


def _build_param_response(node: int, data: bytes) -> ParamResponse:
    return ParamResponse(node, *_PARAM.unpack_from(data))


def _pack_identity(m: Identity) -> bytes:
    versions = m.protocol_major.to_bytes(1, "little") + m.protocol_minor.to_bytes(1, "little")
    return m.serial_number.to_bytes(6, "little") + versions


def _build_identity(node: int, data: bytes) -> Identity:
    return Identity(node, int.from_bytes(data[0:6], "little"), data[6], data[7])


def _pack_assign(m: AssignNode) -> bytes:
    return m.serial_number.to_bytes(6, "little") + m.new_node.to_bytes(1, "little")


def _build_assign(node: int, data: bytes) -> AssignNode:
    return AssignNode(node, int.from_bytes(data[0:6], "little"), data[6])


def _pack_nothing(_: Estop | Discover) -> bytes:
    return b""


def _build_estop(node: int, _: bytes) -> Estop:
    return Estop(node)


def _build_discover(node: int, _: bytes) -> Discover:
    return Discover(node)


_CLASSIC: Final = (False, Check.CRC8, BROADCAST_NODE + 1, MAX_NODE)
_FD: Final = (True, Check.CRC16, BROADCAST_NODE + 1, MAX_NODE)
_TO_ALL: Final = (BROADCAST_NODE, MAX_NODE)

LAYOUTS: Final[dict[Function, Layout]] = {
    Function.ESTOP: Layout(ANY_LENGTH, None, Check.NONE, *_TO_ALL, _pack_nothing, _build_estop),
    Function.SETPOINT: Layout(8, *_CLASSIC, _pack_setpoint, _build_setpoint),
    Function.FD_SETPOINT: Layout(8, *_FD, _pack_fd_setpoint, _build_fd_setpoint),
    Function.FEEDBACK: Layout(8, *_CLASSIC, _pack_feedback, _build_feedback),
    Function.TIMING: Layout(8, *_CLASSIC, _pack_timing, _build_timing),
    Function.FD_FEEDBACK: Layout(16, *_FD, _pack_fd_feedback, _build_fd_feedback),
    Function.HOST_HEARTBEAT: Layout(8, *_CLASSIC, _pack_host_heartbeat, _build_host_heartbeat),
    Function.DRIVE_HEARTBEAT: Layout(8, *_CLASSIC, _pack_drive_heartbeat, _build_drive_heartbeat),
    Function.BENCH_SENSOR: Layout(8, *_CLASSIC, _pack_bench, _build_bench),
    Function.PARAM_REQUEST: Layout(8, *_CLASSIC, _pack_param, _build_param_request),
    Function.PARAM_RESPONSE: Layout(8, *_CLASSIC, _pack_param, _build_param_response),
    Function.DISCOVER: Layout(0, False, Check.NONE, *_TO_ALL, _pack_nothing, _build_discover),
    Function.IDENTITY: Layout(8, False, Check.NONE, BROADCAST_NODE + 1, MAX_NODE, _pack_identity, _build_identity),
    Function.ASSIGN_NODE: Layout(8, False, Check.CRC8, BROADCAST_NODE, BROADCAST_NODE, _pack_assign, _build_assign),
}

FUNCTION_OF: Final[dict[type, Function]] = {
    Estop: Function.ESTOP,
    Setpoint: Function.SETPOINT,
    Feedback: Function.FEEDBACK,
    Timing: Function.TIMING,
    FdFeedback: Function.FD_FEEDBACK,
    HostHeartbeat: Function.HOST_HEARTBEAT,
    DriveHeartbeat: Function.DRIVE_HEARTBEAT,
    BenchSensor: Function.BENCH_SENSOR,
    ParamRequest: Function.PARAM_REQUEST,
    ParamResponse: Function.PARAM_RESPONSE,
    Discover: Function.DISCOVER,
    Identity: Function.IDENTITY,
    AssignNode: Function.ASSIGN_NODE,
}
