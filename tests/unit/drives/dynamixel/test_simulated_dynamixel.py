"""The whole way: service, serial line in virtual time, simulated servo, forceps; what goes wrong; others' host."""

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dynamixel_sdk import (
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    GroupSyncRead,
    GroupSyncWrite,
    PacketHandler,
    PortHandler,
)

from firmware_protocol.frames import Frame
from hil_forceps.cli import main as cli
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.drives.dynamixel import packets as wire
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError
from virtual_bus.drives import dynamixel_table as table
from virtual_bus.drives.dynamixel import OVERLOAD, SimulatedDynamixel
from virtual_bus.drives.dynamixel_packets import CODEC
from virtual_bus.plant.load import paper_load
from virtual_bus.realtime.loop import RealTimeLoop
from virtual_bus.realtime.serial_server import SerialServer

RIG_FILE = Path(__file__).parents[4] / "configs" / "drives" / "dynamixel.yaml"
RIG = load_rig(RIG_FILE)
NODE, MS = 5, 1_000_000
ACCESS_ERROR, RANGE_ERROR, LENGTH_ERROR, LIMIT_ERROR, INSTRUCTION_ERROR = 7, 4, 5, 6, 2


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


@pytest.mark.parametrize(
    ("ratio", "zero", "rate"), [("1.0", "0.25", 3_000_000), ("-1.0", "0.75", 1_000_000), ("3.0", "0.25", 4_500_000)]
)
def test_a_run_is_completed_with_nothing_lost(tmp_path: Path, ratio: str, zero: str, rate: int) -> None:
    rig = changed(tmp_path, "pulley_rev: 1.0 ", f"pulley_rev: {ratio} ")
    text = rig.read_text().replace("zero_rev: 0.25", f"zero_rev: {zero}").replace("s: 3000000", f"s: {rate}")
    rig.write_text(text)
    code, result = run(tmp_path, rig)
    assert (code, result["reason"], result["drive_disabled"]) == (0, "completed", True)
    counters = result["counters"]
    assert counters["host"]["samples"] > 3000
    assert counters["service"]["references_sent"] > 0.99 * counters["host"]["samples"]  # in every tick one
    lost = ("unanswered", "unexpected", "late_answers", "bad_length", "not_for_us", "restarts", "not_increasing")
    assert not any(counters["host"][name] for name in lost)
    with pytest.raises(SystemExit) as ended:
        cli.main(["replay", str(tmp_path / "out" / "run.mcap")])
    assert not ended.value.code
    recording = read_recording(tmp_path / "out" / "run.mcap")
    reference, angle = recording.references["passed_rad"][2500:], recording.samples["theta_m_rad"][2500:]
    assert abs(float(np.nanmean(reference)) - float(np.mean(angle))) < 0.02


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    logs = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        run(tmp_path / name, RIG_FILE, "--option", "seed=7")
        logs.append((tmp_path / name / "out" / "bus.log").read_bytes())
    assert logs[0] == logs[1]


def test_another_id_is_no_drive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = changed(tmp_path, "node_id: 5", "node_id: 6")
    arguments = ["run", "--rig", str(other), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={RIG_FILE}", "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert "no drive answered" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("what", "reason", "said"),
    [
        ("restart", "drive_lost", "sent no more samples or restarted"),
        ("overload", "drive_fault", "the drive latched a fault: hardware error 0x20 (overload)"),
        ("torque", "drive_stopped", "left the operational state without a request"),
    ],
)
def test_what_happens_to_a_running_servo_ends_the_run_in_one_line(
    what: str,
    reason: str,
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop = SimulatedDynamixel._loop

    def happens(self: SimulatedDynamixel, at_ns: int) -> None:
        if at_ns == 1_500 * MS:
            if what == "restart":
                self.restart()
            elif what == "overload":
                self.fail(OVERLOAD)
            else:
                self.table.put(64, 0)
        loop(self, at_ns)

    monkeypatch.setattr(SimulatedDynamixel, "_loop", happens)
    code, result = run(tmp_path)
    assert (code, result["reason"]) == (2, reason)
    assert result["drive_disabled"]
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("hil-forceps:")]
    assert said in line
    assert len(read_recording(tmp_path / "out" / "run.mcap").samples["stamp_ns"]) > 1400


def test_a_line_that_is_cut_ends_the_run_and_the_servos_watchdog_stops_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    faults = tmp_path / "faults.yaml"
    faults.write_text("- {fault: drop, direction: to_drive, from_s: 1.5}\n")
    servos: list[SimulatedDynamixel] = []
    make = SimulatedDynamixel.__init__

    def made(self: SimulatedDynamixel, *arguments: Any, **keywords: Any) -> None:
        make(self, *arguments, **keywords)
        servos.append(self)

    monkeypatch.setattr(SimulatedDynamixel, "__init__", made)
    code, result = run(tmp_path, RIG_FILE, "--option", f"faults={faults}")
    assert (code, result["reason"], result["drive_disabled"]) == (2, "drive_lost", False)
    assert "did not confirm that it is disabled" in capsys.readouterr().err
    (each,) = servos
    assert each.counters["watchdog_trips"] == 1
    assert each.table.get(116) == pytest.approx(each._present(), abs=2)


def test_a_fault_of_before_is_told_and_reset_on_demand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    make = SimulatedDynamixel.__init__

    def broken(self: SimulatedDynamixel, *arguments: Any, **keywords: Any) -> None:
        make(self, *arguments, **keywords)
        self.fail(OVERLOAD)

    monkeypatch.setattr(SimulatedDynamixel, "__init__", broken)
    code, result = run(tmp_path)
    assert (code, result["reason"]) == (2, "drive_fault")
    assert "has a latched fault: hardware error 0x20 (overload)" in capsys.readouterr().err
    code, result = run(tmp_path, RIG_FILE, "--reset-fault", "--overwrite")
    assert (code, result["reason"]) == (0, "completed")


def test_lost_and_damaged_packets_cost_samples_and_no_more(tmp_path: Path) -> None:
    faults = tmp_path / "faults.yaml"
    faults.write_text(
        "- {fault: drop, direction: to_host, probability: 0.01, from_s: 0.2}\n"
        "- {fault: corrupt_wire, direction: to_drive, probability: 0.01, from_s: 0.2}\n"
        "- {fault: drop, direction: to_drive, from_s: 1.5, to_s: 1.51}\n"
    )
    code, result = run(tmp_path, RIG_FILE, "--option", f"faults={faults}")
    assert (code, result["reason"], result["drive_disabled"]) == (0, "completed", True)
    host = result["counters"]["host"]
    assert host["unanswered"] > 20
    assert host["asked_again"] >= host["unanswered"]


def test_a_service_that_enables_it_moves_nothing(tmp_path: Path) -> None:
    run(tmp_path)
    recording = read_recording(tmp_path / "out" / "run.mcap")
    angle, state = recording.samples["theta_m_rad"], recording.samples["state"]
    begun = int(np.argmax(state == 2))
    assert float(np.ptp(angle[: begun + 2])) <= 2.0 * np.pi / 4096 + 1e-9


def servo(**more: Any) -> SimulatedDynamixel:
    made = SimulatedDynamixel(RIG, paper_load(0), **more)
    made.table.put(9, 0)
    return made


def ask(each: SimulatedDynamixel, frame: Frame, at_ns: int = 2 * MS) -> bytes | None:
    """What a servo answers: error, and the values behind it."""
    each.receive(frame, at_ns)
    each.wake(at_ns + MS)
    frames = each.take_outbox()
    return frames[0].data[1:] if frames else None


def write(address: int, size: int, value: int) -> Frame:
    return wire.write(NODE, address, (value & (1 << 8 * size) - 1).to_bytes(size, "little"))


def test_what_is_kept_is_locked_under_torque() -> None:
    each = servo()
    assert ask(each, write(11, 1, 5)) == b"\x00"
    assert ask(each, write(64, 1, 1)) == b"\x00"
    assert ask(each, write(11, 1, 3)) == bytes((ACCESS_ERROR,))
    assert each.table.get(11) == 5


@pytest.mark.parametrize(
    ("frame", "error"),
    [
        (write(116, 2, 5), LENGTH_ERROR),
        (write(116, 4, 2_000_000), RANGE_ERROR),
        (write(132, 4, 5), ACCESS_ERROR),
        (write(66, 1, 5), ACCESS_ERROR),
        (write(102, 2, 1193), 0),
        (wire.read(NODE, 66, 1), ACCESS_ERROR),
        (wire.read(NODE, 126, 10), 0),
        (Frame(NODE, b"\x05"), INSTRUCTION_ERROR),
        (Frame(NODE, b"\x99"), INSTRUCTION_ERROR),
        (Frame(NODE, b""), table.CRC),
    ],
)
def test_errors_are_the_makers(frame: Frame, error: int) -> None:
    answer = ask(servo(), frame)
    assert answer is not None
    assert answer[0] == error


def test_a_goal_current_beyond_the_limit_is_a_limit_error() -> None:
    each = servo()
    assert ask(each, write(38, 2, 100)) == b"\x00"
    assert ask(each, write(102, 2, 101)) == bytes((LIMIT_ERROR,))


def test_the_return_delay_and_who_is_answered() -> None:
    each = SimulatedDynamixel(RIG, paper_load(0))  # 500 µs by default
    each.receive(wire.ping(NODE), 2 * MS)
    each.wake(2 * MS + 499_999)
    assert each.take_outbox() == []
    each.wake(2 * MS + 500_000)
    assert [frame.data for frame in each.take_outbox()] == [bytes.fromhex("5500fc032d")]
    other = servo()
    assert ask(other, wire.ping(7)) is None
    assert ask(other, wire.ping(wire.BROADCAST_ID)) is not None
    assert ask(other, wire.read(wire.BROADCAST_ID, 64, 1)) is None
    assert ask(other, wire.write(wire.BROADCAST_ID, 65, b"\x01")) is None
    assert other.table.get(65) == 1
    ask(other, write(68, 1, 0))
    assert ask(other, wire.read(NODE, 64, 1)) is None
    assert ask(other, wire.ping(NODE)) is not None


def test_the_watchdog_is_fed_by_any_packet_stops_leaves_torque_and_locks_goals() -> None:
    each = servo()
    for frame in (write(11, 1, 5), write(102, 2, 0), write(98, 1, 5), write(64, 1, 1), write(116, 4, 1500)):
        assert ask(each, frame) == b"\x00"
    for n in range(20):
        ask(each, wire.ping(9), (10 + 90 * n) * MS)  # even one to another servo
    assert each.table.data[98] == 5
    each.wake(2_000 * MS)
    assert each.table.data[98] == table.TRIPPED
    assert each.table.get(64) == 1
    assert each.table.get(116) == each._present() != 1500
    assert ask(each, write(116, 4, 1600), 2_001 * MS) == bytes((RANGE_ERROR,))
    assert ask(each, write(98, 1, 0), 2_002 * MS) == b"\x00"
    assert ask(each, write(116, 4, 1600), 2_003 * MS) == b"\x00"


def test_a_shut_down_is_left_by_a_reboot_alone_and_alerts_in_every_answer() -> None:
    each = servo()
    ask(each, write(64, 1, 1))
    each.fail(OVERLOAD)
    assert each.table.get(64) == 0
    answer = ask(each, write(64, 1, 1))
    assert answer == bytes((0x80 | table.RESULT_FAIL,))
    assert ask(each, wire.read(NODE, 70, 1)) == bytes((0x80, OVERLOAD))
    assert ask(each, wire.reboot(NODE)) == b"\x80"
    assert ask(each, wire.read(NODE, 70, 1)) == b"\x00\x00"


def test_goals_may_bring_torque_where_the_drive_mode_says_so() -> None:
    each = servo()
    ask(each, write(10, 1, 8))
    ask(each, write(116, 4, 1000))
    assert each.table.get(64) == 1


def test_a_restart_forgets_turns_and_indirect_addresses() -> None:
    each = SimulatedDynamixel(RIG.with_changes({"motor_driver.encoder_zero_rev": 2.25}), paper_load(0))
    assert 0 <= each._present() < 4096
    ask(each, wire.write(NODE, 168, (64).to_bytes(2, "little")))
    each.restart()
    assert each.table.get(168) == 224


def test_it_is_made_for_its_own_rigs() -> None:
    with pytest.raises(UserError, match="must be dynamixel here"):
        SimulatedDynamixel(load_rig(RIG_FILE.parent / "odrive.yaml"), paper_load(0))


@pytest.fixture
def port(tmp_path: Path) -> Iterator[tuple[PortHandler, SimulatedDynamixel]]:
    """A servo on a pseudo terminal, run by the clock in a thread, and the SDK's port to it."""
    first = servo()
    ask(first, write(64, 1, 1))  # compiles the kernels: the SDK waits for tens of milliseconds only
    first.wake(50 * MS)
    each = servo()
    server = SerialServer(tmp_path / "port", CODEC)
    loop = RealTimeLoop(each, server, each._period_ns, spin_ns=0, max_catch_up_ns=MS, is_native=False)
    thread = threading.Thread(target=loop.run)
    thread.start()
    handler = PortHandler(str(tmp_path / "port"))
    assert handler.openPort()
    assert handler.setBaudRate(1_000_000)
    yield handler, each
    handler.closePort()
    loop.stop()
    thread.join(10.0)
    server.close()


@pytest.mark.realtime
@pytest.mark.alone
def test_the_makers_library_talks_to_the_simulated_servo(port: tuple[PortHandler, SimulatedDynamixel]) -> None:
    handler, each = port
    packets = PacketHandler(2.0)
    assert packets.ping(handler, NODE) == (1020, COMM_SUCCESS, 0)
    assert packets.ping(handler, NODE + 1)[1] == COMM_RX_TIMEOUT
    assert packets.write1ByteTxRx(handler, NODE, 11, 5) == (COMM_SUCCESS, 0)
    assert packets.write1ByteTxRx(handler, NODE, 64, 1) == (COMM_SUCCESS, 0)
    assert packets.write1ByteTxRx(handler, NODE, 11, 3) == (COMM_SUCCESS, ACCESS_ERROR)
    assert packets.read1ByteTxRx(handler, NODE, 11) == (5, COMM_SUCCESS, 0)
    position, result, error = packets.read4ByteTxRx(handler, NODE, 132)
    assert (result, error) == (COMM_SUCCESS, 0)
    writer = GroupSyncWrite(handler, packets, 116, 4)
    assert writer.addParam(NODE, list((position + 20).to_bytes(4, "little")))
    assert writer.txPacket() == COMM_SUCCESS
    reader = GroupSyncRead(handler, packets, 126, 10)
    assert reader.addParam(NODE)
    for _ in range(200):
        assert reader.txRxPacket() == COMM_SUCCESS
        if abs(reader.getData(NODE, 132, 4) - position - 20) <= 1:
            break
    assert abs(reader.getData(NODE, 132, 4) - position - 20) <= 1
    each.fail(OVERLOAD)
    _, result, error = packets.read1ByteTxRx(handler, NODE, 64)
    assert result == COMM_SUCCESS
    assert error & 0x80
    assert packets.reboot(handler, NODE)[0] == COMM_SUCCESS
    assert packets.read1ByteTxRx(handler, NODE, 70) == (0, COMM_SUCCESS, 0)
    assert each.counters["reboots"] == 1
