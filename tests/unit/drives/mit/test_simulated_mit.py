"""The whole way: service, bus in virtual time, simulated mini cheetah drive, forceps; and what goes wrong."""

import json
import math
import struct
import time
from pathlib import Path
from typing import Any, cast

import can
import numpy as np
import pytest
from damiao_motor.core.controller import DaMiaoController
from motor_driver import canmotorlib

from firmware_protocol.frames import Frame
from hil_forceps.cli import main as cli
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.drives.mit import messages as wire
from hil_forceps.drives.mit.machine import Mit
from hil_forceps.drives.mit.messages import Codes, Special
from hil_forceps.drives.registry import machine_for
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError
from virtual_bus.drives.mit import COMMUNICATION_LOST, DISABLED, ENABLED, SimulatedMit
from virtual_bus.interface import VirtualForcepsBus
from virtual_bus.plant.load import paper_load

RIG_FILE = Path(__file__).parents[4] / "configs" / "drives" / "mit.yaml"
RIG = load_rig(RIG_FILE)
NODE, MS = 5, 1_000_000
EXIT, ENTER, SET_ZERO = (wire.special(NODE, which) for which in (Special.EXIT, Special.ENTER, Special.SET_ZERO))
VARIANTS = ("bgkatz", "cubemars", "damiao")


def run(tmp_path: Path, rig: str | Path = RIG_FILE, *more: str) -> tuple[int, dict[str, Any]]:
    arguments = ["run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={rig}", "--duration", "3", "--out", str(tmp_path / "out"), *more])
    return int(ended.value.code or 0), json.loads((tmp_path / "out" / "run.json").read_text())


def changed(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = RIG_FILE.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    return path


def error_line(capsys: pytest.CaptureFixture[str]) -> str:
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("hil-forceps:")]
    return line


@pytest.mark.parametrize("ratio", ["1.0", "-0.5"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_run_is_completed_with_nothing_lost(tmp_path: Path, variant: str, ratio: str) -> None:
    rig = changed(
        tmp_path, ("mit_variant: bgkatz", f"mit_variant: {variant}"), ("pulley_rev: 1.0 ", f"pulley_rev: {ratio} ")
    )
    if variant == "cubemars":
        rig.write_text(rig.read_text().replace("  reply_id: 0\n", ""))
    code, result = run(tmp_path, rig)
    assert (code, result["reason"], result["drive_disabled"]) == (0, "completed", True)
    host, service = result["counters"]["host"], result["counters"]["service"]
    assert host["samples"] > 3000
    assert service["frames_received"] >= service["frames_sent"] - (10 if variant == "cubemars" else 0) - 1
    lost = ("repeats", "releases", "unasked", "bad_length", "not_for_us", "wrapped", "at_range_end", "not_increasing")
    assert {name: host[name] for name in lost} == dict.fromkeys(lost, 0)
    with pytest.raises(SystemExit) as ended:
        cli.main(["replay", str(tmp_path / "out" / "run.mcap")])
    assert not ended.value.code
    recording = read_recording(tmp_path / "out" / "run.mcap")
    reference, angle = recording.references["passed_rad"][2500:], recording.samples["theta_m_rad"][2500:]
    assert abs(float(np.nanmean(reference)) - float(np.mean(angle))) < 0.02


def test_enabling_moves_nothing(tmp_path: Path) -> None:
    run(tmp_path)
    samples = read_recording(tmp_path / "out" / "run.mcap").samples
    enabling = samples["state"] != 2
    enabling &= samples["stamp_ns"] < samples["stamp_ns"][0] + 1_000 * MS
    assert np.count_nonzero(enabling) > 10
    assert float(np.ptp(samples["theta_m_rad"][enabling])) < 2e-3


def test_lost_frames_cost_repeats_and_no_silence(tmp_path: Path) -> None:
    faults = tmp_path / "faults.yaml"
    faults.write_text("- {fault: drop, probability: 0.02}\n")
    code, result = run(tmp_path, RIG_FILE, "--option", f"faults={faults}")
    assert (code, result["reason"], result["drive_disabled"]) == (0, "completed", True)
    host = result["counters"]["host"]
    assert 60 < host["repeats"] < 240  # of 3000 ticks, each with two frames that may be lost
    assert host["samples"] > 2800
    assert host["releases"] < host["repeats"] // 4


def test_a_drive_that_stops_answering_ends_the_run_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = SimulatedMit._loop

    def falls_silent(self: SimulatedMit, at_ns: int) -> None:
        if at_ns == 1_500 * MS:
            self.trip()
        loop(self, at_ns)

    monkeypatch.setattr(SimulatedMit, "_loop", falls_silent)
    code, result = run(tmp_path)
    assert (code, result["reason"], result["drive_disabled"]) == (2, "drive_lost", False)
    assert "did not confirm that it is disabled" in error_line(capsys)
    assert len(read_recording(tmp_path / "out" / "run.mcap").samples["stamp_ns"]) > 1400


def test_a_restart_ends_the_run_as_far_as_it_can_be_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is out for 20 ms, and back without motor mode: what bgkatz's takes at least is 8 ms."""
    receive = SimulatedMit.receive

    def restarts(self: SimulatedMit, frame: Frame, now_ns: int) -> None:
        if 1_500 * MS < now_ns < 1_520 * MS:
            self.reset()
        else:
            receive(self, frame, now_ns)

    monkeypatch.setattr(SimulatedMit, "receive", restarts)
    code, result = run(tmp_path)
    assert (code, result["reason"], result["drive_disabled"]) == (2, "drive_lost", True)
    assert "fell silent or restarted" in error_line(capsys)


def test_a_damiao_that_restarts_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = SimulatedMit._loop

    def resets(self: SimulatedMit, at_ns: int) -> None:
        if at_ns == 1_500 * MS:
            self.reset()
        loop(self, at_ns)

    monkeypatch.setattr(SimulatedMit, "_loop", resets)
    code, result = run(tmp_path, changed(tmp_path, ("mit_variant: bgkatz", "mit_variant: damiao")))
    assert (code, result["reason"], result["drive_disabled"]) == (2, "drive_stopped", True)
    assert "left operation by itself" in error_line(capsys)


def test_a_damiaos_fault_is_told_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = SimulatedMit._loop

    def overloads(self: SimulatedMit, at_ns: int) -> None:
        if at_ns == 1_500 * MS:
            self.enabled, self.fault = False, 0xE
        loop(self, at_ns)

    monkeypatch.setattr(SimulatedMit, "_loop", overloads)
    code, result = run(tmp_path, changed(tmp_path, ("mit_variant: bgkatz", "mit_variant: damiao")))
    assert (code, result["reason"], result["drive_disabled"]) == (2, "drive_fault", True)
    assert "error Eh (overload)" in error_line(capsys)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("node_id: 5", "node_id: 6"), "no drive answered: nothing came"),
        (("reply_id: 0", "reply_id: 21"), "answers come under the id 000h, not 015h"),
    ],
)
def test_what_does_not_fit_the_drive_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], told: str
) -> None:
    other = changed(tmp_path, change)
    arguments = ["run", "--rig", str(other), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={RIG_FILE}", "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert told in error_line(capsys)


def mit(variant: str = "bgkatz", **change: Any) -> SimulatedMit:
    changes = {f"motor_driver.{key}": value for key, value in change.items()}
    rig = RIG.with_changes({"motor_driver.mit_variant": variant, "motor_driver.reply_id": None, **changes})
    return SimulatedMit(rig, paper_load(0))


def command(kp: int = 0, kd: int = 0, position: int = 32_768) -> Frame:
    return wire.command(NODE, Codes(position, wire.ZERO_SPEED_CODE, kp, kd, wire.ZERO_TORQUE_CODE))


def angle_rad(drive: SimulatedMit, at_ms: int) -> float:
    drive.wake(at_ms * MS)
    return float(drive._forceps.truth(at_ms * MS).theta_m_rad)


@pytest.mark.parametrize("variant", VARIANTS)
def test_it_says_nothing_by_itself_and_answers_once(variant: str) -> None:
    drive = mit(variant)
    drive.wake(100 * MS)
    assert drive.take_outbox() == []
    for n, frame in enumerate((EXIT, ENTER, command(), EXIT)):
        drive.receive(frame, (101 + n) * MS)
        assert len(drive.take_outbox()) == 1


def test_a_cubemars_does_not_answer_commands_outside_of_motor_mode() -> None:
    drive = mit("cubemars")
    drive.receive(command(kp=400), MS)
    assert (drive.take_outbox(), drive.command.kp) == ([], 0.0)


def test_a_bgkatz_keeps_a_command_from_outside_of_motor_mode_and_chases_it() -> None:
    drive = mit()
    before_rad = angle_rad(drive, 1)
    drive.receive(command(kp=800, kd=80), 2 * MS)  # towards 0, and the jaw is at 1.1 rad
    drive.receive(ENTER, 3 * MS)
    assert before_rad - angle_rad(drive, 20) > 0.3


def test_exit_is_the_end_of_what_a_bgkatz_keeps() -> None:
    drive = mit()
    before_rad = angle_rad(drive, 1)
    for n, frame in enumerate((command(kp=800, kd=80), EXIT, ENTER)):
        drive.receive(frame, (2 + n) * MS)
    assert abs(before_rad - angle_rad(drive, 20)) < 1e-3


def test_behind_the_time_out_a_bgkatz_lets_go_and_stays_in_motor_mode() -> None:
    drive = mit()
    drive.receive(ENTER, MS)
    drive.receive(command(kp=800), 2 * MS)
    drive.wake(26 * MS)
    assert drive.command.kp > 0.0
    drive.receive(ENTER, 26 * MS + 1)  # feeds no time-out
    drive.wake(30 * MS)
    assert (drive.command.kp, drive.enabled, drive.reference_rad()) == (0.0, True, None)
    drive.receive(command(kp=800), 31 * MS)
    assert drive.reference_rad() is not None


def test_the_time_out_of_a_damiao_is_a_fault_until_it_is_cleared() -> None:
    drive = mit("damiao")
    drive.receive(ENTER, MS)
    drive.receive(command(kp=800), 2 * MS)
    drive.wake(30 * MS)
    assert (drive.enabled, drive.fault) == (False, COMMUNICATION_LOST)
    drive.receive(ENTER, 31 * MS)
    assert not drive.enabled
    drive.receive(wire.special(NODE, Special.CLEAR_ERRORS), 32 * MS)
    drive.receive(ENTER, 33 * MS)
    drive.receive(EXIT, 34 * MS)
    assert [frame.data[0] >> 4 for frame in drive.take_outbox()] == [
        DISABLED, ENABLED, COMMUNICATION_LOST, COMMUNICATION_LOST, DISABLED, ENABLED,
    ]  # fmt: skip


def test_nothing_ends_the_last_command_of_a_cubemars() -> None:
    drive = mit("cubemars")
    drive.receive(ENTER, MS)
    drive.receive(command(kp=800), 2 * MS)
    drive.wake(1_000 * MS)
    assert drive.reference_rad() is not None


def test_a_bgkatzs_filter_takes_frames_of_other_ids() -> None:
    drive = mit()
    drive.receive(Frame(NODE + 0x80, ENTER.data), MS)  # CANopen's SYNC and emergencies are there
    assert drive.enabled
    other = mit("damiao")
    other.receive(Frame(NODE + 0x80, ENTER.data), MS)
    assert not other.enabled


def test_a_bgkatz_wraps_its_angle_and_others_hold_it() -> None:
    for variant, wraps in (("bgkatz", True), ("damiao", False), ("cubemars", False)):
        drive = mit(variant, encoder_zero_rev=0.5)  # 3.14 and 1.1 rad of 3.2
        drive.receive(EXIT, MS)
        (frame,) = drive.take_outbox()
        reply = wire.parse_reply(frame.data)
        assert reply is not None
        position_rad = wire.measured(reply.position, 3.2, wire.MAX_POSITION_CODE)
        true_rad = math.pi + angle_rad(drive, 1)
        assert position_rad == pytest.approx(true_rad - 6.4 if wraps else 3.2, abs=1e-3)


def test_a_bgkatz_tells_the_largest_current_since_the_last_command() -> None:
    told = {}
    for variant in ("bgkatz", "damiao"):
        drive = mit(variant)
        drive.receive(ENTER, MS)
        drive.receive(command(kp=0), 2 * MS)
        drive._current_A = drive._largest_A = 0.0
        for n in range(200):
            drive.receive(command(kp=0), (3 + n) * MS)
        replies = [wire.parse_reply(frame.data) for frame in drive.take_outbox()]
        torques = [wire.measured(reply.torque, 1.0, wire.MAX_CODE) for reply in replies[10:] if reply]
        told[variant] = float(np.mean(torques))
    assert abs(told["damiao"]) < 1e-3
    assert told["bgkatz"] > 1e-3  # ten readings of a noise of 1 mA: the largest is 1.5 above the mean


def test_zero_is_set_outside_of_motor_mode_alone() -> None:
    drive = mit()
    drive.receive(ENTER, MS)
    drive.receive(SET_ZERO, 2 * MS)
    drive.receive(EXIT, 3 * MS)
    drive.receive(SET_ZERO, 4 * MS)
    drive.receive(EXIT, 5 * MS)
    positions = [reply.position for frame in drive.take_outbox() if (reply := wire.parse_reply(frame.data))]
    assert positions[2] == positions[0]
    assert abs(positions[4] - wire.MAX_POSITION_CODE / 2) < 2


def test_the_gains_of_the_frame_are_those_of_the_loop() -> None:
    drive = mit()
    theta_rad = angle_rad(drive, 1)
    away = wire.code_of(theta_rad - 0.05, -3.2, 3.2, wire.MAX_POSITION_CODE)
    drive.receive(ENTER, MS + 1)
    currents = []
    for kp in (100, 200):
        drive.receive(command(kp=kp, position=away), 2 * MS)
        currents.append(drive._wanted_A())
    kp_N_m_per_rad = 100 * 0.5 / wire.MAX_CODE
    expected_A = -kp_N_m_per_rad * 0.05 / 0.0135
    assert currents[0] == pytest.approx(expected_A, rel=0.02)
    assert currents[1] == pytest.approx(2.0 * expected_A, rel=0.02)


@pytest.mark.parametrize("current_range_A", [None, 1.5])
@pytest.mark.parametrize("ratio", [1.0, 2.0, -0.5])
def test_a_current_comes_back_as_itself_whatever_the_gear(ratio: float, current_range_A: float | None) -> None:
    change = {
        "encoder_rev_per_pulley_rev": ratio,
        "feedback_current_range_A": current_range_A,
        "position_range_rad": 6.4,
    }
    drive = mit("damiao", **change)
    rig = RIG.with_changes(
        {"motor_driver.mit_variant": "damiao", **{f"motor_driver.{key}": value for key, value in change.items()}}
    )
    host = cast(Mit, machine_for(rig))
    drive._current_A = 0.25
    drive._answer()
    reply = wire.parse_reply(drive.take_outbox()[0].data)
    assert reply is not None
    current_A = wire.measured(reply.torque, host.config.current_range_A, wire.MAX_CODE)
    assert current_A == pytest.approx(0.25, abs=2.0 * abs(host.config.current_range_A) / wire.MAX_CODE)


def test_a_rig_without_ranges_has_no_simulated_drive() -> None:
    with pytest.raises(UserError, match="ranges are missing"):
        mit(torque_range_N_m=None)
    with pytest.raises(UserError, match="with a mit_variant"):
        SimulatedMit(RIG.with_changes({"motor_driver.mit_variant": None}), paper_load(0))


def test_a_rig_with_effects_has_one(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        RIG_FILE.read_text() + "\neffects:\n  stribeck_friction:\n    rise_N_m: 1.0e-4\n    speed_rad_per_s: 1.0\n"
    )
    code, result = run(tmp_path, rig)
    assert (code, result["reason"]) == (0, "completed")


class Paced(VirtualForcepsBus):
    """As fast as a real bus at most: the other program keeps every frame until it gets round to it."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        time.sleep(2e-4)
        return super().recv(0.001 if timeout == 0 else timeout)


def wide(variant: str, **more: float) -> Rig:
    """A rig with the ranges of kp and kd that the others' programs have fixed."""
    changes = {
        "motor_driver.mit_variant": variant,
        "motor_driver.kp_range_N_m_per_rad": 500.0,
        "motor_driver.kd_range_N_m_s_per_rad": 5.0,
        "motor_driver.watchdog_s": 10.0,
        **{f"motor_driver.{key}": value for key, value in more.items()},
    }
    return RIG.with_changes(changes)


def test_a_host_for_damiaos_commands_the_simulated_one(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = wide("damiao", reply_id=0x15)
    bus = Paced("referee", rig=rig, simulation=0)
    monkeypatch.setattr(can.interface, "Bus", lambda **_: bus)
    controller = DaMiaoController("referee", "virtual_forceps")
    motor = controller.add_motor(
        NODE, 0x15, "4310", p_min=-3.2, p_max=3.2, v_min=-100.0, v_max=100.0, t_min=-0.0135, t_max=0.0135
    )
    controller._stop_polling()  # its thread would move the bus's time beside ours

    def ask(order: Any) -> dict[str, Any]:
        order()
        controller.poll_feedback()
        return dict(motor.get_states())

    try:
        assert ask(motor.disable)["status"] == "DISABLED"
        ask(motor.enable)
        state = ask(motor.send_cmd_mit)
        assert (state["status"], state["can_id"], state["arbitration_id"]) == ("ENABLED", NODE, 0x15)
        target = state["pos"] - 0.2
        for _ in range(300):
            state = ask(lambda: motor.send_cmd_mit(target_position=target, stiffness=0.13, damping=0.0013))
        assert state["pos"] == pytest.approx(target, abs=0.01)
        ask(motor.disable)
        assert ask(motor.disable)["status"] == "DISABLED"
    finally:
        bus.shutdown()


class Socket:
    """What a raw CAN socket does, over the virtual bus."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus

    def send(self, packed: bytes) -> None:
        arbitration_id, length, data = struct.unpack("=IB3x8s", packed)
        self._bus.send(can.Message(arbitration_id=arbitration_id, data=data[:length], is_extended_id=False))

    def recvfrom(self, size: int) -> tuple[bytes, None]:
        message = self._bus.recv(0.05)
        assert message is not None
        return struct.pack("=IB3x8s", message.arbitration_id, message.dlc, bytes(message.data).ljust(8))[:size], None


@pytest.mark.parametrize("variant", ["bgkatz", "cubemars"])
def test_a_host_for_cubemars_commands_the_simulated_ones(variant: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bus = VirtualForcepsBus(f"referee-{variant}", rig=wide(variant), simulation=0)
    monkeypatch.setattr(canmotorlib, "set_zero_sleep", 0.0)
    monkeypatch.setattr(canmotorlib.CanMotorController, "can_socket_declared", True)
    monkeypatch.setattr(canmotorlib.CanMotorController, "motor_socket", Socket(bus))
    host = canmotorlib.CanMotorController(motor_id=NODE, motor_type="AK80_9_V2")
    host.change_motor_constants(-3.2, 3.2, -100.0, 100.0, 0.0, 500.0, 0.0, 5.0, -0.0135, 0.0135)
    try:
        position, _, _ = host.enable_motor()  # which first sets its zero
        assert position == pytest.approx(0.0, abs=1e-3)
        for _ in range(300):
            position, _, torque = host.send_rad_command(-0.2, 0.0, 0.13, 0.0013, 0.0)
        assert position == pytest.approx(-0.2, abs=0.01)
        assert abs(torque) < 0.002
        host.disable_motor()
        assert host.disable_motor() is not None or variant == "cubemars"  # it asks by a command, outside of motor mode
    finally:
        bus.shutdown()
