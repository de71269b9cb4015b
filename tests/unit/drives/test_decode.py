"""Frames of makers' protocols in words: what is said is what was packed, and no bytes raise."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from hil_forceps.cli import main as cli
from hil_forceps.drives.cia402 import messages as canopen
from hil_forceps.drives.odrive import messages as odrive
from hil_forceps.drives.registry import PROFILES
from hil_forceps.drives.vesc import messages as vesc

CONFIGS = Path(__file__).parents[3] / "configs" / "drives"


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
@given(frame_id=st.integers(0, 0x7FF), data=st.binary(max_size=8))
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
