"""The whole way: service, bus in virtual time, simulated VESC, forceps; and what goes wrong with real ones."""

import json
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from firmware_protocol.frames import Frame
from hil_forceps.bench.assembly import Settings
from hil_forceps.bench.session import Plan, run_session, service_config, stamps_are_host_time
from hil_forceps.bridge.clocks import VirtualClock
from hil_forceps.bridge.links.adapters import Connection
from hil_forceps.bridge.links.can_link import VirtualTimeLink
from hil_forceps.bridge.results import StopReason
from hil_forceps.cli import main as cli
from hil_forceps.control.trajectories import PAPER_TRAJECTORY
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.drives.registry import machine_for, machines_for, sample_period_s
from hil_forceps.drives.vesc import messages as wire
from hil_forceps.drives.vesc.answers import Answers
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError
from virtual_bus.drives.registry import SIMULATED_DRIVES
from virtual_bus.drives.vesc import UNDER_VOLTAGE, SimulatedVesc
from virtual_bus.interface import VirtualForcepsBus
from virtual_bus.plant.load import paper_load

RIG_FILE = Path(__file__).parents[4] / "configs" / "drives" / "vesc.yaml"
RIG = load_rig(RIG_FILE)
NODE, HOST, MS = 5, 253, 1_000_000


def run(tmp_path: Path, rig: str | Path = RIG_FILE, *more: str) -> tuple[int, dict[str, Any]]:
    arguments = ["run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={rig}", "--duration", "3", "--out", str(tmp_path / "out"), *more])
    return int(ended.value.code or 0), json.loads((tmp_path / "out" / "run.json").read_text())


def said(capsys: pytest.CaptureFixture[str]) -> str:
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("hil-forceps:")]
    return line


def changed(tmp_path: Path, old: str, new: str) -> Path:
    text = RIG_FILE.read_text()
    assert old in text
    path = tmp_path / "rig.yaml"
    path.write_text(text.replace(old, new))
    return path


def made_with(monkeypatch: pytest.MonkeyPatch, **keywords: bool) -> None:
    def make(*arguments: Any, **more: Any) -> SimulatedVesc:
        return SimulatedVesc(*arguments, **{**more, **keywords})

    monkeypatch.setitem(SIMULATED_DRIVES, "vesc", make)


def at(monkeypatch: pytest.MonkeyPatch, time_ms: int, what: Callable[[SimulatedVesc, int], None]) -> None:
    """Let something happen to the simulated VESC."""
    loop = SimulatedVesc._loop

    def watched(self: SimulatedVesc, at_ns: int) -> None:
        if at_ns == time_ms * MS:
            what(self, at_ns)
        loop(self, at_ns)

    monkeypatch.setattr(SimulatedVesc, "_loop", watched)


@pytest.mark.parametrize(("ratio", "zero"), [("1.0", "0.25"), ("-1.0", "0.25"), ("-2.5", "0.25"), ("1.0", "0.95")])
def test_a_run_is_completed_with_nothing_lost(tmp_path: Path, ratio: str, zero: str) -> None:
    rig = changed(tmp_path, "pulley_rev: 1.0 ", f"pulley_rev: {ratio} ")
    rig.write_text(rig.read_text().replace("zero_rev: 0.25", f"zero_rev: {zero}"))
    code, result = run(tmp_path, rig)
    assert (code, result["reason"], result["drive_disabled"]) == (0, "completed", True)
    host = result["counters"]["host"]
    assert host["samples"] > 1500
    lost = ("unanswered", "unasked", "torn_answers", "bad_answers", "jumps", "not_for_us", "out_of_range")
    assert not any(host[name] for name in lost)
    with pytest.raises(SystemExit) as ended:
        cli.main(["replay", str(tmp_path / "out" / "run.mcap")])
    assert not ended.value.code  # the recording says which rig it was made with, and gives the same references
    recording = read_recording(tmp_path / "out" / "run.mcap")
    reference, angle = recording.references["passed_rad"][1250:], recording.samples["theta_m_rad"][1250:]
    assert abs(float(np.nanmean(reference)) - float(np.mean(angle))) < 0.02


def test_a_service_that_enables_it_moves_nothing(tmp_path: Path) -> None:
    run(tmp_path)
    samples = read_recording(tmp_path / "out" / "run.mcap").samples
    enabling = samples["state"] != 2
    enabling[np.argmax(samples["state"] == 2) :] = False
    assert np.count_nonzero(enabling) > 50
    assert float(np.ptp(samples["theta_m_rad"][enabling])) < 2e-3


@pytest.mark.parametrize(
    ("keywords", "words"),
    [({"has_status_bit": False}, "update its firmware to 5.03"), ({"has_index": False}, "half a turn away")],
)
def test_one_that_is_set_up_wrong_ends_in_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    keywords: dict[str, bool],
    words: str,
) -> None:
    made_with(monkeypatch, **keywords)
    code, result = run(tmp_path)
    assert code == 2
    assert words in said(capsys)
    assert (tmp_path / "out" / "run.mcap").is_file()
    assert result["drive_disabled"]


@pytest.mark.parametrize("timeout_ms", [0, 1000])
def test_a_timeout_that_is_not_what_the_rig_says_is_found_before_anything_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, timeout_ms: int
) -> None:
    def otherwise(self: SimulatedVesc, _: int) -> None:
        self.timeout_ns = timeout_ms * MS

    at(monkeypatch, 0, otherwise)
    code, result = run(tmp_path)
    assert code == 2
    assert "set App Settings, General, Timeout to 100 ms" in said(capsys)
    assert result["counters"]["service"]["references_sent"] == 0


def test_another_node_id_is_no_drive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = changed(tmp_path, "node_id: 5", "node_id: 6")
    arguments = ["run", "--rig", str(other), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={RIG_FILE}", "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert "no drive answered" in capsys.readouterr().err


def _falls_deaf(vesc: SimulatedVesc, _: int) -> None:
    vesc.__dict__["_command"] = lambda *_: None


def _is_killed(vesc: SimulatedVesc, _: int) -> None:
    vesc.is_killed = True


@pytest.mark.parametrize(
    ("what", "reason", "words"),
    [
        (SimulatedVesc.reboot, "drive_lost", "sent no more samples or restarted"),
        (lambda vesc, now: vesc.fail(UNDER_VOLTAGE, now), "drive_fault", "fault 2 (under voltage)"),
        (_falls_deaf, "drive_fault", "timeout expired"),
        (_is_killed, "drive_fault", "kill switch"),
    ],
)
def test_what_happens_while_it_runs_ends_in_one_line_with_a_whole_recording(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    what: Callable[[SimulatedVesc, int], None],
    reason: str,
    words: str,
) -> None:
    at(monkeypatch, 1500, what)
    code, result = run(tmp_path)
    assert (code, result["reason"], result["drive_disabled"]) == (2, reason, True)
    assert words in said(capsys)
    samples = read_recording(tmp_path / "out" / "run.mcap").samples
    assert len(samples["stamp_ns"]) > 700
    with pytest.raises(SystemExit) as ended:
        cli.main(["replay", str(tmp_path / "out" / "run.mcap")])
    assert not ended.value.code


class Twice(SimulatedVesc):
    """A VESC that has a twin with the same id elsewhere on the bus: each answer comes twice."""

    def _answer(self, host: int, answer: bytes) -> None:
        super()._answer(host, answer)
        super()._answer(host, answer)


def test_two_with_one_id_end_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SIMULATED_DRIVES, "vesc", Twice)
    code, result = run(tmp_path)
    assert code == 2
    assert "two VESCs have this id" in said(capsys)
    assert result["counters"]["service"]["references_sent"] == 0


def test_another_host_that_commands_it_ends_the_run(tmp_path: Path) -> None:
    bus = VirtualForcepsBus("shared", rig=RIG, simulation=0)
    other = VirtualForcepsBus("shared")
    link, sent = VirtualTimeLink(bus), 0

    class Disturbed(VirtualTimeLink):
        def receive(self) -> list[tuple[int, Frame]]:
            nonlocal sent
            sent += 1
            if sent == 500:
                other.send(can.Message(arbitration_id=0x405, data=bytes(4), is_extended_id=True))
            return link.receive()

        def send(self, frame: Frame) -> Any:
            return link.send(frame)

    settings = Settings("kalman", True, sample_period_s(RIG), PAPER_TRAJECTORY, stamps_are_host_time(RIG))
    recording, log = tmp_path / "run.mcap", tmp_path / "bus.log"
    plan = Plan(RIG, settings, machine_for(RIG), service_config(RIG, 3.0), recording, log, {})
    session = run_session(Connection(Disturbed(bus), VirtualClock(bus), True, ()), plan)
    other.shutdown()
    assert session.service.reason is StopReason.VERSION_REFUSED
    assert "another program commands node 5, with SET_POS" in session.service.message
    assert session.service.drive_disabled
    assert len(read_recording(recording).samples) > 300


def vesc(rig: Rig = RIG) -> SimulatedVesc:
    return SimulatedVesc(rig, paper_load(0))


def turned(drive: SimulatedVesc, at_ns: int) -> float:
    return float(drive._forceps.truth(at_ns).theta_m_rad)


def test_any_command_feeds_its_timeout_requests_do_not_and_the_next_command_undoes_it() -> None:
    drive = vesc()
    start_deg = drive._angle_deg()
    hold = wire.set_position(NODE, start_deg / 360.0)
    drive.receive(hold, MS)
    for n in range(10):
        drive.receive(wire.request(NODE), (10 + 10 * n) * MS)
    assert drive.target_deg == pytest.approx(start_deg, abs=1e-4)
    assert not drive.has_timeout
    drive.wake(120 * MS)
    assert (drive.target_deg, drive.has_timeout) == (None, True)
    drive.receive(hold, 130 * MS)
    drive.wake(150 * MS)
    assert (drive.target_deg is None, drive.has_timeout) == (False, False)


def test_the_first_position_is_torque_at_once_whatever_it_is() -> None:
    drive = vesc()
    before = turned(drive, 0)
    drive.receive(wire.set_position(NODE, drive._angle_deg() / 360.0 + 0.1), MS)
    drive.wake(60 * MS)
    assert turned(drive, 60 * MS) - before > 0.3


def test_it_goes_the_shorter_way_round() -> None:
    drive = vesc()
    before = turned(drive, 0)
    for n in range(1, 20):
        drive.receive(wire.set_position(NODE, drive._angle_deg() / 360.0 + 0.55), n * MS)
    assert turned(drive, 20 * MS) < before


def test_a_fault_ends_by_itself_and_the_next_position_goes_on() -> None:
    drive = vesc()
    hold = wire.set_position(NODE, drive._angle_deg() / 360.0)
    drive.receive(hold, MS)
    drive.fail(UNDER_VOLTAGE, 10 * MS)
    drive.receive(hold, 20 * MS)
    assert (drive.target_deg, drive.fault) == (None, UNDER_VOLTAGE)
    drive.receive(hold, 520 * MS)
    assert (drive.target_deg is None, drive.fault) == (False, 0)


def test_who_asks_takes_the_mean_current_away() -> None:
    drive = vesc()
    drive.receive(wire.set_position(NODE, drive._angle_deg() / 360.0 + 0.02), MS)
    drive.wake(20 * MS)
    first = drive._values(wire.MASK)
    second = drive._values(wire.MASK)
    assert struct.unpack_from(">i", first, 5)[0] != 0
    assert struct.unpack_from(">i", second, 5)[0] == 0


def test_the_angle_wraps_and_is_told_as_a_32_bit_float() -> None:
    drive = vesc(RIG.with_changes({"motor_driver.encoder_zero_rev": 0.95}))
    assert drive._turns() > 1.0
    assert 0.0 <= drive._angle_deg() < 360.0
    assert math.radians(drive._angle_deg() + 360.0 - 0.95 * 360.0) == pytest.approx(turned(drive, 0), abs=5e-4)


@pytest.mark.parametrize("data", [b"", b"\x00", bytes(3), b"\xff" * 8])
@pytest.mark.parametrize("command", [0, 1, 3, 4, 8, 10, 17, 99])
def test_no_frame_raises(command: int, data: bytes) -> None:
    drive = vesc()
    drive.receive(Frame(command << 8 | NODE, data, is_extended=True), MS)
    drive.receive(Frame(command << 8 | NODE & 0xFF, data), MS)
    drive.wake(30 * MS)


def test_its_answers_are_read_as_they_were_meant() -> None:
    drive, answers = vesc(), Answers({"torn_answers": 0})
    drive.receive(wire.request(NODE), 5 * MS)
    found = None
    for frame in drive.take_outbox():
        if frame.arbitration_id == 5 << 8 | HOST:
            answers.fill(frame.data, 0)
        elif frame.arbitration_id == 7 << 8 | HOST:
            found = answers.process(frame.data)
    assert found is not None
    values = wire.parse_values(found.payload)
    assert values is not None
    assert (values.current_A, values.fault, values.has_timeout, values.is_killed) == (0.0, 0, True, False)
    assert values.position_rev * 360.0 == pytest.approx(drive._angle_deg(), abs=1e-6)


def test_a_rig_of_another_drive_is_refused() -> None:
    with pytest.raises(UserError, match=r"motor_driver.profile"):
        SimulatedVesc(load_rig(RIG_FILE.with_name("odrive.yaml")), paper_load(0))


def test_two_on_one_bus_answer_to_an_id_of_the_host_each() -> None:
    """Fragments say to whom they go and not from whom; two nodes that send one id at a time destroy both frames."""
    rigs = [RIG, RIG.with_changes({"motor_driver.node_id": 252})]
    answers: list[set[int]] = []
    for rig, machine in zip(rigs, machines_for(rigs), strict=True):
        peer = SimulatedVesc(rig, paper_load(0))
        peer.take_outbox()
        machine.connect(0)
        for frame in machine.poll(MS):
            peer.receive(frame, MS)
        answers.append({frame.arbitration_id & 0xFF for frame in peer.take_outbox() if frame.arbitration_id >> 8 < 8})
    assert answers == [{253}, {251}]  # 252 is a VESC's
