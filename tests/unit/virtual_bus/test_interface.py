"""The python-can interface in virtual time: frames, time-outs, handles, threads."""

import threading
from collections.abc import Iterator

import can
import pytest
from can.typechecking import CanFilter

from firmware_protocol.frames import Frame
from tests.unit.virtual_bus.clockwork import MS, ROOT, Clockwork, Mute, message
from virtual_bus import worlds
from virtual_bus.interface import VirtualForcepsBus


@pytest.fixture
def bus() -> Iterator[VirtualForcepsBus]:
    with VirtualForcepsBus("unit", nodes=[Clockwork()]) as handle:
        yield handle


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


def test_time_stands_where_the_frame_arrived_also_with_latency() -> None:
    with VirtualForcepsBus("late", rig=ROOT / "configs" / "realistic.yaml", truth_duration_s=0.1) as handle:
        for _ in range(20):
            frame = handle.recv(timeout=0.1)
            assert frame is not None
            assert round(frame.timestamp * 1e9) == handle.now_ns()
        rows = handle.truth_log().columns()["bus_time_ns"]
        assert 0 < len(rows) < 100
