"""Frames of makers' protocols as names and values, for people; pure."""

from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any, NamedTuple

from firmware_protocol.frames import Frame
from hil_forceps.drives import canopen_messages as canopen
from hil_forceps.drives import odrive_messages as odrive


class Decoded(NamedTuple):
    """A frame in words: what it is, and its values with their units in the names."""

    name: str
    values: dict[str, Any]


Decode = Callable[[Frame], Decoded | None]


def odrive_frame(frame: Frame) -> Decoded | None:
    """Return a frame of CANSimple; None for a command that isn't known here or has another length."""
    (node, number), data = odrive.node_and_command(frame.arbitration_id), frame.data
    try:
        command = odrive.Command(number)
    except ValueError:
        return None
    values = _odrive_values(command, data)
    return None if values is None else Decoded(command.name, {"node": node, **values})


def _odrive_values(command: odrive.Command, data: bytes) -> Mapping[str, Any] | None:
    if command in {odrive.Command.ESTOP, odrive.Command.CLEAR_ERRORS}:
        return {}
    return _ODRIVE[command](data) if len(data) == 8 else None


def _words(data: bytes) -> tuple[int, int]:
    return int.from_bytes(data[:4], "little"), int.from_bytes(data[4:], "little")


def _pair(data: bytes, *names: str) -> dict[str, Any] | None:
    pair = odrive.parse_pair(data)
    return None if pair is None else dict(zip(names, pair, strict=True))


_ODRIVE: Mapping[odrive.Command, Callable[[bytes], Mapping[str, Any] | None]] = {
    odrive.Command.HEARTBEAT: lambda data: {
        "axis_error": f"0x{_words(data)[0]:x}",
        "axis_state": _named(odrive.AxisState, data[4]),
    },
    odrive.Command.SET_AXIS_STATE: lambda data: {"axis_state": _named(odrive.AxisState, _words(data)[0])},
    odrive.Command.SET_CONTROLLER_MODE: lambda data: dict(
        zip(("control_mode", "input_mode"), _words(data), strict=True)
    ),
    odrive.Command.SET_INPUT_POS: odrive.parse_input_pos,
    odrive.Command.ENCODER_ESTIMATES: lambda data: _pair(data, "position_rev", "velocity_rev_per_s"),
    odrive.Command.GET_IQ: lambda data: _pair(data, "setpoint_A", "measured_A"),
    odrive.Command.SET_LIMITS: lambda data: _pair(data, "velocity_rev_per_s", "current_A"),
}


def canopen_frame(frame: Frame) -> Decoded | None:
    """Return a CANopen frame by the predefined connection set; PDOs as this project maps them."""
    function, node, data = frame.arbitration_id & 0x780, frame.arbitration_id & 0x7F, frame.data
    if frame.arbitration_id == canopen.NMT_ID:
        return Decoded("NMT", {"node": data[1], "command": _named(canopen.Nmt, data[0])}) if len(data) == 2 else None
    if frame.arbitration_id == canopen.SYNC_ID:
        return Decoded("SYNC", {})
    read = _CANOPEN.get(function)
    found = None if read is None else read(data)
    return None if found is None else Decoded(found.name, {"node": node, **found.values})


def _emergency(data: bytes) -> Decoded | None:
    code = canopen.parse_emergency(data)
    return None if code is None else Decoded("EMCY", {"error_code": f"0x{code:04x}"})


def _heartbeat(data: bytes) -> Decoded | None:
    return Decoded("HEARTBEAT", {"state": _named(canopen.NmtState, data[0])}) if len(data) == 1 else None


def _sdo_answer(data: bytes) -> Decoded | None:
    answer = canopen.parse_sdo(data)
    if answer is None:
        return None
    values: dict[str, Any] = {"object": f"{answer.object_index:04X}h:{answer.subindex:02X}"}
    if answer.value is not None:
        values["value"] = answer.value
    if answer.abort is not None:
        values["abort"] = canopen.abort_words(answer.abort)
    return Decoded("SDO_ANSWER", values)


def _sdo_request(data: bytes) -> Decoded | None:
    if len(data) != 8:
        return None
    values: dict[str, Any] = {"object": f"{int.from_bytes(data[1:3], 'little'):04X}h:{data[3]:02X}"}
    if data[0] == 0x40:
        return Decoded("SDO_READ", values)
    return Decoded("SDO_WRITE", {**values, "value": int.from_bytes(data[4:], "little")})


def _position(data: bytes) -> Decoded | None:
    if len(data) != 7:
        return None
    statusword = int.from_bytes(data[4:6], "little")
    return Decoded(
        "TPDO1",
        {
            "position_counts": int.from_bytes(data[:4], "little", signed=True),
            "statusword": f"0x{statusword:04x}",
            "state": canopen.state_of(statusword).name,
            "mode": int.from_bytes(data[6:], "little", signed=True),
        },
    )


def _current(data: bytes) -> Decoded | None:
    if len(data) != 4:
        return None
    return Decoded("TPDO2", {"current_A": int.from_bytes(data, "little", signed=True) * 1e-3})


def _reference(data: bytes) -> Decoded | None:
    if len(data) != 6:
        return None
    controlword = int.from_bytes(data[:2], "little")
    target = int.from_bytes(data[2:], "little", signed=True)
    return Decoded("RPDO1", {"controlword": f"0x{controlword:04x}", "target_counts": target})


_CANOPEN: Mapping[int, Callable[[bytes], Decoded | None]] = {
    canopen.EMCY_ID: _emergency,
    canopen.TPDO_IDS[0]: _position,
    canopen.TPDO_IDS[1]: _current,
    canopen.RPDO1_ID: _reference,
    canopen.SDO_ANSWER_ID: _sdo_answer,
    canopen.SDO_REQUEST_ID: _sdo_request,
    canopen.HEARTBEAT_ID: _heartbeat,
}
DECODERS: Mapping[str, Decode] = {"odrive": odrive_frame, "cia402": canopen_frame}


def _named(kind: type[Enum], value: int) -> str | int:
    return next((str(member.name) for member in kind if member.value == value), value)
