"""CANopen's frames, byte for byte as makers have them: profile, simulated peer and others' library say the same."""

import json
from pathlib import Path
from typing import Any, cast

import canopen
import pytest
from canopen.emcy import EmcyConsumer
from canopen.nmt import NMT_STATES, NmtMaster
from canopen.profiles.p402 import State402
from canopen.sdo.client import SdoClient

from firmware_protocol.frames import Frame
from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.cia402.messages import Control, Entry, Nmt
from hil_forceps.drives.cia402.objects import RPDO1
from hil_forceps.drives.registry import PROFILES
from hil_forceps.rig import load_rig
from virtual_bus.drives.cia402 import SimulatedCia402
from virtual_bus.plant.load import paper_load

GOLDEN = json.loads((Path(__file__).parent / "golden.json").read_text())["frames"]
RIG = load_rig(Path(__file__).parents[4] / "configs" / "drives" / "cia402.yaml")
NODE, MS = 4, 1_000_000
SIZES = {0x2F: 1, 0x2B: 2, 0x23: 4}


def frame_of(row: dict[str, Any]) -> Frame:
    return Frame(int(row["arbitration_id"], 16), bytes.fromhex(row["data"]))


def golden(name: str) -> Frame:
    (row,) = [row for row in GOLDEN if row["name"] == name]
    return frame_of(row)


def rows(*kinds: str) -> list[Any]:
    return [pytest.param(row, id=row["name"]) for row in GOLDEN if row["kind"] in kinds]


def place_of(row: dict[str, Any]) -> tuple[int, int]:
    index, subindex = row["values"]["object"].split("h:")
    return int(index, 16), int(subindex, 16)


@pytest.mark.parametrize("row", [pytest.param(row, id=row["name"]) for row in GOLDEN])
def test_the_profile_reads_it(row: dict[str, Any]) -> None:
    assert PROFILES["cia402"].decode(frame_of(row)) == (row["kind"], row["values"])


@pytest.mark.parametrize("row", [pytest.param(row, id=row["name"]) for row in GOLDEN if row["to"] == "drive"])
def test_the_profile_sends_it(row: dict[str, Any]) -> None:
    frame, values = frame_of(row), row["values"]
    node = values.get("node", 0)
    if row["kind"] == "NMT":
        sent = wire.nmt(Nmt[values["command"]], node)
    elif row["kind"] == "SYNC":
        sent = wire.sync()
    elif row["kind"] == "SDO_READ":
        sent = wire.sdo_read(node, *place_of(row))
    elif row["kind"] == "SDO_WRITE":
        sent = wire.sdo_write(node, Entry(*place_of(row), SIZES[frame.data[0]], values["value"]))
    else:
        sent = Frame(0x200 + node, RPDO1.pack(int(values["controlword"], 16), values["target_counts"]))
    assert sent == frame


class Heard(canopen.Network):
    """Others' network that answers nothing; what it sends is kept."""

    def __init__(self, answer: Frame | None = None) -> None:
        super().__init__()
        self.sent: list[Frame] = []
        self.answer = answer

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        assert not remote
        self.sent.append(Frame(can_id, bytes(data)))
        if self.answer is not None:
            self.notify(self.answer.arbitration_id, bytearray(self.answer.data), 0.0)


def client(network: Heard, node: int) -> Any:
    found: Any = cast(Any, SdoClient)(0x600 + node, 0x580 + node, cast(Any, canopen.ObjectDictionary)())
    found.network, found.MAX_RETRIES, found.RESPONSE_TIMEOUT = network, 1, 0.01  # as many tries
    network.subscribe(0x580 + node, found.on_response)
    return found


@pytest.mark.parametrize("row", rows("SDO_WRITE", "SDO_READ"))
def test_others_send_the_same_requests(row: dict[str, Any]) -> None:
    frame, network = frame_of(row), Heard()
    ask = client(network, row["values"]["node"])
    arguments: tuple[Any, ...] = place_of(row)
    if row["kind"] == "SDO_WRITE":
        arguments += (frame.data[4 : 4 + SIZES[frame.data[0]]],)
    request = ask.upload if row["kind"] == "SDO_READ" else ask.download
    with pytest.raises(canopen.SdoCommunicationError):
        request(*arguments)
    assert network.sent[0] == frame


@pytest.mark.parametrize("row", rows("SDO_ANSWER"))
def test_others_read_the_same_answers(row: dict[str, Any]) -> None:
    values = row["values"]
    ask = client(Heard(frame_of(row)), values["node"])
    if "abort" in values:
        with pytest.raises(canopen.SdoAbortedError) as refused:
            ask.upload(*place_of(row))
        assert f"0x{refused.value.code:08x}" in values["abort"]
    elif "value" in values:
        assert int.from_bytes(ask.upload(*place_of(row)), "little") == values["value"]
    else:
        ask.download(*place_of(row), b"\x05")


@pytest.mark.parametrize("row", rows("HEARTBEAT", "EMCY", "NMT"))
def test_others_read_the_same_states(row: dict[str, Any]) -> None:
    frame, values = frame_of(row), row["values"]
    if row["kind"] == "EMCY":
        emergency: Any = cast(Any, EmcyConsumer)()
        emergency.on_emcy(frame.arbitration_id, frame.data, 0.0)
        assert f"0x{emergency.log[0].code:04x}" == values["error_code"]
        return
    network = Heard()
    master: Any = cast(Any, NmtMaster)(values["node"])
    master.network = network
    if row["kind"] == "HEARTBEAT":
        master.on_heartbeat(frame.arbitration_id, frame.data, 0.0)
        name = master.state if frame.data != b"\x00" else "BOOT-UP"
        assert name.replace("-", "_") == values["state"]
        assert NMT_STATES[frame.data[0]].replace("-", "_") in {values["state"], "INITIALISING"}
    else:
        master.state = {"START": "OPERATIONAL", "PRE_OPERATIONAL": "PRE-OPERATIONAL"}[values["command"]]
        assert network.sent == [frame]


@pytest.mark.parametrize("row", rows("TPDO1"))
def test_others_read_the_same_statuswords(row: dict[str, Any]) -> None:
    statusword, said = int(row["values"]["statusword"], 16), row["values"]["state"].replace("_", " ")
    (name,) = [name for name, (mask, bits) in State402.SW_MASK.items() if statusword & mask == bits]
    assert name == {"QUICK STOP": "QUICK STOP ACTIVE", "FAULT REACTION": "FAULT REACTION ACTIVE"}.get(said, said)


def peer() -> SimulatedCia402:
    return SimulatedCia402(RIG.with_changes({"motor_driver.node_id": NODE}), paper_load(0))


def test_the_simulated_drive_speaks_and_understands_the_makers_bytes() -> None:
    drive = peer()
    assert drive.take_outbox() == [golden("boot-up")]
    now_ns = MS

    def exchange(*requests: Frame) -> list[Frame]:
        nonlocal now_ns
        for request in requests:
            now_ns += MS
            drive.receive(request, now_ns)
        return drive.take_outbox()

    assert exchange(golden("the device type is read")) == [golden("its answer: CiA 402, a servo")]
    assert exchange(golden("5 is written to 6060h")) == [golden("its answer")]
    assert exchange(golden("mode 8, cyclic synchronous position")) == [golden("its answer")]
    assert drive.objects[0x6060, 0] == 8
    assert exchange(wire.sdo_read(NODE, 0x1234, 0)) == [golden("there is no such object")]
    assert exchange(wire.sdo_write(NODE, Entry(0x1A00, 1, 4, 0x10000020))) == [golden("it can't be mapped")]
    exchange(wire.sdo_write(NODE, Entry(0x1017, 0, 2, 10)))
    drive.wake(now_ns + 10 * MS)
    assert set(drive.take_outbox()) == {golden("heartbeat, pre-operational")}
    exchange(golden("node 4 is started"))
    drive.wake(now_ns + 20 * MS)
    assert golden("heartbeat, operational") in drive.take_outbox()
    now_ns += 20 * MS
    for name, bits in (("shutdown", 0x21), ("switch on", 0x23), ("enable operation", 0x27), ("disable voltage", 0x40)):
        exchange(golden(name))
        assert drive.status == bits
    drive.trip()
    assert drive.status == 0x08
    exchange(golden("fault reset"))
    assert drive.status == 0x40
    assert golden("fault reset").data[4] == Control.FAULT_RESET
    exchange(golden("node 4 becomes pre-operational"))
    assert drive.nmt == 0x7F


def test_the_simulated_drive_answers_sync_by_the_makers_pdos() -> None:
    drive = peer()
    for entry in (
        *wire.pdo_mapping(0x1800, 0x1A00, 0x184, 1, (0x60640020, 0x60410010, 0x60610008)),
        *wire.pdo_mapping(0x1400, 0x1600, 0x204, 255, (0x60400010, 0x607A0020)),
        Entry(0x6060, 0, 1, 8),
    ):
        drive.receive(wire.sdo_write(NODE, entry), MS)
    drive.receive(golden("node 4 is started"), MS)
    for control in (0x06, 0x07):
        drive.receive(Frame(0x204, RPDO1.pack(control, 1234)), MS)
    drive._counts = lambda: 1234  # type: ignore[method-assign]
    drive.receive(golden("reference 1234 counts, enabled"), MS)
    assert drive.objects[0x607A, 0] == 1234
    drive.take_outbox()
    for status, name in ((0x27, "OPERATION_ENABLED"), (0x40, "SWITCH_ON_DISABLED"), (0x08, "FAULT")):
        drive.status = status
        drive.receive(golden("SYNC"), MS)
        assert drive.take_outbox() == [golden(f"position 1234 counts, {name}, mode 8")]
