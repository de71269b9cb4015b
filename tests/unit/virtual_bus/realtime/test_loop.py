"""The real-time loop with a clock and a transport that do as told."""

from collections import deque
from collections.abc import Iterable

import can
import pytest

from firmware_protocol.frames import Frame
from virtual_bus.bus.faults import FaultInjector, Side, parse_faults
from virtual_bus.realtime.loop import FaultyWire, Lateness, RealTimeLoop
from virtual_bus.realtime.transports import open_can

MS = 1_000_000
FEEDBACK, SETPOINT, ESTOP = 0x081, 0x041, 0x001


class FakeTransport:
    """Time passes only while it waits; `arrivals` are (time, frame), `stalls` (time, how long the machine sleeps)."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.counters = {"send_failed": 0}
        self.arrivals: deque[tuple[int, Frame]] = deque()
        self.stalls: deque[tuple[int, int]] = deque()
        self.sent: list[tuple[int, Frame]] = []

    def clock(self) -> int:
        return self.now_ns

    def receive(self, timeout_s: float) -> list[Frame]:
        until_ns = self.now_ns + round(timeout_s * 1e9)
        if self.arrivals and self.arrivals[0][0] <= until_ns:
            self.now_ns = max(self.now_ns, self.arrivals[0][0])
            return [self.arrivals.popleft()[1]]
        self.now_ns = until_ns + (0 if timeout_s else 1000)
        if self.stalls and self.now_ns >= self.stalls[0][0]:
            self.now_ns += self.stalls.popleft()[1]
        return []

    def send(self, frames: Iterable[Frame]) -> None:
        self.sent += [(self.now_ns, frame) for frame in frames]

    def close(self) -> None:
        pass


class Sampler:
    """Samples every millisecond, however late it is woken."""

    def __init__(self) -> None:
        self.next_ns = 0
        self.samples: list[int] = []
        self.heard: list[tuple[int, Frame]] = []
        self.outbox: list[Frame] = []

    def receive(self, frame: Frame, now_ns: int) -> None:
        self.heard.append((now_ns, frame))

    def next_wake_ns(self) -> int:
        return self.next_ns

    def wake(self, now_ns: int) -> None:
        while self.next_ns <= now_ns:
            self.samples.append(self.next_ns)
            self.outbox.append(Frame(FEEDBACK, bytes([len(self.samples) % 256])))
            self.next_ns += MS

    def take_outbox(self) -> list[Frame]:
        frames, self.outbox = self.outbox, []
        return frames


def run(transport: FakeTransport, duration_ms: int = 100, faults: object = None) -> tuple[Sampler, dict[str, object]]:
    node = Sampler()
    wire = FaultyWire(FaultInjector(parse_faults(faults), 1), lambda: None) if faults else None
    loop = RealTimeLoop(node, transport, MS, wire, clock=transport.clock)
    loop.run(duration_ms * MS)
    return node, loop.summary()


def test_samples_stand_on_an_absolute_grid() -> None:
    node, summary = run(FakeTransport())
    assert node.samples == [k * MS for k in range(100)]
    assert (summary["wakes"], summary["overruns"], summary["slips"]) == (100, 0, 0)
    assert summary["sent"] == {"FEEDBACK": 100}


def test_a_late_wake_catches_up_and_counts_overruns() -> None:
    transport = FakeTransport()
    transport.stalls.append((20 * MS - MS // 2, 5 * MS))
    node, summary = run(transport)
    assert node.samples == [k * MS for k in range(100)]
    assert summary["overruns"] in (4, 5)
    assert summary["slips"] == 0
    assert len(transport.sent) == 100


def test_a_long_stall_is_left_out_of_node_time() -> None:
    transport = FakeTransport()
    transport.stalls.append((20 * MS - MS // 2, 30 * MS))
    node, summary = run(transport)
    assert summary["slips"] == 1
    slipped_s = summary["slipped_s"]
    assert isinstance(slipped_s, float)
    assert 0.029 < slipped_s < 0.031
    assert len(node.samples) in (70, 71)
    assert max(b - a for a, b in zip(node.samples, node.samples[1:], strict=False)) == MS
    assert summary["sent"] == {"FEEDBACK": len(node.samples)}


def test_frames_reach_the_node_at_their_time_and_before_the_sample_that_follows() -> None:
    transport = FakeTransport()
    transport.arrivals.extend([(10_300_000, Frame(SETPOINT, b"a")), (10_700_000, Frame(SETPOINT, b"b"))])
    node, summary = run(transport, 20)
    assert [(time_ns // 100_000, frame.data) for time_ns, frame in node.heard] == [(103, b"a"), (107, b"b")]
    assert summary["received"] == {"SETPOINT": 2}


def test_what_came_during_a_stall_is_taken_before_the_late_sample() -> None:
    transport = FakeTransport()
    transport.stalls.append((10 * MS - MS // 2, 3 * MS))
    transport.arrivals.append((11 * MS, Frame(SETPOINT, b"a")))
    node, _ = run(transport, 20)
    assert [time_ns for time_ns, _ in node.heard] == [10 * MS]


def test_own_frames_are_not_heard() -> None:
    transport = FakeTransport()
    transport.arrivals.extend([(MS, Frame(FEEDBACK, b"")), (2 * MS, Frame(ESTOP, b""))])
    node, summary = run(transport, 5)
    assert [frame.arbitration_id for _, frame in node.heard] == [ESTOP]
    assert summary["own_frames_heard"] == 1
    assert summary["received"] == {"ESTOP": 1}


def test_stop_ends_the_loop() -> None:
    transport = FakeTransport()
    node = Sampler()
    loop = RealTimeLoop(node, transport, MS, clock=transport.clock)
    loop.stop()
    loop.run()
    assert node.samples == []


def test_a_period_is_positive() -> None:
    with pytest.raises(ValueError, match="1 ns"):
        RealTimeLoop(Sampler(), FakeTransport(), 0)


def test_faults_on_both_ways() -> None:
    transport = FakeTransport()
    transport.arrivals.extend((k * MS + 300_000, Frame(SETPOINT, bytes([k]))) for k in range(20))
    node, summary = run(
        transport,
        30,
        [
            {"fault": "drop", "function": "FEEDBACK", "from_s": 0.005, "to_s": 0.0095},
            {"fault": "delay", "function": "SETPOINT", "from_s": 0.010, "count": 1, "delay_s": 0.0035},
        ],
    )
    numbers = [frame.data[0] for _, frame in transport.sent]
    assert numbers == [n for n in range(1, 31) if not 6 <= n <= 10]
    assert [frame.data[0] for _, frame in node.heard] == list(range(20))
    late = {frame.data[0]: time_ns for time_ns, frame in node.heard}
    assert late[9] < 10 * MS
    assert 13_800_000 <= late[10] <= 14_200_000
    assert late[13] >= late[10]
    assert summary["faults"] == {"drop": 5, "delay": 1}


def test_a_window_without_bus_tells_the_node_once_and_loses_everything() -> None:
    told: list[bool] = []
    faults = parse_faults([{"fault": "bus_off", "node": "drive", "from_s": 0.01, "to_s": 0.02}])
    wire = FaultyWire(FaultInjector(faults, 0), lambda: told.append(True))
    frames = [Frame(SETPOINT, b"")]
    assert wire.next_ns() == 10 * MS
    assert wire.carry(frames, Side.HOST, 9 * MS) == frames
    assert wire.carry(frames, Side.HOST, 10 * MS) == []
    assert wire.carry(frames, Side.DRIVE, 19 * MS) == []
    assert wire.carry(frames, Side.DRIVE, 20 * MS) == frames
    assert told == [True]
    assert wire.next_ns() is None


def test_lateness_quantiles_and_histogram() -> None:
    lateness = Lateness()
    for late_us in range(100):
        lateness.add(late_us * 1000 + 7)
    lateness.add(10**12)
    summary = lateness.summary()
    assert (summary["count"], summary["p50_us"], summary["max_us"]) == (101, 50, 10**9)
    histogram = summary["histogram_us"]
    assert isinstance(histogram, list)
    assert histogram[0] == [20, 20]
    assert histogram[-1] == [None, 1]
    assert sum(count for _, count in histogram) == 101
    assert Lateness().quantile_us(0.99) == 0


def test_an_extended_id_is_nobodys_function() -> None:
    """Or the drive's own ids, made 29 bits long by somebody else, would count as echoes."""
    transport = FakeTransport()
    foreign = Frame(FEEDBACK, b"", is_extended=True)
    transport.arrivals.append((5 * MS + 100, foreign))
    node, summary = run(transport)
    assert [frame for _, frame in node.heard] == [foreign]
    assert summary["received"] == {"extended id": 1}


def test_a_can_transport_carries_both_kinds_of_ids() -> None:
    frames = [Frame(0x41, b"\x01"), Frame(0x41, b"\x02", is_extended=True), Frame(0x1FFFFFFF, bytes(12), True, True)]
    with can.Bus("extended", interface="virtual", preserve_timestamps=True) as other:
        transport = open_can("virtual", "extended", True, {})
        transport.send(frames)
        messages = [other.recv(1.0) for _ in frames]
        assert [m.is_extended_id for m in messages if m] == [False, True, True]
        for each in messages:
            assert each is not None
            other.send(each)
        other.send(can.Message(arbitration_id=0x41, is_extended_id=False, is_remote_frame=True))
        assert transport.receive(1.0) == frames
        assert transport.counters["not_ours"] == 1
        transport.close()
