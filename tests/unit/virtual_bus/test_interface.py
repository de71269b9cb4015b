"""The python-can interface in virtual time, with small nodes in place of the drive."""

import errno
import os
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from can.typechecking import CanFilter

from firmware_protocol.frames import Frame
from virtual_bus import worlds
from virtual_bus.bus.faults import FOREVER_NS
from virtual_bus.interface import VirtualForcepsBus

ROOT = Path(__file__).resolve().parents[3]
MS = 1_000_000


class Clockwork:
    """Sends a numbered frame every millisecond; answers 0x41 with 0xA1 and the same data."""

    def __init__(self, period_ns: int = MS) -> None:
        self.period_ns = period_ns
        self.next_ns = period_ns
        self.number = 0
        self.outbox: deque[Frame] = deque()
        self.heard: list[tuple[int, Frame]] = []

    def receive(self, frame: Frame, now_ns: int) -> None:
        self.heard.append((now_ns, frame))
        if frame.arbitration_id == 0x41:
            self.outbox.append(Frame(0xA1, frame.data))

    def next_wake_ns(self) -> int:
        return self.next_ns

    def wake(self, now_ns: int) -> None:
        self.number += 1
        self.next_ns = now_ns + self.period_ns
        self.outbox.append(Frame(0x81, self.number.to_bytes(8, "little")))

    def take_outbox(self) -> list[Frame]:
        frames = list(self.outbox)
        self.outbox.clear()
        return frames


class Mute(Clockwork):
    def __init__(self) -> None:
        super().__init__(FOREVER_NS)


@pytest.fixture
def bus() -> Iterator[VirtualForcepsBus]:
    with VirtualForcepsBus("unit", nodes=[Clockwork()]) as handle:
        yield handle


def state_of(handle: VirtualForcepsBus) -> can.BusState:
    return handle.state


def message(arbitration_id: int, data: bytes = b"", **more: bool) -> can.Message:
    return can.Message(arbitration_id=arbitration_id, data=data, is_extended_id=more.pop("extended", False), **more)


def test_recv_runs_the_world_until_a_frame_arrives(bus: VirtualForcepsBus) -> None:
    first = bus.recv()
    assert first is not None
    assert first.arbitration_id == 0x81
    assert first.timestamp == pytest.approx(1.1e-3, abs=0.05e-3)
    assert bus.now_ns() == round(first.timestamp * 1e9)
    assert not first.is_extended_id
    assert first.channel == "unit"


def test_recv_timeout_passes_in_virtual_time(bus: VirtualForcepsBus) -> None:
    assert bus.recv(timeout=0.5e-3) is None
    assert bus.now_ns() == 500_000
    assert bus.recv(timeout=0) is None
    assert bus.now_ns() == 500_000
    assert bus.recv(timeout=0.7e-3) is not None


def test_filtered_out_frames_do_not_prolong_the_timeout(bus: VirtualForcepsBus) -> None:
    bus.set_filters([{"can_id": 0xA1, "can_mask": 0x7FF}])
    assert bus.recv(timeout=0.02) is None
    assert bus.now_ns() == 20 * MS
    bus.send(message(0x41, b"\x05"))
    answer = bus.recv(timeout=0.02)
    assert answer is not None
    assert (answer.arbitration_id, bytes(answer.data)) == (0xA1, b"\x05")
    bus.advance_until_ns(40 * MS)
    assert bus.receive_frames() == []
    bus.set_filters([{"can_id": 0x81, "can_mask": 0x7FF, "extended": True}])
    assert bus.recv(timeout=0.02) is None


def test_send_reaches_the_node_after_its_bits(bus: VirtualForcepsBus) -> None:
    bus.send(message(0x41, b"\x01"))
    answer = bus.recv(timeout=0.9e-3)
    assert answer is not None
    assert answer.arbitration_id == 0xA1
    assert answer.timestamp == pytest.approx(120e-6, rel=0.1)


def test_fast_path_and_messages_see_the_same(bus: VirtualForcepsBus) -> None:
    with VirtualForcepsBus("unit") as second:
        assert bus.send_frame(Frame(0x41, b"\x07"))
        bus.advance_until_ns(10 * MS)
        fast = bus.receive_frames()
        slow = [second.recv(timeout=0) for _ in range(len(fast) + 1)]
        assert second.recv(timeout=0) is None
        assert [m.arbitration_id for m in slow if m] == [0x41] + [f.arbitration_id for _, f in fast]
        assert [round(m.timestamp * 1e9) for m in slow[1:] if m] == [t for t, _ in fast]
        assert bus.receive_frames() == []


def test_same_calls_same_frames() -> None:
    def run() -> list[tuple[int, Frame]]:
        with VirtualForcepsBus(
            "again", nodes=[Clockwork()], seed=3, faults=[{"fault": "drop", "probability": 0.3}]
        ) as handle:
            for k in range(1, 100):
                handle.advance_until_ns(k * 700_000)
                handle.send_frame(Frame(0x41, bytes([k])))
            return handle.receive_frames()

    assert run() == run()


def test_handles_of_one_channel_share_a_world_and_hear_each_other(bus: VirtualForcepsBus) -> None:
    with VirtualForcepsBus("unit") as second:
        bus.send(message(0x300, b"\x01\x02"))
        heard = second.recv(timeout=0.5e-3)
        assert heard is not None
        assert (heard.arbitration_id, bytes(heard.data)) == (0x300, b"\x01\x02")
        assert bus.now_ns() == second.now_ns()
    assert bus.recv(timeout=2e-3) is not None
    assert "unit" in worlds.channels()
    bus.shutdown()
    assert "unit" not in worlds.channels()
    bus.shutdown()


def test_a_channel_without_a_world_or_with_another_one(bus: VirtualForcepsBus) -> None:
    with pytest.raises(can.CanInitializationError, match="rig="):
        VirtualForcepsBus("nowhere")
    with pytest.raises(can.CanInitializationError, match="already has a world"):
        VirtualForcepsBus("unit", nodes=[Clockwork()])
    assert worlds.channels() == ["unit"]
    assert bus.recv() is not None


@pytest.mark.parametrize(
    "options",
    [
        {"rigg": "x"},
        {"nodes": [], "rig": "x"},
        {"transmit_queue": "0", "nodes": []},
        {"receive_queue": 0, "nodes": []},
        {"nodes": [], "seed": "one"},
        {"nodes": [], "fd": "maybe"},
        {"faults": [{"fault": "drop"}]},
    ],
)
def test_wrong_options_are_refused_and_leave_nothing_behind(options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        VirtualForcepsBus("wrong", **options)  # type: ignore[arg-type]
    assert worlds.channels() == []


@pytest.mark.parametrize("options", [{"rig": "no/such/rig.yaml"}, {"nodes": [], "faults": [{"fault": "boom"}]}])
def test_what_can_not_be_opened_is_an_initialization_error(options: dict[str, object]) -> None:
    with pytest.raises(can.CanInitializationError, match=r"rig\.yaml|boom"):
        VirtualForcepsBus("wrong", **options)  # type: ignore[arg-type]
    assert worlds.channels() == []


def test_numbers_may_come_as_strings() -> None:
    with VirtualForcepsBus(
        "strings", nodes=[Clockwork()], seed="4", fd="true", transmit_queue="2", bitrate="500000"
    ) as handle:
        first = handle.recv(timeout=0.01)
        assert first is not None
        assert first.timestamp > 1.2e-3  # twice as long on the wire
        assert handle.protocol is can.CanProtocol.CAN_FD


def test_full_queue_at_once_and_with_patience() -> None:
    with VirtualForcepsBus("full", nodes=[Clockwork()], transmit_queue=2) as handle:
        handle.send(message(0x50, bytes(8)))
        handle.send(message(0x51, bytes(8)))
        with pytest.raises(can.CanOperationError) as caught:
            handle.send(message(0x52))
        assert caught.value.error_code == errno.ENOBUFS
        assert state_of(handle) is can.BusState.ACTIVE
        with pytest.raises(can.CanTimeoutError):
            handle.send(message(0x52), timeout=50e-6)
        handle.send(message(0x52), timeout=500e-6)
        assert handle.counters()["rejected_full"] > 0
        assert handle.send_frame(Frame(0x53, b"")) is False


def test_bus_off_and_recovery_show() -> None:
    faults = [{"fault": "bus_off", "node": "host", "from_s": 0.01, "to_s": 0.02}]
    with VirtualForcepsBus("off", nodes=[Clockwork()], faults=faults) as handle:
        handle.advance_until_ns(15 * MS)
        assert state_of(handle) is can.BusState.ERROR
        with pytest.raises(can.CanOperationError) as caught:
            handle.send(message(0x41))
        assert caught.value.error_code == errno.ENETDOWN
        assert handle.send_frame(Frame(0x41, b"")) is False
        # The drive, alone, repeats what nobody acknowledges: each attempt is one of the 128 sequences.
        handle.advance_until_ns(25 * MS)
        assert state_of(handle) is can.BusState.ERROR
        handle.advance_until_ns(45 * MS)
        assert state_of(handle) is can.BusState.ACTIVE
        handle.send(message(0x41))
        assert handle.counters()["bus_offs"] == 1


def test_error_passive_shows() -> None:
    faults = [{"fault": "corrupt_wire", "id": 0x41, "count": 17}]
    with VirtualForcepsBus("passive", nodes=[Mute()], faults=faults) as handle:
        handle.send(message(0x41))
        handle.advance_until_ns(10 * MS)
        assert handle.counters()["tec"] == 17 * 8 - 1
        assert state_of(handle) is can.BusState.PASSIVE


def test_bus_gone_is_an_error_that_costs_the_wait() -> None:
    faults = [{"fault": "bus_gone", "from_s": 0.01, "to_s": 0.02}]
    with VirtualForcepsBus("gone", nodes=[Clockwork()], faults=faults) as handle:
        handle.advance_until_ns(10 * MS)
        while handle.recv(timeout=0):
            pass
        with pytest.raises(can.CanOperationError) as caught:
            handle.recv(timeout=0.005)
        assert caught.value.error_code == errno.ENODEV
        assert handle.now_ns() == 15 * MS
        assert state_of(handle) is can.BusState.ERROR
        with pytest.raises(can.CanOperationError) as caught:
            handle.send(message(0x41))
        assert caught.value.error_code == errno.ENODEV
        with pytest.raises(can.CanOperationError):
            handle.recv(timeout=0.006)
        assert handle.recv(timeout=0.002) is not None


@pytest.mark.parametrize(
    "wrong",
    [
        message(0x41, is_remote_frame=True),
        message(0x41, is_error_frame=True),
        message(0x41, bytes(12), is_fd=True),
    ],
)
def test_frames_this_bus_does_not_carry(bus: VirtualForcepsBus, wrong: can.Message) -> None:
    with pytest.raises(can.CanOperationError) as caught:
        bus.send(wrong)
    assert caught.value.error_code == errno.EINVAL


def test_extended_ids_travel_as_such(bus: VirtualForcepsBus) -> None:
    """0x42 with 29 bits is not the 0x42 with 11; a filter that says nothing of it lets both pass."""
    sent = [message(0x42, b"\x01", extended=True), message(0x1FFFFFFF, b"\x02", extended=True)]
    with VirtualForcepsBus("unit") as second:
        for each in sent:
            bus.send(each)
        assert bus.send_frame(Frame(0x8001, b"\x03", is_extended=True))
        heard = [second.recv(timeout=0.5e-3) for _ in range(3)]
        assert [(m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in heard if m] == [
            (0x42, True, b"\x01"),
            (0x8001, True, b"\x03"),
            (0x1FFFFFFF, True, b"\x02"),
        ]
        for wanted, extended in ((True, True), (False, False), (None, True)):
            only: CanFilter = {"can_id": 0x42, "can_mask": 0x7FF}
            second.set_filters([only if wanted is None else {**only, "extended": wanted}])
            bus.send(sent[0])
            found = second.recv(timeout=0.5e-3)
            assert (found is not None) is extended
    with pytest.raises(can.CanOperationError, match="29 bits"):
        bus.send(can.Message(arbitration_id=0x20000000, is_extended_id=True, check=False))


def test_fd_frames_travel_where_fd_is_on(bus: VirtualForcepsBus) -> None:
    with pytest.raises(ValueError, match="FD is off"):
        bus.send_frame(Frame(0x61, bytes(16), is_fd=True))
    with VirtualForcepsBus("fd", nodes=[Mute()], fd=True) as one, VirtualForcepsBus("fd") as other:
        one.send(message(0x61, bytes(range(16)), is_fd=True))
        heard = other.recv(timeout=1e-3)
        assert heard is not None
        assert (heard.is_fd, heard.bitrate_switch, heard.dlc) == (True, True, 16)
        with pytest.raises(can.CanOperationError, match="no CAN FD frame carries 9 bytes"):
            one.send(message(0x61, bytes(9), is_fd=True))


def test_waiting_for_what_can_not_come_is_an_error_not_a_hang() -> None:
    with VirtualForcepsBus("mute", nodes=[Mute()]) as handle, pytest.raises(can.CanOperationError, match="forever"):
        handle.recv()


def test_a_handle_that_was_shut_down_says_so(bus: VirtualForcepsBus) -> None:
    bus.shutdown()
    for use in (lambda: bus.recv(0), lambda: bus.send(message(1)), lambda: bus.send_frame(Frame(1, b""))):
        with pytest.raises(can.CanOperationError, match="shut down"):
            use()


def test_flush_forgets_what_waits(bus: VirtualForcepsBus) -> None:
    with VirtualForcepsBus("unit") as second:
        for k in range(5):
            bus.send(message(0x100 + k))
        bus.flush_tx_buffer()
        assert second.recv(timeout=0.9e-3) is None


def test_notifier_delivers_from_its_thread() -> None:
    arrived = threading.Event()
    heard: list[can.Message] = []

    def listen(each: can.Message) -> None:
        heard.append(each)
        if len(heard) >= 20:
            arrived.set()

    with VirtualForcepsBus("notify", nodes=[Clockwork()]) as handle:
        handle.send(message(0x41, b"\x09"))  # before the thread that moves time
        notifier = can.Notifier(handle, [listen], timeout=0.01)
        assert arrived.wait(20.0)
        notifier.stop()
    assert 0xA1 in {each.arbitration_id for each in heard}
    numbers = [int.from_bytes(each.data, "little") for each in heard if each.arbitration_id == 0x81]
    assert numbers == list(range(1, len(numbers) + 1))


def test_no_truth_without_a_drive(bus: VirtualForcepsBus) -> None:
    with pytest.raises(ValueError, match="no truth"):
        bus.truth_log()


def test_channels_in_use_are_found(bus: VirtualForcepsBus) -> None:
    assert can.detect_available_configs([]) == []
    assert VirtualForcepsBus._detect_available_configs() == [{"interface": "virtual_forceps", "channel": "unit"}]
    assert bus.channel_info.endswith("unit")


def test_time_stands_where_the_frame_arrived_also_with_latency() -> None:
    with VirtualForcepsBus("late", rig=ROOT / "configs" / "realistic.yaml", truth_duration_s=0.1) as handle:
        for _ in range(20):
            frame = handle.recv(timeout=0.1)
            assert frame is not None
            assert round(frame.timestamp * 1e9) == handle.now_ns()
        rows = handle.truth_log().columns()["bus_time_ns"]
        assert 0 < len(rows) < 100


def test_python_can_finds_it_by_name(tmp_path: Path) -> None:
    """In a process of its own, with the entry points of pyproject.toml as an installed package has them."""
    import tomllib  # noqa: PLC0415

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    info = tmp_path / "forceps_entry-0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: forceps-entry\nVersion: 0\n")
    entries = project["entry-points"]["can.interface"]
    (info / "entry_points.txt").write_text("[can.interface]\n" + "\n".join(f"{k} = {v}" for k, v in entries.items()))
    program = (
        "import can\n"
        "rig = 'configs/paper.yaml'\n"
        "bus = can.Bus(interface='virtual_forceps', channel='bench', rig=rig, simulation='1', seed='2')\n"
        "first = bus.recv(1.0)\n"
        "print(type(bus).__name__, first.arbitration_id & 31, bus.now_ns() < 10**9)\n"
        "bus.shutdown()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.stdout.split() == ["VirtualForcepsBus", "1", "True"], done.stderr


def test_a_load_by_points_goes_before_the_papers() -> None:
    rig = ROOT / "configs" / "paper.yaml"
    with VirtualForcepsBus("load", rig=rig, simulation=2, load=[(0.0, 1e-3), (1.0, 0.0)], truth_duration_s=0.05) as bus:
        bus.advance_until_ns(40 * MS)
        # It begins with the first sample in operation: until then the first torque holds.
        assert set(bus.truth_log().columns()["tau_w_N_m"]) == {1e-3}
        with pytest.raises(can.CanInitializationError, match="already has a world made of something else"):
            VirtualForcepsBus("load", rig=rig, simulation=2)
    for points, said in (
        ([], "at least one"),
        ([(1.0, 0.0), (0.0, 0.0)], "not decrease"),
        ([(0.0, float("nan"))], "fin"),
    ):
        with pytest.raises(can.CanInitializationError, match=said):
            VirtualForcepsBus("load", rig=rig, load=points)
