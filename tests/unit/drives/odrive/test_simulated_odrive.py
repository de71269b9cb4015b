"""The whole way: service, bus in virtual time, simulated ODrive, forceps; and what goes wrong with real ones."""

import asyncio
import json
import math
import struct
import time
from pathlib import Path
from typing import Any, cast

import can
import numpy as np
import pytest
from odrive_can.mock import ODriveCANMock
from odrive_can.odrive import ODriveCAN

from firmware_protocol.frames import Frame
from hil_forceps.cli import main as cli
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.drives.odrive import messages as wire
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError
from virtual_bus.drives.odrive import CLOSED_LOOP, IDLE, WATCHDOG_EXPIRED, SimulatedODrive
from virtual_bus.drives.registry import SIMULATED_DRIVES
from virtual_bus.interface import VirtualForcepsBus
from virtual_bus.plant.load import paper_load

RIG_FILE = Path(__file__).parents[4] / "configs" / "drives" / "odrive.yaml"
RIG = load_rig(RIG_FILE)
NODE, MS = 5, 1_000_000


def run(tmp_path: Path, rig: str | Path = RIG_FILE, *more: str) -> tuple[int, dict[str, Any]]:
    arguments = ["run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={rig}", "--duration", "3", "--out", str(tmp_path / "out"), *more])
    return int(ended.value.code or 0), json.loads((tmp_path / "out" / "run.json").read_text())


def changed(tmp_path: Path, old: str, new: str) -> Path:
    text = RIG_FILE.read_text()
    assert old in text
    path = tmp_path / "rig.yaml"
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize("firmware", ["0.5", "0.6"])
@pytest.mark.parametrize("ratio", ["1.0", "-3.0"])
def test_a_run_is_completed_with_nothing_lost(tmp_path: Path, firmware: str, ratio: str) -> None:
    rig = changed(tmp_path, "firmware: 0.6", f"firmware: {firmware}")
    rig.write_text(rig.read_text().replace("pulley_rev: 1.0 ", f"pulley_rev: {ratio} "))
    code, result = run(tmp_path, rig)
    assert (code, result["reason"], result["drive_disabled"]) == (0, "completed", True)
    host = result["counters"]["host"]
    assert host["samples"] > 3000
    assert not any(host[name] for name in ("without_current", "no_estimate", "bad_length", "not_for_us"))
    with pytest.raises(SystemExit) as ended:
        cli.main(["replay", str(tmp_path / "out" / "run.mcap")])
    assert not ended.value.code  # the recording says which rig it was made with, and gives the same references
    recording = read_recording(tmp_path / "out" / "run.mcap")
    reference, angle = recording.references["passed_rad"][2500:], recording.samples["theta_m_rad"][2500:]
    assert abs(float(np.nanmean(reference)) - float(np.mean(angle))) < 0.02


def test_an_odrive_that_sends_no_current_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def without_iq(*arguments: Any, **keywords: Any) -> SimulatedODrive:
        return SimulatedODrive(*arguments, **keywords, iq=False)

    monkeypatch.setitem(SIMULATED_DRIVES, "odrive", without_iq)
    code, result = run(tmp_path)
    assert code == 2
    assert result["counters"]["service"]["references_sent"] == 0
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("hil-forceps:")]
    assert "node 5 sends heartbeats, but no Iq" in line
    assert "iq_msg_rate_ms" in line


def test_another_node_id_is_no_drive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = changed(tmp_path, "node_id: 5", "node_id: 6")
    arguments = ["run", "--rig", str(other), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={RIG_FILE}", "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert "no drive answered" in capsys.readouterr().err


def odrive(rig: Rig = RIG) -> SimulatedODrive:
    return SimulatedODrive(rig, paper_load(0))


def enabled(drive: SimulatedODrive) -> None:
    drive.receive(wire.set_position_control(NODE), MS)
    drive.receive(wire.set_axis_state(NODE, wire.AxisState.CLOSED_LOOP_CONTROL), 2 * MS)
    assert drive.state == CLOSED_LOOP


def test_any_frame_feeds_the_watchdog_and_silence_ends_in_a_latched_error() -> None:
    drive = odrive()
    enabled(drive)
    for n in range(10):
        drive.receive(Frame(NODE << 5 | 0x17, b""), (10 + 50 * n) * MS)  # telemetry alone keeps it alive
    assert drive.state == CLOSED_LOOP
    drive.wake(800 * MS)
    assert drive.state == IDLE
    assert drive.error == WATCHDOG_EXPIRED["0.6"]
    drive.receive(wire.set_axis_state(NODE, wire.AxisState.CLOSED_LOOP_CONTROL), 801 * MS)
    assert drive.state == IDLE
    drive.receive(wire.clear_errors(NODE), 802 * MS)
    assert drive.error == 0


def test_entering_closed_loop_it_chases_the_last_input_unless_the_measured_angle_came_first() -> None:
    drive = odrive()
    start_rad = float(drive._forceps.truth(0).theta_m_rad)
    enabled(drive)  # the input is still 0, as at power on
    for n in range(3, 80):
        drive.receive(Frame(NODE << 5 | 0x17, b""), n * MS)
    moved_rad = float(drive._forceps.truth(79 * MS).theta_m_rad) - start_rad
    assert abs(moved_rad) > 0.3


def test_a_service_that_enables_it_moves_nothing(tmp_path: Path) -> None:
    run(tmp_path)
    recording = read_recording(tmp_path / "out" / "run.mcap")
    angle = recording.samples["theta_m_rad"]
    before = recording.samples["stamp_ns"] < recording.samples["stamp_ns"][0] + 1_000_000_000
    enabling = before & (recording.samples["state"] != 2)
    assert float(np.ptp(angle[enabling])) < 2e-3


def test_a_drive_that_loses_its_state_while_running_ends_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = SimulatedODrive._loop

    def resets(self: SimulatedODrive, at_ns: int) -> None:
        if at_ns == 1_500 * MS:
            self.state, self.modes, self.input_pos_rev = IDLE, (0, 0), 0.0
        loop(self, at_ns)

    monkeypatch.setattr(SimulatedODrive, "_loop", resets)
    code, result = run(tmp_path)
    assert (code, result["reason"]) == (2, "drive_stopped")
    assert "left the operational state without a request" in capsys.readouterr().err
    assert len(read_recording(tmp_path / "out" / "run.mcap").samples["stamp_ns"]) > 1400


def test_periods_that_the_loop_does_not_divide_are_refused() -> None:
    with pytest.raises(UserError, match=r"motor_driver.feedback_period_s: 0.0007 s is no multiple"):
        odrive(RIG.with_changes({"motor_driver.feedback_period_s": 7e-4}))


class Paced(VirtualForcepsBus):
    """As fast as a real bus at most: the other program keeps every frame until it gets round to it."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        time.sleep(5e-4)
        return super().recv(timeout)


def test_a_driver_by_others_commands_the_simulated_odrive() -> None:
    rig = RIG.with_changes({"motor_driver.watchdog_s": 0.0})  # it sends too seldom, in a time that is not the bus's

    async def session() -> dict[str, float]:
        bus = Paced("referee", rig=rig, simulation=0)
        driver = ODriveCAN(axis_id=NODE, can_bus=bus)
        angles: list[float] = []
        driver.feedback_callback = lambda message, _: angles.append(message.data["Pos_Estimate"])
        await driver.start()
        driver.set_controller_mode("POSITION_CONTROL", "PASSTHROUGH")
        driver.set_input_pos(angles[-1])
        await asyncio.sleep(0.1)  # of frames that wait together the lowest id goes first: that of the state
        await driver.set_axis_state("CLOSED_LOOP_CONTROL")
        state = driver.axis_state
        target = angles[-1] + 0.02
        driver.set_input_pos(target)
        for _ in range(200):  # as fast as the bus's time passes beside this program's
            if abs(angles[-1] - target) < 1e-3:
                break
            await asyncio.sleep(0.02)
        driver.stop()
        bus.shutdown()
        return {"closed": state == "CLOSED_LOOP_CONTROL", "off": abs(angles[-1] - target)}

    found = asyncio.run(session())
    assert found["closed"]
    assert found["off"] < 1e-3


def test_a_simulated_node_by_others_understands_what_we_send() -> None:
    async def session() -> ODriveCANMock:
        with can.Bus("mock", interface="virtual") as bus:
            mock = ODriveCANMock(axis_id=NODE, can_bus=cast(Any, bus))
            for frame in (
                wire.set_position_control(NODE),
                wire.set_input_pos(NODE, 0.25),
                wire.set_axis_state(NODE, wire.AxisState.CLOSED_LOOP_CONTROL),
            ):
                message = mock.dbc.get_message_by_frame_id(frame.arbitration_id)
                await mock.execute_cmd(message.name.split("_", 1)[1], message.decode(frame.data))
            mock.notifier.stop()
            return mock

    mock = asyncio.run(session())
    assert (mock.odrive.control_mode, mock.odrive.input_mode) == ("POSITION_CONTROL", "PASSTHROUGH")
    assert mock.odrive.model.setpoint == 0.25
    assert mock.odrive.axis_state == "CLOSED_LOOP_CONTROL"


def test_positions_are_32_bit_floats_in_turns() -> None:
    drive = odrive()
    drive.wake(2 * MS)
    frame = next(frame for frame in drive.take_outbox() if frame.arbitration_id == NODE << 5 | 0x09)
    position = struct.unpack_from("<f", frame.data)[0]
    assert position * 2.0 * np.pi == pytest.approx(float(drive._forceps.truth(0).theta_m_rad), abs=5e-4)


@pytest.mark.parametrize("position_rev", [math.nan, math.inf, 1e30, -3e9])
def test_a_position_that_nothing_holds_is_no_input(position_rev: float) -> None:
    odrive = SimulatedODrive(RIG, paper_load(0))
    odrive.receive(Frame(NODE << 5 | 0x0B, struct.pack("<II", 3, 1)), 0)
    odrive.receive(Frame(NODE << 5 | 0x0C, struct.pack("<fhh", 0.125, 0, 0)), 0)
    odrive.receive(Frame(NODE << 5 | 0x07, struct.pack("<I4x", CLOSED_LOOP)), 0)
    odrive.receive(Frame(NODE << 5 | 0x0C, struct.pack("<fhh", position_rev, 0, 0)), MS)
    odrive.wake(10 * MS)
    assert (odrive.state, odrive.input_pos_rev) == (CLOSED_LOOP, 0.125)
    assert odrive.counters["not_understood"] == 1
