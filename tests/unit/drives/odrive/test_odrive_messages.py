"""ODrive's frames against DBC files that others made from the maker's documents, for both firmwares."""

import struct
from typing import Any

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st
from odrive_can.utils import get_dbc_path

from firmware_protocol.frames import Frame
from hil_forceps.drives.odrive import messages as wire
from hil_forceps.drives.odrive.messages import AxisState, Command, Firmware

NODE = 5
DBC: dict[str, Any] = {
    firmware: cantools.database.load_file(get_dbc_path(f"odrive-cansimple-{name}"))
    for firmware, name in (("0.5", "0.5.6"), ("0.6", "0.6.10"))
}
FIRMWARES: tuple[Firmware, ...] = ("0.5", "0.6")


def decoded(firmware: Firmware, frame: Frame) -> tuple[str, dict[str, object]]:
    message = DBC[firmware].get_message_by_frame_id(frame.arbitration_id)
    assert message.length in (0, len(frame.data))
    values = message.decode(frame.data, decode_choices=False) if message.signals else {}
    return message.name, values


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_what_is_sent_says_what_is_meant(firmware: Firmware) -> None:
    name, values = decoded(firmware, wire.set_input_pos(NODE, -1.25))
    assert name == f"Axis{NODE}_Set_Input_Pos"
    assert values == {"Input_Pos": -1.25, "Vel_FF": 0.0, "Torque_FF": 0.0}
    name, values = decoded(firmware, wire.set_position_control(NODE))
    assert name == f"Axis{NODE}_Set_Controller_Mode"
    assert values == {"Control_Mode": 3, "Input_Mode": 1}
    name, values = decoded(firmware, wire.set_limits(NODE, 20.0, 1.5))
    assert name == f"Axis{NODE}_Set_Limits"
    assert values == {"Velocity_Limit": 20.0, "Current_Limit": 1.5}
    for state in AxisState:
        name, values = decoded(firmware, wire.set_axis_state(NODE, state))
        assert name == f"Axis{NODE}_Set_Axis_State"
        assert values == {"Axis_Requested_State": state}
    if firmware == "0.6":  # the DBC of 0.5.6 leaves it out
        assert decoded(firmware, wire.estop(NODE))[0] == f"Axis{NODE}_Estop"
    assert decoded(firmware, wire.clear_errors(NODE))[0] == f"Axis{NODE}_Clear_Errors"


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_what_comes_is_read(firmware: Firmware) -> None:
    def message(name: str, **values: float) -> tuple[int, bytes]:
        found = DBC[firmware].get_message_by_name(f"Axis{NODE}_{name}")
        return found.frame_id, found.encode(dict.fromkeys((s.name for s in found.signals), 0) | values)

    frame_id, data = message("Heartbeat", Axis_Error=0x800, Axis_State=8, Trajectory_Done_Flag=1)
    assert frame_id == wire.frame_id(NODE, Command.HEARTBEAT)
    assert wire.parse_heartbeat(data) == (0x800, 8)
    frame_id, data = message("Get_Encoder_Estimates", Pos_Estimate=0.75, Vel_Estimate=-2.0)
    assert frame_id == wire.frame_id(NODE, Command.ENCODER_ESTIMATES)
    assert wire.parse_estimates(data) == (0.75, -2.0)
    frame_id, data = message("Get_Iq", Iq_Setpoint=0.5, Iq_Measured=-0.25)
    assert frame_id == wire.frame_id(NODE, Command.GET_IQ)
    assert wire.parse_iq(data) == (0.5, -0.25)


def test_bytes_as_they_go_out() -> None:
    assert wire.set_input_pos(0, 1.0) == Frame(0x00C, bytes.fromhex("0000803F00000000"))
    assert wire.set_axis_state(1, AxisState.CLOSED_LOOP_CONTROL) == Frame(0x027, bytes.fromhex("0800000000000000"))
    assert wire.set_position_control(3) == Frame(0x06B, bytes.fromhex("0300000001000000"))


@given(st.binary(max_size=64))
def test_no_bytes_raise(data: bytes) -> None:
    for parse in (wire.parse_heartbeat, wire.parse_estimates, wire.parse_iq):
        found = parse(data)
        assert (found is None) or len(data) == 8


@pytest.mark.parametrize("bad", [struct.pack("<ff", float("nan"), 0.0), struct.pack("<ff", 0.0, float("inf"))])
def test_what_is_no_number_is_none(bad: bytes) -> None:
    assert wire.parse_estimates(bad) is None
    assert wire.parse_iq(bad) is None


def test_errors_are_told_in_words() -> None:
    assert wire.error_words("0.5", 0x800) == "axis error 0x800 (watchdog expired)"
    assert wire.error_words("0.6", 0x1000000) == "axis error 0x1000000 (watchdog expired)"
    assert wire.error_words("0.6", 0x80000000) == "axis error 0x80000000 (0x80000000)"
    assert wire.error_words("0.6", 0) == "no error reported"
