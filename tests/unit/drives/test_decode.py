"""Frames of makers' protocols in words: what is said is what was packed, and no bytes raise."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from hil_forceps.cli import main as cli
from hil_forceps.drives.cia402 import messages as canopen
from hil_forceps.drives.dynamixel import packets as dynamixel
from hil_forceps.drives.mit import messages as mit
from hil_forceps.drives.moteus import messages as moteus
from hil_forceps.drives.odrive import messages as odrive
from hil_forceps.drives.registry import PROFILES
from hil_forceps.drives.vesc import messages as vesc

CONFIGS = Path(__file__).parents[3] / "configs" / "drives"
_ASKED = {
    "read_int8_0x000": "mode",
    "read_float_0x001": "position velocity",
    "read_float_0x004": "q_current",
    "read_int8_0x00f": "fault",
    "read_int32_0x070": "clock_ms",
}


@pytest.mark.parametrize(
    ("frame", "name", "values"),
    [
        (
            odrive.set_input_pos(5, 0.25),
            "SET_INPUT_POS",
            {"position_rev": 0.25, "velocity_ff_rev_per_s": 0.0, "torque_ff_N_m": 0.0},
        ),
        (
            odrive.set_axis_state(5, odrive.AxisState.CLOSED_LOOP_CONTROL),
            "SET_AXIS_STATE",
            {"axis_state": "CLOSED_LOOP_CONTROL"},
        ),
        (odrive.set_position_control(5), "SET_CONTROLLER_MODE", {"control_mode": 3, "input_mode": 1}),
        (odrive.set_limits(5, 2.0, 0.5), "SET_LIMITS", {"velocity_rev_per_s": 2.0, "current_A": 0.5}),
        (odrive.estop(5), "ESTOP", {}),
        (Frame(0x0A1, bytes.fromhex("0008000001000000")), "HEARTBEAT", {"axis_error": "0x800", "axis_state": "IDLE"}),
    ],
)
def test_odrive(frame: Frame, name: str, values: dict[str, object]) -> None:
    assert PROFILES["odrive"].decode(frame) == (name, {"node": 5, **values})


@pytest.mark.parametrize(
    ("frame", "name", "values"),
    [
        (canopen.nmt(canopen.Nmt.START, 5), "NMT", {"node": 5, "command": "START"}),
        (canopen.sync(), "SYNC", {}),
        (canopen.heartbeat(5), "HEARTBEAT", {"node": 5, "state": "OPERATIONAL"}),
        (canopen.sdo_read(5, 0x6064, 0), "SDO_READ", {"node": 5, "object": "6064h:00"}),
        (
            canopen.sdo_write(5, canopen.Entry(0x60C2, 2, 1, -3)),
            "SDO_WRITE",
            {"node": 5, "object": "60C2h:02", "value": 0xFD},
        ),
        (
            Frame(0x585, bytes.fromhex("8001 1a01 41000406")),
            "SDO_ANSWER",
            {"node": 5, "object": "1A01h:01", "abort": "abort 0x06040041: it can't be mapped to a PDO"},
        ),
        (
            Frame(0x605, bytes.fromhex("8000000000000405")),
            "SDO_ABORT",
            {"node": 5, "object": "0000h:00", "abort": "abort 0x05040000: the transfer timed out"},
        ),
        (Frame(0x085, bytes.fromhex("3081110000000000")), "EMCY", {"node": 5, "error_code": "0x8130"}),
        (Frame(0x285, bytes.fromhex("b3ffffff")), "TPDO2", {"node": 5, "current_counts": -77}),
        (
            Frame(0x205, bytes.fromhex("0f00d2ffffff")),
            "RPDO1",
            {"node": 5, "controlword": "0x000f", "target_counts": -46},
        ),
    ],
)
def test_canopen(frame: Frame, name: str, values: dict[str, object]) -> None:
    assert PROFILES["cia402"].decode(frame) == (name, values)


COMMAND = {
    "node": 5, "position_of_range": 1.0, "speed_of_range": 0.00024, "kp_of_range": 0.5, "kd_of_range": 0.0,
    "torque_of_range": -0.00024,
}  # fmt: skip
REPLY = {"position_of_range": -1.0, "speed_of_range": -0.00024, "torque_of_range": 1.0}


@pytest.mark.parametrize(
    ("frame", "name", "values"),
    [
        (mit.special(5, mit.Special.ENTER), "ENTER", {"node": 5}),
        (mit.special(5, mit.Special.EXIT), "EXIT", {"node": 5}),
        (mit.command(5, mit.Codes(0xFFFF, 2048, 2048, 0, 2047)), "COMMAND", {**COMMAND, "kp_of_range": 0.50012}),
        (Frame(0x000, bytes.fromhex("0500007fffff")), "REPLY", {"head": "0x05", **REPLY, "extra": ""}),
        (Frame(0x000, bytes.fromhex("0500007fffffff")), "REPLY", {"head": "0x05", **REPLY, "extra": "ff"}),
        (Frame(0x005, bytes.fromhex("0500007fffff2800")), "REPLY", {"head": "0x05", **REPLY, "extra": "2800"}),
        (Frame(0x015, bytes.fromhex("1500007fffff2828")), "REPLY", {"head": "0x15", **REPLY, "extra": "2828"}),
    ],
)
def test_mini_cheetah(frame: Frame, name: str, values: dict[str, object]) -> None:
    assert PROFILES["mit"].decode(frame) == (name, values)


@pytest.mark.parametrize(
    ("frame", "name", "values"),
    [
        (moteus.stop(5), "STOP", {"from": 0, "to": 5, "mode": "STOPPED", **_ASKED}),
        (moteus.query(5), "QUERY", {"from": 0, "to": 5, **_ASKED}),
        (
            Frame(0x500, bytes.fromhex("2f01000080be0000c07f0000807f2a8102010101000500000050"), True),
            "REPLY",
            {
                "from": 5,
                "to": 0,
                "position_rev": -0.25,
                "velocity_rev_per_s": None,
                "torque_N_m": None,
                "firmware": "1.1.1",
                "register_map": 5,
            },
        ),
        (Frame(0x500, bytes.fromhex("31830201"), True), "REPLY", {"from": 5, "to": 0, "read_error": "0x103"}),
        (Frame(0x500, bytes.fromhex("252a0100"), True), "REPLY", {"from": 5, "to": 0, "0x02a": 1}),
    ],
)
def test_moteus(frame: Frame, name: str, values: dict[str, object]) -> None:
    found = PROFILES["moteus"].decode(frame)
    assert found is not None
    assert (found.name, found.values) == (name, values)


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x500, moteus.query(5).data, True, True),
        Frame(0x1_8005, moteus.query(5).data, True, True),
        Frame(0x8005, b"\x60", True, True),
        Frame(0x8005, b"\x50\x50", True, True),
    ],
)
def test_what_is_no_moteus(frame: Frame) -> None:
    assert PROFILES["moteus"].decode(frame) is None


def test_ids_with_29_bits_are_shown_with_eight_digits(capsys: pytest.CaptureFixture[str]) -> None:
    """And are left out where the drive has none of them."""
    frames = ["00008005##11100110F", "500##1210000210F00"]
    for drive, code, shown in (("moteus", 0, frames), ("odrive", 1, frames[1:])):
        with pytest.raises(SystemExit) as ended:
            cli.main(["decode", *frames, "--drive", drive])
        assert (ended.value.code or 0) == code
        lines = capsys.readouterr().out.splitlines()
        assert [line.split("#")[0] for line in lines] == [each.split("#")[0] for each in shown]
    for form, told in (("jsonl", '"is_extended": true'), ("csv", "0x00008005")):
        with pytest.raises(SystemExit):
            cli.main(["decode", *frames, "--drive", "moteus", "--form", form])
        assert capsys.readouterr().out.count(told) >= 1


@pytest.mark.parametrize(
    ("frame", "name", "values"),
    [
        (dynamixel.ping(5), "PING", {}),
        (dynamixel.reboot(5), "REBOOT", {}),
        (dynamixel.read(5, 224, 10), "READ", {"item": "Indirect Data 1 to 10 (224)", "size": 10}),
        (dynamixel.write(5, 64, b"\x01"), "WRITE", {"item": "Torque Enable (64)", "value": 1}),
        (dynamixel.write(5, 700, b"\x01\x02"), "WRITE", {"item": "700", "value": 513}),
        (Frame(5, bytes.fromhex("5587")), "STATUS", {"error": "access error", "alert": True}),
        (
            Frame(5, bytes.fromhex("5580 02 01 20 05 9cff ffffffff"), True),
            "STATUS",
            {
                "alert": True,
                "position_counts": -1,
                "current_A": -0.269,
                "torque_enable": 1,
                "hardware_error": "0x20",
                "bus_watchdog": 5,
            },
        ),
    ],
)
def test_dynamixel(frame: Frame, name: str, values: dict[str, object]) -> None:
    assert PROFILES["dynamixel"].decode(frame) == (name, {"id": 5, **values})


def test_a_goal_for_one_servo_of_many() -> None:
    frame = dynamixel.write_unanswered(5, 116, (-3 & 0xFFFFFFFF).to_bytes(4, "little"))
    found = PROFILES["dynamixel"].decode(frame)
    assert found == ("SYNC_WRITE", {"id": 254, "item": "Goal Position (116)", "size": 4, "servo_5": -3})


def test_a_capture_of_a_serial_line_is_read_by_its_own_framing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capture = tmp_path / "line.bin"
    capture.write_bytes(b"noise" + dynamixel.encode(dynamixel.ping(5)) + dynamixel.encode(dynamixel.reboot(6)))
    with pytest.raises(SystemExit) as ended:
        cli.main(["decode", str(capture), "--drive", "dynamixel"])
    shown = capsys.readouterr()
    assert [line.split()[1:] for line in shown.out.splitlines()] == [["PING", "id=5"], ["REBOOT", "id=6"]]
    assert ended.value.code == 1
    assert "skipped_bytes 5" in shown.err


@pytest.mark.parametrize(
    ("frame", "name", "values"),
    [
        (vesc.set_position(5, 0.25), "SET_POS", {"node": 5, "position_deg": 90.0}),
        (vesc.release(5), "SET_CURRENT", {"node": 5, "current_A": 0.0}),
        (
            vesc.request(5),
            "PROCESS_SHORT_BUFFER",
            {"node": 5, "sender": 253, "processing": 0, "packet": 50, "bytes": "00218020"},
        ),
        (
            Frame(0x905, bytes.fromhex("fffffff6fffe0005"), is_extended=True),
            "STATUS",
            {"node": 5, "erpm": -10, "current_without_direction_A": -0.2, "duty": 0.005},
        ),
        (
            Frame(0x7FD, bytes.fromhex("0501000feb66"), is_extended=True),
            "PROCESS_RX_BUFFER",
            {"node": 253, "sender": 5, "processing": 1, "length": 15, "crc": "0xeb66"},
        ),
        (Frame(0x3905, b"60_MK6", is_extended=True), "NOTIFY_BOOT", {"node": 5, "hardware": "60_MK6"}),
    ],
)
def test_vesc(frame: Frame, name: str, values: dict[str, object]) -> None:
    assert PROFILES["vesc"].decode(frame) == (name, values)
    assert PROFILES["vesc"].decode(frame._replace(is_extended=False)) is None


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_all_that_a_run_put_on_the_bus_is_understood(
    profile: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = CONFIGS / f"{profile}.yaml"
    arguments = ["run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit):
        cli.main([*arguments, "--option", f"rig={rig}", "--duration", "0.5", "--out", str(tmp_path / "out")])
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        cli.main(["decode", str(tmp_path / "out" / "bus.log"), "--drive", profile])
    assert not ended.value.code
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) > 1000
    assert not [line for line in lines if "refused" in line]


@pytest.mark.parametrize("profile", sorted(PROFILES))
@given(frame_id=st.integers(0, 0x7FF), data=st.binary(max_size=64))
def test_no_bytes_raise(profile: str, frame_id: int, data: bytes) -> None:
    found = PROFILES[profile].decode(Frame(frame_id, data))
    assert found is None or found.name


@given(frame_id=st.one_of(st.integers(0, 0x4000), st.integers(0, 0x1FFFFFFF)), data=st.binary(max_size=8))
def test_no_bytes_behind_an_id_of_29_bits_raise(frame_id: int, data: bytes) -> None:
    for profile in PROFILES.values():
        found = profile.decode(Frame(frame_id, data, is_extended=True))
        assert found is None or found.name


@pytest.mark.parametrize(
    ("profile", "frame"),
    [("odrive", odrive.estop(5)), ("cia402", canopen.sync()), ("cia402", canopen.heartbeat(5))],
)
def test_an_id_with_29_bits_is_not_read_as_one_with_11(profile: str, frame: Frame) -> None:
    assert PROFILES[profile].decode(frame) is not None
    assert PROFILES[profile].decode(frame._replace(is_extended=True)) is None
