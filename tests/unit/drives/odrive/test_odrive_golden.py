"""ODrive's frames, byte for byte as the maker has them: profile, simulated peer and others' DBC say the same."""

import json
from pathlib import Path
from typing import Any

import cantools
import pytest
from odrive_can.utils import get_dbc_path

from firmware_protocol.frames import Frame
from hil_forceps.drives.odrive import messages as wire
from hil_forceps.drives.odrive.messages import AxisState
from hil_forceps.drives.registry import PROFILES
from hil_forceps.rig import load_rig
from virtual_bus.drives.odrive import SimulatedODrive
from virtual_bus.plant.load import paper_load

GOLDEN = json.loads((Path(__file__).parent / "golden.json").read_text())["frames"]
RIG = load_rig(Path(__file__).parents[4] / "configs" / "drives" / "odrive.yaml")
DBC: dict[str, Any] = {
    firmware: cantools.database.load_file(get_dbc_path(f"odrive-cansimple-{name}"))
    for firmware, name in (("0.5", "0.5.6"), ("0.6", "0.6.10"))
}
MS = 1_000_000
# What this project sends, by the names of the golden frames.
SENT = {
    "closed loop for axis 1": wire.set_axis_state(1, AxisState.CLOSED_LOOP_CONTROL),
    "idle for axis 1": wire.set_axis_state(1, AxisState.IDLE),
    "position control, passed through": wire.set_position_control(1),
    "input position -2.5 turns for axis 1": wire.set_input_pos(1, -2.5),
    "limits: 20 turns/s, 1.5 A": wire.set_limits(1, 20.0, 1.5),
    "emergency stop": wire.estop(1),
    "clear errors": wire.clear_errors(1),
}
FOREIGN = {"input position with feed-forwards: 1 turn, 1.5 turns/s, -0.25 N m"}  # never sent here
NAMES_OF_OTHERS = {
    "axis_error": "Axis_Error", "axis_state": "Axis_State", "position_rev": "Pos_Estimate",
    "velocity_rev_per_s": "Vel_Estimate", "setpoint_A": "Iq_Setpoint", "measured_A": "Iq_Measured",
    "control_mode": "Control_Mode", "input_mode": "Input_Mode", "velocity_ff_rev_per_s": "Vel_FF",
    "torque_ff_N_m": "Torque_FF", "current_A": "Current_Limit",
}  # fmt: skip
NAMES_IN = {
    "SET_INPUT_POS": {"position_rev": "Input_Pos"},
    "SET_LIMITS": {"velocity_rev_per_s": "Velocity_Limit"},
    "SET_AXIS_STATE": {"axis_state": "Axis_Requested_State"},
}


def frame_of(row: dict[str, Any]) -> Frame:
    return Frame(int(row["arbitration_id"], 16), bytes.fromhex(row["data"]))


def golden(name: str) -> Frame:
    (row,) = [row for row in GOLDEN if row["name"] == name]
    return frame_of(row)


def by_name(row: dict[str, Any]) -> str:
    return str(row["name"])


@pytest.mark.parametrize("row", GOLDEN, ids=by_name)
def test_the_profile_reads_it(row: dict[str, Any]) -> None:
    assert PROFILES["odrive"].decode(frame_of(row)) == (row["kind"], row["values"])


@pytest.mark.parametrize("row", [row for row in GOLDEN if row["to"] == "drive"], ids=by_name)
def test_the_profile_sends_it(row: dict[str, Any]) -> None:
    assert row["name"] in SENT.keys() | FOREIGN
    if row["name"] in SENT:
        assert SENT[row["name"]] == frame_of(row)


@pytest.mark.parametrize("row", GOLDEN, ids=by_name)
def test_others_read_the_same(row: dict[str, Any]) -> None:
    frame, values = frame_of(row), dict(row["values"])
    node = values.pop("node")
    for firmware in row["firmware"]:
        if node >= 8 or (firmware == "0.5" and row["kind"] == "ESTOP"):
            continue  # these DBC files have eight axes, and that of 0.5.6 no emergency stop
        message = DBC[firmware].get_message_by_frame_id(frame.arbitration_id)
        assert message.name.startswith(f"Axis{node}_")
        said = message.decode(frame.data, decode_choices=False) if message.signals and values else {}
        for name, value in values.items():
            theirs = said[NAMES_IN.get(row["kind"], {}).get(name) or NAMES_OF_OTHERS[name]]
            if name == "axis_error":
                assert f"0x{theirs:x}" == value
            elif name == "axis_state" and isinstance(value, str):
                assert theirs == AxisState[value]
            else:
                assert theirs == pytest.approx(value)


def peer(node: int = 1, firmware: str = "0.6", ratio: float = 1.0) -> SimulatedODrive:
    """A simulated ODrive of firmware 0.6 or 0.5."""
    rig = RIG.with_changes({
        "motor_driver.node_id": node,
        "motor_driver.firmware": firmware,
        "motor_driver.encoder_rev_per_pulley_rev": ratio,
    })  # fmt: skip
    return SimulatedODrive(rig, paper_load(0))


def heartbeat(drive: SimulatedODrive, until_ms: int) -> Frame:
    """Return the last heartbeat up to a time, at which a drive with a watchdog must have been spoken to."""
    drive.wake(until_ms * MS)
    return [frame for frame in drive.take_outbox() if frame.arbitration_id & 0x1F == 0x01][-1]


def test_the_simulated_drive_sends_the_makers_heartbeats() -> None:
    assert heartbeat(peer(node=0), 110) == golden("heartbeat of an idle axis")
    drive = peer(firmware="0.5")
    drive.receive(golden("position control, passed through"), 20 * MS)
    drive.receive(golden("closed loop for axis 1"), 60 * MS)
    assert heartbeat(drive, 110) == golden("heartbeat in closed loop")
    assert heartbeat(drive, 210) == golden("heartbeat behind an expired watchdog, axis idle")
    drive.receive(golden("clear errors"), 220 * MS)
    drive.receive(golden("closed loop for axis 1"), 260 * MS)
    assert heartbeat(drive, 310) == golden("heartbeat in closed loop")
    drive.receive(golden("emergency stop"), 320 * MS)
    assert drive.error == 0x4000


def test_the_simulated_drive_understands_what_the_maker_has_sent_to_it() -> None:
    drive = peer()
    drive.receive(golden("position control, passed through"), MS)
    drive.receive(golden("limits: 20 turns/s, 1.5 A"), MS)
    drive.receive(golden("input position -2.5 turns for axis 1"), MS)
    assert (drive.modes, drive.limits, drive.input_pos_rev) == ((3, 1), (20.0, 1.5), -2.5)
    drive.receive(golden("input position with feed-forwards: 1 turn, 1.5 turns/s, -0.25 N m"), MS)
    drive.receive(golden("idle for axis 1"), MS)
    assert (drive.input_pos_rev, drive.state, drive.error) == (1.0, 1, 0)
    assert drive.counters["not_understood"] == 0
