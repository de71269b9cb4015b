"""Order of events in virtual time."""

import random

import pytest

from firmware_protocol.frames import Frame
from virtual_bus.bus.faults import FOREVER_NS, Side
from virtual_bus.bus.host_node import HostNode
from virtual_bus.bus.medium import Medium
from virtual_bus.bus.simulation import Simulation
from virtual_bus.bus.wire import NOBODY_NS


class Ticker:
    def __init__(self, period_ns: int, log: list[tuple[str, int]], name: str) -> None:
        self.period_ns, self.log, self.name = period_ns, log, name
        self.next_ns = period_ns
        self.outbox: list[Frame] = []

    def receive(self, frame: Frame, now_ns: int) -> None:
        self.log.append((f"{self.name} hears {frame.arbitration_id:x}", now_ns))

    def next_wake_ns(self) -> int:
        return self.next_ns

    def wake(self, now_ns: int) -> None:
        self.log.append((self.name, now_ns))
        self.next_ns += self.period_ns

    def take_outbox(self) -> list[Frame]:
        frames, self.outbox = self.outbox, []
        return frames


class Talker(Ticker):
    """Sends what it draws whenever it wakes, and answers every third frame."""

    def __init__(self, seed: int, log: list[tuple[str, int]], name: str) -> None:
        super().__init__(1, log, name)
        self.random = random.Random(f"{seed} {name}")

    def frame(self) -> Frame:
        # Few ids, so that two of one id wait at a time; the same data sometimes, so that they may be one frame.
        return Frame(self.random.randrange(8), bytes([self.random.randrange(2)] * self.random.randrange(9)))

    def receive(self, frame: Frame, now_ns: int) -> None:
        super().receive(frame, now_ns)
        if self.random.randrange(3) == 0:
            self.outbox.append(self.frame())

    def wake(self, now_ns: int) -> None:
        super().wake(now_ns)
        self.next_ns = now_ns + self.random.randrange(1, 800_000)
        self.outbox += [self.frame() for _ in range(self.random.randrange(4))]


class SlowMedium(Medium):
    """Takes every frame by its two events."""

    def carry(self, until_ns: int) -> int:
        del until_ns
        return NOBODY_NS


def test_what_a_bus_carries_in_one_go_is_what_it_would_event_by_event() -> None:
    said: list[tuple[list[tuple[str, int]], object, object]] = []
    for kind in (Medium, SlowMedium):
        for seed in range(20):
            log: list[tuple[str, int]] = []
            simulation = Simulation(kind())
            host = HostNode()
            port = simulation.add(host, "host", Side.HOST, answers=False)
            for name in ("a", "b")[: 1 + seed % 2]:
                simulation.add(Talker(seed, log, name), name, Side.DRIVE)
            for tick in range(1, 40):
                simulation.advance_until(tick * 500_000)
                simulation.medium.submit(port, Frame(tick % 8, bytes(tick % 9)), simulation.now_ns)
            said.append((log, host.take_all(simulation.now_ns), [each.counters() for each in simulation.medium.ports]))
    assert said[:20] == said[20:]
    assert len(said[0][0]) > 50


def test_nodes_wake_in_time_and_in_order_of_attachment() -> None:
    log: list[tuple[str, int]] = []
    simulation = Simulation(Medium())
    simulation.add(Ticker(200, log, "a"), "a", Side.DRIVE)
    simulation.add(Ticker(300, log, "b"), "b", Side.DRIVE)
    simulation.advance_until(600)
    assert log == [("a", 200), ("b", 300), ("a", 400), ("a", 600), ("b", 600)]
    assert simulation.now_ns == 600


def test_time_never_goes_back() -> None:
    simulation = Simulation(Medium())
    simulation.advance_until(500)
    simulation.advance_until(100)
    assert simulation.now_ns == 500


def test_there_is_no_running_for_ever() -> None:
    with pytest.raises(ValueError, match="limit"):
        Simulation(Medium()).advance_until(FOREVER_NS)


def test_arbitration_waits_for_all_that_comes_at_the_same_instant() -> None:
    log: list[tuple[str, int]] = []
    simulation = Simulation(Medium())
    drive = Ticker(1000, log, "drive")
    host = HostNode()
    port = simulation.add(host, "host", Side.HOST)
    simulation.add(drive, "drive", Side.DRIVE)
    drive.outbox = [Frame(0x20, b"")]  # goes out when the drive wakes at 1000
    simulation.advance_until(1000)
    assert simulation.medium.submit(port, Frame(0x10, b""), 1000)  # later in the program, the same instant on the bus
    drive.next_ns = FOREVER_NS
    simulation.settle(simulation.medium.ports[1])
    simulation.advance_until(1_000_000)
    heard, heard_ns = log[1]
    ((received_ns, frame),) = host.take_all(1_000_000)
    assert (heard, frame.arbitration_id) == ("drive hears 10", 0x20)
    assert heard_ns < received_ns


def test_a_node_that_does_not_move_its_time_is_an_error() -> None:
    class Stuck(Ticker):
        def wake(self, now_ns: int) -> None:
            pass

    simulation = Simulation(Medium())
    simulation.add(Stuck(100, [], "stuck"), "stuck", Side.DRIVE)
    with pytest.raises(ValueError, match="stuck has been woken"):
        simulation.advance_until(1000)


def test_a_node_that_wants_to_wake_in_the_past_wakes_now() -> None:
    class Eager(Ticker):
        def receive(self, frame: Frame, now_ns: int) -> None:
            super().receive(frame, now_ns)
            self.next_ns = 0

        def wake(self, now_ns: int) -> None:
            self.log.append((self.name, now_ns))
            self.next_ns = FOREVER_NS

    log: list[tuple[str, int]] = []
    simulation = Simulation(Medium())
    eager = Eager(FOREVER_NS, log, "eager")
    simulation.add(eager, "eager", Side.DRIVE)
    port = simulation.add(HostNode(), "host", Side.HOST)
    simulation.medium.submit(port, Frame(0x10, b""), 0)
    simulation.advance_until(1_000_000)
    (_, heard_ns), (_, woken_ns) = log
    assert heard_ns == woken_ns > 0


def test_latency_and_jitter_delay_each_way_and_keep_order() -> None:
    log: list[tuple[str, int]] = []
    simulation = Simulation(Medium())
    host = HostNode(latency_ns=300_000, jitter_ns=400_000, seed="x")
    drive = Ticker(FOREVER_NS, log, "drive")
    simulation.add(drive, "drive", Side.DRIVE)
    port = simulation.add(host, "host", Side.HOST)
    for k in range(50):
        host.send(Frame(0x100, bytes([k])), simulation.now_ns)
        simulation.settle(port)
        simulation.advance_until(simulation.now_ns + 200_000)
    simulation.advance_until(simulation.now_ns + 1_000_000)
    delays = [time_ns - 200_000 * k for k, (_, time_ns) in enumerate(log)]
    assert len(delays) == 50
    assert all(300_000 <= delay <= 700_000 + 200_000 for delay in delays)
    assert len(set(delays)) > 25
    drive.outbox = [Frame(0x80, bytes([k])) for k in range(16)]
    start_ns = simulation.now_ns
    simulation.settle(simulation.medium.ports[0])
    simulation.advance_until(start_ns + 10_000_000)
    received = host.take_all(simulation.now_ns)
    assert [frame.data[0] for _, frame in received] == list(range(16))
    times = [time_ns for time_ns, _ in received]
    assert times == sorted(times)
    assert times[0] >= start_ns + 300_000


def test_received_frames_are_there_only_when_they_have_arrived() -> None:
    host = HostNode(latency_ns=1000)
    host.receive(Frame(1, b""), 0)
    host.receive(Frame(2, b""), 500)
    assert host.take(999) is None
    assert host.take_all(1000) == [(1000, Frame(1, b""))]
    assert host.take(1500) == (1500, Frame(2, b""))


def test_receive_queue_is_bounded_and_drops_the_oldest() -> None:
    host = HostNode(receive_frames=3)
    for k in range(5):
        host.receive(Frame(k, b""), k)
    assert [frame.arbitration_id for _, frame in host.take_all(10)] == [2, 3, 4]
    assert host.overrun == 2


@pytest.mark.parametrize("wrong", [{"latency_ns": -1}, {"jitter_ns": -1}, {"receive_frames": 0}])
def test_host_node_refuses_nonsense(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=r"negative|at least one"):
        HostNode(**wrong)  # type: ignore[arg-type]
