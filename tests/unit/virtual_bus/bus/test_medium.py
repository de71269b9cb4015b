"""Arbitration, errors and fault confinement of the virtual bus."""

from collections import deque

import pytest

from firmware_protocol.frames import Frame
from virtual_bus.bus.bit_timing import BitTiming, frame_bits
from virtual_bus.bus.faults import FOREVER_NS, FaultInjector, Side, parse_faults
from virtual_bus.bus.medium import Medium
from virtual_bus.bus.port import Port, PortState
from virtual_bus.bus.simulation import Simulation

MS = 1_000_000


class Talker:
    """Sends frames at given times, keeps what it hears."""

    def __init__(self, schedule: list[tuple[int, Frame]] | None = None) -> None:
        self.schedule = deque(schedule or [])
        self.heard: list[tuple[int, Frame]] = []
        self.outbox: list[Frame] = []

    def receive(self, frame: Frame, now_ns: int) -> None:
        self.heard.append((now_ns, frame))

    def next_wake_ns(self) -> int:
        return self.schedule[0][0] if self.schedule else FOREVER_NS

    def wake(self, now_ns: int) -> None:
        while self.schedule and self.schedule[0][0] <= now_ns:
            self.outbox.append(self.schedule.popleft()[1])

    def take_outbox(self) -> list[Frame]:
        frames, self.outbox = self.outbox, []
        return frames

    def ids(self) -> list[int]:
        return [frame.arbitration_id for _, frame in self.heard]


def bus(*talkers: Talker, faults: object = None, queue_frames: int = 16) -> tuple[Simulation, list[Port]]:
    injector = FaultInjector(parse_faults(faults), 1) if faults else None
    simulation = Simulation(Medium(BitTiming(), injector))
    ports = [
        simulation.add(talker, f"t{index}", Side.HOST if index == 0 else Side.DRIVE, queue_frames)
        for index, talker in enumerate(talkers)
    ]
    return simulation, ports


def test_lowest_id_wins_among_all_that_wait_whoever_queued_first() -> None:
    high, low = Talker([(0, Frame(0x300, b""))]), Talker([(0, Frame(0x100, b"")), (0, Frame(0x200, b""))])
    listener = Talker()
    simulation, _ = bus(high, low, listener)
    simulation.advance_until(MS)
    assert listener.ids() == [0x100, 0x200, 0x300]


def test_a_frame_on_the_wire_is_not_interrupted() -> None:
    first, urgent, listener = Talker([(0, Frame(0x300, bytes(8)))]), Talker([(1000, Frame(0x001, b""))]), Talker()
    simulation, _ = bus(first, urgent, listener)
    simulation.advance_until(MS)
    assert listener.ids() == [0x300, 0x001]


def test_frames_arrive_at_the_end_of_eof_and_follow_after_three_bits() -> None:
    frames = [Frame(0x100, b"\x12\x34"), Frame(0x101, b"\xff")]
    sender, listener = Talker([(5000, frame) for frame in frames]), Talker()
    simulation, _ = bus(sender, listener)
    simulation.advance_until(MS)
    first_ns = 5000 + frame_bits(frames[0]).nominal * 1000
    assert listener.heard == [
        (first_ns, frames[0]),
        (first_ns + 3000 + frame_bits(frames[1]).nominal * 1000, frames[1]),
    ]


def test_the_sender_does_not_hear_itself() -> None:
    sender, listener = Talker([(0, Frame(0x1, b""))]), Talker()
    simulation, _ = bus(sender, listener)
    simulation.advance_until(MS)
    assert sender.heard == []
    assert len(listener.heard) == 1


def test_frames_of_one_id_keep_their_order() -> None:
    frames = [Frame(0x55, bytes([i])) for i in range(10)]
    sender, listener = Talker([(0, frame) for frame in frames]), Talker()
    simulation, _ = bus(sender, listener)
    simulation.advance_until(2 * MS)
    assert [frame for _, frame in listener.heard] == frames


def test_full_queue_rejects_and_counts() -> None:
    sender = Talker([(0, Frame(i, b"")) for i in range(6)])
    listener = Talker()
    simulation, ports = bus(sender, listener, queue_frames=4)
    simulation.advance_until(MS)
    assert ports[0].rejected_full == 2
    assert len(listener.heard) == ports[0].sent == 4
    assert ports[0].queued == 0


def test_same_id_same_bits_is_one_frame_of_two_senders() -> None:
    frame = Frame(0x80, b"\x01\x02")
    a, b, listener = Talker([(0, frame)]), Talker([(0, frame)]), Talker()
    simulation, ports = bus(a, b, listener)
    simulation.advance_until(MS)
    assert len(listener.heard) == 1
    assert [port.sent for port in ports] == [1, 1, 0]
    assert [port.error_frames for port in ports] == [0, 0, 0]


def test_two_senders_of_the_same_bits_do_not_acknowledge_each_other() -> None:
    frame = Frame(0x80, b"\x01\x02")
    simulation, ports = bus(Talker([(0, frame)]), Talker([(0, frame)]))
    simulation.advance_until(MS // 2)
    assert [port.sent for port in ports] == [0, 0]


def test_same_id_other_data_fails_until_both_are_error_passive_then_both_get_through() -> None:
    a, b, listener = Talker([(0, Frame(0x80, b"\x01"))]), Talker([(0, Frame(0x80, b"\x02"))]), Talker()
    simulation, ports = bus(a, b, listener)
    simulation.advance_until(20 * MS)
    # 16 failures make a TEC of 128. In the 17th meeting the sender of the first recessive bit (b) drops out in silence.
    assert [frame.data for _, frame in listener.heard] == [b"\x01", b"\x02"]
    assert [port.error_frames for port in ports] == [16, 17, 16]
    assert [port.tec for port in ports[:2]] == [16 * 8 - 1, 17 * 8 - 1]
    assert ports[0].state is PortState.ERROR_ACTIVE  # one success below 128
    assert ports[1].state is PortState.ERROR_PASSIVE
    assert ports[2].rec == 16 - 2


def test_a_node_that_always_loses_goes_bus_off() -> None:
    period, count = 5 * MS, 30
    a = Talker([(k * period, Frame(0x80, b"\x00")) for k in range(count)])
    b = Talker([(k * period, Frame(0x80, b"\xff")) for k in range(count)])
    simulation, ports = bus(a, b, Talker())
    simulation.advance_until(count * period)
    assert [port.bus_offs for port in ports] == [0, 1, 0]
    # Back with clean counters it destroys the other's frames again: that one's are no longer clean.
    assert ports[0].tec > 200


def test_corrupt_wire_costs_an_error_frame_and_is_repeated() -> None:
    frame = Frame(0x80, b"\x01")
    sender, listener = Talker([(0, frame)]), Talker()
    simulation, ports = bus(sender, listener, faults=[{"fault": "corrupt_wire", "count": 2}])
    simulation.advance_until(MS)
    bits = frame_bits(frame).nominal
    assert listener.heard == [((2 * (bits - 7 + 20 + 3) + bits) * 1000, frame)]
    assert (ports[0].tec, ports[0].sent, ports[0].error_frames) == (2 * 8 - 1, 1, 2)
    assert (ports[1].rec, ports[1].received) == (1, 1)


def test_endless_errors_end_in_bus_off_after_32_failures_and_recovery_takes_128_times_11_bits() -> None:
    sender = Talker([(0, Frame(0x80, b"\x01")), (10 * MS, Frame(0x81, b""))])
    listener = Talker()
    simulation, ports = bus(sender, listener, faults=[{"fault": "corrupt_wire", "id": 0x80}])
    off_ns = back_ns = None
    while simulation.step(9 * MS):
        is_off = ports[0].state == PortState.BUS_OFF
        if is_off and off_ns is None:
            off_ns = simulation.now_ns
        if off_ns is not None and not is_off:
            back_ns = simulation.now_ns
            break
    assert ports[0].error_frames == 32
    assert (ports[0].discarded, ports[0].queued, ports[0].bus_offs) == (1, 0, 1)
    assert off_ns is not None
    assert back_ns is not None
    # The end of the last error frame is the first of the 128 sequences, and ends with the intermission.
    assert back_ns - off_ns == 3000 + 127 * 11 * 1000
    simulation.advance_until(20 * MS)
    assert listener.ids() == [0x81]


def test_traffic_counts_towards_recovery_one_sequence_a_frame() -> None:
    off = {"fault": "bus_off", "node": "host", "from_s": 0.0, "to_s": 0.001}
    # A bus without a pause: from 1 ms on every frame ends with the only sequence there is.
    chatter = [(MS - 1, Frame(0x10, b"\x55" * 8)) for _ in range(200)]
    victim, talker, listener = Talker(), Talker(chatter), Talker()
    simulation, ports = bus(victim, talker, listener, faults=[off], queue_frames=300)
    while simulation.step(100 * MS):
        if len(listener.heard) and ports[0].state is not PortState.BUS_OFF:
            break
    assert len(listener.heard) in (127, 128)


def test_nobody_to_acknowledge_ends_error_passive_not_bus_off() -> None:
    lonely = Talker([(0, Frame(0x80, b""))])
    simulation, ports = bus(lonely)
    simulation.advance_until(100 * MS)
    assert ports[0].state is PortState.ERROR_PASSIVE
    assert (ports[0].tec, ports[0].sent, ports[0].bus_offs) == (128, 0, 0)
    friend = Talker()
    simulation.add(friend, "friend", Side.DRIVE)
    simulation.advance_until(101 * MS)
    assert friend.ids() == [0x80]


def test_bus_off_window_silences_a_node_and_tells_it() -> None:
    told: list[bool] = []
    sender = Talker([(k * MS, Frame(0x80, bytes([k]))) for k in range(10)])
    listener, third = Talker(), Talker()
    simulation, ports = bus(
        listener, sender, third, faults=[{"fault": "bus_off", "node": "drive", "from_s": 0.0025, "to_s": 0.005}]
    )
    ports[1].on_bus_off = lambda: told.append(True)
    simulation.advance_until(2_600_000)
    assert ports[1].state is PortState.BUS_OFF
    assert told == [True]
    simulation.advance_until(20 * MS)
    assert [frame.data[0] for _, frame in listener.heard] == [0, 1, 2, 7, 8, 9]  # 5 ms + 1.408 ms: 6 is lost, too
    assert ports[1].rejected_down == 4


def test_a_node_sent_off_the_bus_does_not_finish_its_frame() -> None:
    sender, listener = Talker([(0, Frame(0x80, bytes(8)))]), Talker([(0, Frame(0x90, b""))])
    simulation, ports = bus(
        listener, sender, Talker(), faults=[{"fault": "bus_off", "node": "drive", "from_s": 5e-5, "to_s": 1e-3}]
    )
    simulation.advance_until(10 * MS)
    assert listener.heard == []
    assert (ports[1].sent, ports[1].discarded, ports[1].queued) == (0, 1, 0)
    assert (ports[0].sent, ports[0].queued) == (1, 0)  # once there was somebody again to acknowledge


def test_recovery_takes_as_long_whatever_else_happens_meanwhile() -> None:
    off = {"fault": "bus_off", "node": "host", "from_s": 0.001, "to_s": 0.002}
    # Windows that open and close for nobody: each makes the bus look at those who are off.
    edges = [{"fault": "bus_off", "node": "host", "from_s": 0.0021 + k * 1e-4, "to_s": 0.0022 + k * 1e-4} for k in (0,)]
    plain, _ = bus(Talker(), Talker(), faults=[off])
    again, _ = bus(Talker(), Talker(), faults=[off, *edges])

    def back_ns(simulation: Simulation) -> int:
        simulation.advance_until(2_300_000)
        assert simulation.medium.ports[0].state == PortState.BUS_OFF
        while simulation.step(10 * MS):
            pass
        return simulation.now_ns

    assert back_ns(plain) == 2_000_000 + 128 * 11_000
    assert back_ns(again) == 2_200_000 + 128 * 11_000


def test_delayed_frames_passing_do_not_shorten_a_recovery() -> None:
    faults = [
        {"fault": "delay", "delay_s": 0.0021, "id": 0x80},
        {"fault": "bus_off", "node": "host", "from_s": 0.001, "to_s": 0.002},
    ]
    frames = [(k * 100_000, Frame(0x80, b"")) for k in range(8)]
    simulation, ports = bus(Talker(), Talker(frames), Talker(), faults=faults)
    simulation.advance_until(2_000_000 + 128 * 11_000 - 1)
    before = ports[0].state
    simulation.advance_until(2_000_000 + 128 * 11_000)
    assert (before, ports[0].state) == (PortState.BUS_OFF, PortState.ERROR_ACTIVE)


def test_bus_gone_loses_what_was_delayed() -> None:
    faults = [{"fault": "delay", "delay_s": 0.005}, {"fault": "bus_gone", "from_s": 0.002, "to_s": 0.003}]
    listener = Talker()
    simulation, _ = bus(Talker([(0, Frame(0x80, b""))]), listener, faults=faults)
    simulation.advance_until(20 * MS)
    assert listener.heard == []


def test_bus_gone_loses_everything_in_between() -> None:
    sender = Talker([(k * MS, Frame(0x80, bytes([k]))) for k in range(10)])
    listener = Talker()
    simulation, ports = bus(sender, listener, faults=[{"fault": "bus_gone", "from_s": 0.003, "to_s": 0.006}])
    simulation.advance_until(4 * MS)
    assert simulation.medium.gone
    simulation.advance_until(20 * MS)
    assert [frame.data[0] for _, frame in listener.heard] == [0, 1, 2, 6, 7, 8, 9]
    assert ports[0].rejected_down == 3


def test_leaving_takes_queued_frames_along() -> None:
    sender, listener = Talker([(0, Frame(0x80, b"")), (0, Frame(0x90, b""))]), Talker()
    simulation, ports = bus(sender, listener)
    simulation.advance_until(10_000)  # the first is on the wire
    simulation.remove(ports[0])
    simulation.advance_until(MS)
    assert listener.ids() == [0x80]
    with pytest.raises(ValueError, match="not on this bus"):
        simulation.remove(ports[0])


def test_leaving_while_a_frame_fails_leaves_nothing_to_repeat() -> None:
    sender, listener = Talker([(0, Frame(0x80, b""))]), Talker()
    simulation, ports = bus(sender, listener, Talker(), faults=[{"fault": "corrupt_wire", "count": 1}])
    simulation.advance_until(10_000)
    simulation.remove(ports[0])
    simulation.advance_until(10 * MS)
    assert listener.heard == []
    assert (ports[0].sent, ports[0].tec) == (0, 0)


def test_what_is_no_frame_is_refused_where_it_is_submitted() -> None:
    simulation, ports = bus(Talker(), Talker())
    with pytest.raises(ValueError, match="11 bits"):
        simulation.medium.submit(ports[0], Frame(0x900, b""), 0)
    assert ports[0].queued == 0


def test_a_base_frame_goes_before_an_extended_one_whose_id_begins_with_its_own() -> None:
    extended = [Frame(0x100 << 18 | low, b"", is_extended=True) for low in (0, 5)]
    lower = Frame(0x0FF << 18 | 0x3FFFF, b"", is_extended=True)
    high = Talker([(0, each) for each in (extended[1], Frame(0x101, b""), extended[0])])
    low, listener = Talker([(0, Frame(0x100, b"")), (0, lower)]), Talker()
    simulation, ports = bus(high, low, listener)
    simulation.advance_until(2 * MS)
    assert [frame for _, frame in listener.heard] == [lower, Frame(0x100, b""), *extended, Frame(0x101, b"")]
    assert [port.error_frames for port in ports] == [0, 0, 0]


def test_one_number_as_a_base_and_as_an_extended_id_does_not_clash() -> None:
    a, b = Talker([(0, Frame(0x80, b"\x01"))]), Talker([(0, Frame(0x80, b"\x02", is_extended=True))])
    listener = Talker()
    simulation, ports = bus(a, b, listener)
    simulation.advance_until(MS)
    assert [frame.data for _, frame in listener.heard] == [b"\x02", b"\x01"]  # 0x80 begins with eleven zeros
    assert [port.error_frames for port in ports] == [0, 0, 0]
