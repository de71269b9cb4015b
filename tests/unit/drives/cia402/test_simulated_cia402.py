"""Service, bus in virtual time, simulated CiA 402 drive, forceps; and others' CANopen against both ends."""

import json
import shutil
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import canopen
import numpy as np
import pytest
from canopen.objectdictionary import ObjectDictionary, ODArray, ODRecord, ODVariable, datatypes
from canopen.profiles.p402 import BaseNode402

from firmware_protocol.frames import Frame
from firmware_protocol.states import HostPhase
from hil_forceps.cli import main as cli
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.registry import machine_for
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError
from virtual_bus.drives.cia402 import ENABLED, FAULT, HEARTBEAT_LOST, SimulatedCia402
from virtual_bus.plant.load import paper_load

RIG_FILE = Path(__file__).parents[4] / "configs" / "drives" / "cia402.yaml"
RIG = load_rig(RIG_FILE)
NODE, MS = 5, 1_000_000


def run(tmp_path: Path, rig: Path = RIG_FILE, *more: str, duration: str = "3") -> tuple[int, dict[str, Any]]:
    arguments = ["run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={rig}", "--duration", duration, "--out", str(tmp_path / "out"), *more])
    return int(ended.value.code or 0), json.loads((tmp_path / "out" / "run.json").read_text())


def drive() -> SimulatedCia402:
    return SimulatedCia402(RIG, paper_load(0))


@pytest.mark.parametrize("ratio", ["1.0", "-2.5"])
def test_a_run_is_completed_with_nothing_lost(tmp_path: Path, ratio: str) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG_FILE.read_text().replace("pulley_rev: 1.0 ", f"pulley_rev: {ratio} "))
    code, result = run(tmp_path, rig)
    assert (code, result["reason"], result["drive_disabled"]) == (0, "completed", True)
    host = result["counters"]["host"]
    assert host["samples"] >= 3000
    assert not any(host[name] for name in ("unpaired", "bad_length", "emergencies", "samples_overflow"))
    with pytest.raises(SystemExit) as ended:
        cli.main(["replay", str(tmp_path / "out")])
    assert not ended.value.code
    recording = read_recording(tmp_path / "out" / "run.mcap")
    reference, angle = recording.references["passed_rad"][2500:], recording.samples["theta_m_rad"][2500:]
    assert abs(float(np.nanmean(reference)) - float(np.mean(angle))) < 0.02
    first = int(np.argmax(recording.samples["state"] == 2))
    assert first > 2
    assert float(np.ptp(recording.samples["theta_m_rad"][: first + 5])) < 2e-3


def test_without_the_hosts_heartbeat_the_drive_faults_within_its_time() -> None:
    node = drive()
    node.receive(wire.sdo_write(NODE, wire.Entry(0x1016, 1, 4, 127 << 16 | 100)), MS)
    node.receive(wire.sdo_write(NODE, wire.Entry(0x6060, 0, 1, 8)), 2 * MS)
    node.receive(wire.heartbeat(127), 3 * MS)
    for control in (0x06, 0x07, 0x0F):
        node.receive(wire.sdo_write(NODE, wire.Entry(0x6040, 0, 2, control)), 4 * MS)
    assert node.status == ENABLED
    node.wake(102 * MS)
    assert node.status == ENABLED
    node.take_outbox()
    node.wake(104 * MS)
    assert node.status == FAULT
    assert Frame(0x085, struct.pack("<HB5x", HEARTBEAT_LOST, 0x11)) in node.take_outbox()


def test_a_drive_that_reboots_while_running_ends_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = SimulatedCia402._loop

    def reboots(self: SimulatedCia402, at_ns: int) -> None:
        if at_ns == 1_500 * MS:
            self.reboot(at_ns)
        loop(self, at_ns)

    monkeypatch.setattr(SimulatedCia402, "_loop", reboots)
    code, result = run(tmp_path)
    assert (code, result["reason"]) == (2, "drive_lost")
    assert "sent no more samples or restarted" in capsys.readouterr().err
    assert len(read_recording(tmp_path / "out" / "run.mcap").samples["stamp_ns"]) > 1300


def test_a_drive_whose_current_is_in_thousandths_of_its_rated_one(tmp_path: Path) -> None:
    """As most makers have it: 6078h, 16 bits, in thousandths of 6075h."""
    rig = tmp_path / "rig.yaml"
    keys = "  current_object: 6078h:00\n  current_object_bits: 16\n  current_lsb_A: 5.0e-4\n"
    rig.write_text(RIG_FILE.read_text().replace("  profile: cia402\n", "  profile: cia402\n" + keys))
    code, _ = run(tmp_path, rig, "--option", "simulation=2", duration="11")
    assert code == 0
    here = read_recording(tmp_path / "out" / "run.mcap").samples["current_A"]
    shutil.rmtree(tmp_path / "out")
    code, _ = run(tmp_path / "epos", RIG_FILE, "--option", "simulation=2", duration="11")
    assert code == 0
    there = read_recording(tmp_path / "epos" / "out" / "run.mcap").samples["current_A"]
    assert np.ptp(there) > 0.1
    assert float(np.abs(here[:11000] - there[:11000]).max()) < 0.02


def sdo(drive: SimulatedCia402, index: int, subindex: int, size: int, value: int) -> int:
    """Write an object; return the abort code, 0 where it was taken."""
    command = {1: 0x2F, 2: 0x2B, 4: 0x23}[size]
    drive.take_outbox()
    drive.receive(Frame(0x605, struct.pack("<BHBI", command, index, subindex, value)), MS)
    (answer,) = [frame for frame in drive.take_outbox() if frame.arbitration_id == 0x585]
    return int.from_bytes(answer.data[4:], "little") if answer.data[0] == 0x80 else 0


@pytest.mark.parametrize(("count", "abort"), [(1, 0), (2, 0), (3, 0x06040042), (8, 0x06040042), (9, 0x06040042)])
def test_what_a_frame_does_not_hold_can_not_be_mapped(count: int, abort: int) -> None:
    peer = drive()
    for place in range(1, 9):
        assert sdo(peer, 0x1A00, place, 4, 0x60640020) == 0
    assert sdo(peer, 0x1A00, 0, 1, count) == abort


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"encoder.counts_per_rev": "ideal"}, "encoder.counts_per_rev: is ideal"),
        ({"bench.host_period_s": 1.5e-3}, "bench.host_period_s: 0.0015 s is not a whole number of ms"),
        ({"motor_driver.node_id": 0}, "node_id: is 0, but the nodes of the profile cia402 are 1 to 126"),
        ({"motor_driver.encoder_zero_rev": 1e6}, r"encoder_zero_rev: is 1e\+06; .* 1.64e\+10 counts"),
    ],
)
def test_rigs_that_can_not_be_are_told(change: dict[str, object], said: str) -> None:
    with pytest.raises(UserError, match=said):
        machine_for(RIG.with_changes(change))


def dictionary() -> Any:
    """The objects that both sides talk of, as others' library wants them."""
    od: Any = cast(Any, ObjectDictionary)()
    kinds = {1: datatypes.UNSIGNED8, 2: datatypes.UNSIGNED16, 4: datatypes.UNSIGNED32}

    def variable(index: int, subindex: int, size: int, signed: bool = False) -> ODVariable:
        found = ODVariable(f"{index:04X}_{subindex:X}", index, subindex)
        found.data_type = kinds[size] if not signed else {1: datatypes.INTEGER8, 4: datatypes.INTEGER32}[size]
        found.access_type = "rw"
        found.default = 0
        return found

    for index, size, signed in (
        (0x1000, 4, False), (0x1017, 2, False), (0x6040, 2, False), (0x6041, 2, False), (0x6060, 1, True),
        (0x6061, 1, True), (0x6064, 4, True), (0x607A, 4, True), (0x6502, 4, False),
    ):  # fmt: skip
        od.add_object(variable(index, 0, size, signed))
    for index, sizes in (
        (0x1016, (4,)), (0x60C2, (1, 1)), (0x30D1, (4, 4)), (0x1400, (4, 1)), (0x1800, (4, 1)), (0x1801, (4, 1)),
    ):  # fmt: skip
        record = ODRecord(f"{index:04X}", index)
        record.add_member(variable(index, 0, 1))
        for subindex, size in enumerate(sizes, start=1):
            record.add_member(variable(index, subindex, size, signed=index == 0x30D1))
        od.add_object(record)
    for index in (0x1600, 0x1A00, 0x1A01):
        array = ODArray(f"{index:04X}", index)
        array.add_member(variable(index, 0, 1))
        for subindex in range(1, 9):
            array.add_member(variable(index, subindex, 4))
        od.add_object(array)
    return od


class Wired(canopen.Network):
    """Others' network on a wire that takes no time: what it sends is handed over, and answered, at once."""

    def __init__(self, hand_over: Any) -> None:
        super().__init__()
        self.hand_over = hand_over

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        assert not remote
        for frame in self.hand_over(Frame(can_id, bytes(data))):
            self.notify(frame.arbitration_id, bytearray(frame.data), 0.0)

    def send_periodic(self, can_id: int, data: bytes, period: float, remote: bool = False) -> Any:  # noqa: ARG002
        """Nothing goes out by itself here."""
        return SimpleNamespace(stop=lambda: None, update=lambda _: None)


def test_others_master_takes_the_simulated_drive_to_operation() -> None:
    peer, now_ns = drive(), 0

    def to_peer(frame: Frame) -> list[Frame]:
        nonlocal now_ns
        now_ns += MS
        peer.receive(frame, now_ns)
        return peer.take_outbox()

    network = Wired(to_peer)
    node: Any = network.add_node(cast(Any, BaseNode402)(NODE, dictionary()))
    assert node.sdo[0x1000].raw & 0xFFFF == 402
    node.sdo[0x6060].raw = 8
    node.state = "OPERATION ENABLED"
    assert node.state == "OPERATION ENABLED"
    assert peer.status == ENABLED
    assert node.sdo[0x6061].raw == 8
    before = node.sdo[0x6064].raw
    node.sdo[0x607A].raw = before + 100
    now_ns += 300 * MS
    assert node.sdo[0x6064].raw == pytest.approx(before + 100, abs=3)
    with pytest.raises(canopen.SdoAbortedError) as refused:
        node.sdo[0x6041].raw = 1
    assert refused.value.code == 0x06010002
    node.state = "SWITCH ON DISABLED"
    assert node.state == "SWITCH ON DISABLED"


def test_others_local_node_is_set_up_by_the_profile() -> None:
    machine = machine_for(RIG)
    answers: list[Frame] = []

    def from_node(frame: Frame) -> list[Frame]:
        answers.append(frame)
        return []

    network = Wired(from_node)
    node: Any = network.create_node(cast(Any, canopen.LocalNode(NODE, dictionary())))
    node.sdo[0x1000].raw = 0x00020192
    machine.connect(0)
    for n in range(100):
        for frame in machine.poll(n * MS):
            network.notify(frame.arbitration_id, bytearray(frame.data), 0.0)
            if frame == wire.sync() and node.nmt.state == "OPERATIONAL":
                node.tpdo.read()
                for place, values in ((1, (1234, 0x0240, 8)), (2, (-77,))):
                    for variable, value in zip(node.tpdo[place], values, strict=True):
                        variable.raw = value
                    node.tpdo[place].transmit()
        for frame in answers:
            machine.receive(frame, n * MS)
        answers.clear()
    assert machine.phase is HostPhase.READY
    assert node.sdo[0x6060].raw == 8
    assert node.sdo[0x60C2][1].raw == 1
    samples = machine.take_samples()
    assert samples
    counts = RIG.encoder.counts_per_rev
    assert counts is not None
    assert samples[-1].theta_m == round(1234 / counts * 2**24)
    assert samples[-1].current == round(-0.077 / 2e-4)
