"""The loop of a drive process: a node of the world run by the monotonic clock on an absolute schedule.

The node's time is the clock's since the start: a late wake is late on the wire only, its samples stand where they
should. A stall of more than `max_catch_up_ns` is an accident of this machine and not of the world, so node time leaves
it out; each is counted.
"""

import time
from collections import Counter, deque
from collections.abc import Callable
from heapq import heappop, heappush

from firmware_protocol.frames import NODE_BITS, Frame
from firmware_protocol.messages import Function
from virtual_bus.bus.faults import FaultInjector, FaultKind, Side
from virtual_bus.bus.node import Node
from virtual_bus.realtime.transports import MAX_FRAMES_AT_ONCE, Transport

DEFAULT_CATCH_UP_NS = 10_000_000
DEFAULT_SPIN_NS = 100_000  # a sleep ends 50 to 100 µs late on an ordinary kernel
_MAX_WAIT_NS = 50_000_000  # so that a stop is seen
_FROM_DRIVE = frozenset(
    int(function)
    for function in (
        Function.FEEDBACK,
        Function.TIMING,
        Function.FD_FEEDBACK,
        Function.DRIVE_HEARTBEAT,
        Function.BENCH_SENSOR,
        Function.PARAM_RESPONSE,
        Function.IDENTITY,
    )
)
_FOREIGN = 1 << NODE_BITS + 6  # what is counted for a function where the id has 29 bits: above all of them


class Lateness:
    """How late wakes were, counted in µs; bounded, the last bin takes all beyond."""

    BINS = 20_000
    EDGES_US = (20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000)

    def __init__(self) -> None:
        self._counts = [0] * (self.BINS + 1)
        self._total = 0
        self._max_us = 0

    def add(self, late_ns: int) -> None:
        """Count one wake."""
        late_us = late_ns // 1000
        self._counts[min(late_us, self.BINS)] += 1
        self._total += 1
        self._max_us = max(self._max_us, late_us)

    def quantile_us(self, share: float) -> int:
        """Return the smallest lateness, in whole µs, that `share` of the wakes didn't exceed; 0 without any."""
        wanted, seen = share * self._total, 0
        for late_us, count in enumerate(self._counts):
            seen += count
            if seen >= wanted:
                return late_us
        return self.BINS

    def summary(self) -> dict[str, object]:
        """Return count, p50, p99, max and a coarse histogram as [upper edge in µs or null, count]."""
        edges = (0, *self.EDGES_US)
        histogram: list[list[int | None]] = [
            [high, sum(self._counts[low:high])] for low, high in zip(edges, self.EDGES_US, strict=False)
        ]
        histogram.append([None, sum(self._counts[self.EDGES_US[-1] :])])
        p50, p99 = self.quantile_us(0.5), self.quantile_us(0.99)
        return {"count": self._total, "p50_us": p50, "p99_us": p99, "max_us": self._max_us, "histogram_us": histogram}


class FaultyWire:
    """Faults on the way between a real transport and a node: what `FaultInjector` says, in node time.

    `on_bus_off()` is called when a window of bus_off or bus_gone begins; inside one nothing passes either way.
    """

    def __init__(self, injector: FaultInjector, on_bus_off: Callable[[], None]) -> None:
        self.counters = injector.counters
        self._injector = injector
        self._on_bus_off = on_bus_off
        self._changes = list(reversed(injector.state_changes))
        self._down = 0  # open windows
        self._order = 0
        self._held: dict[Side, list[tuple[int, int, Frame]]] = {side: [] for side in Side}

    def next_ns(self) -> int | None:
        """Return when a held frame or a window is next due."""
        due = [held[0][0] for held in self._held.values() if held]
        if self._changes:
            due.append(self._changes[-1].time_ns)
        return min(due, default=None)

    def turn(self, now_ns: int) -> None:
        """Open and close the windows that are due."""
        while self._changes and self._changes[-1].time_ns <= now_ns:
            change = self._changes.pop()
            self._down += 1 if change.begins else -1
            if change.begins and change.kind in (FaultKind.BUS_OFF, FaultKind.BUS_GONE):
                self._on_bus_off()

    def carry(self, frames: list[Frame], sender: Side, now_ns: int) -> list[Frame]:
        """Return what gets through now of these frames and of those held before, in order of time."""
        self.turn(now_ns)
        held = self._held[sender]
        for frame in [] if self._down else frames:
            for due_ns, each in self._injector.route(frame, sender, now_ns):
                self._order += 1
                heappush(held, (due_ns, self._order, each))
        through = []
        while held and held[0][0] <= now_ns:
            through.append(heappop(held)[2])
        return [] if self._down else through


class RealTimeLoop:
    """Runs one node against a transport until `stop` or `duration_ns`. Everything it counts is in `summary`."""

    def __init__(
        self,
        node: Node,
        transport: Transport,
        period_ns: int,
        wire: FaultyWire | None = None,
        spin_ns: int = DEFAULT_SPIN_NS,
        max_catch_up_ns: int = DEFAULT_CATCH_UP_NS,
        clock: Callable[[], int] = time.monotonic_ns,
        is_native: bool = True,
    ) -> None:
        """`is_native`: it speaks the project's own protocol, so what a drive says is heard here by echo alone.

        Of another's, a frame that was sent just before and comes back as it was counts as an echo.
        """
        if period_ns < 1:
            raise ValueError(f"a period lasts at least 1 ns, not {period_ns}")
        self._node = node
        self._transport = transport
        self._period_ns = period_ns
        self._wire = wire
        self._spin_ns = spin_ns
        self._max_catch_up_ns = max_catch_up_ns
        self._clock = clock
        self._own = _FROM_DRIVE if is_native else frozenset()
        self._may_echo: deque[Frame] = deque(maxlen=0 if is_native else MAX_FRAMES_AT_ONCE)
        self._start_ns = 0
        self._stopping = False
        self._sent: Counter[int] = Counter()
        self._received: Counter[int] = Counter()
        self._echoed = 0
        self._wakes = self._overruns = self._slips = self._slipped_ns = 0
        self._lateness = Lateness()

    def stop(self) -> None:
        """End the run soon; may be called from a signal handler."""
        self._stopping = True

    def run(self, duration_ns: int | None = None) -> None:
        """Run; node time begins at nought."""
        self._start_ns = self._clock()
        end_ns = None if duration_ns is None else duration_ns
        while not self._stopping:
            now_ns = self._clock() - self._start_ns
            if end_ns is not None and now_ns + self._slipped_ns >= end_ns:
                return
            wake_ns = self._node.next_wake_ns()
            if now_ns < wake_ns:
                self._listen(now_ns, wake_ns)
            else:
                self._wake(now_ns, wake_ns)

    def summary(self) -> dict[str, object]:
        """Return all counts as plain data for JSON."""
        return {
            "wakes": self._wakes,
            "overruns": self._overruns,
            "slips": self._slips,
            "slipped_s": self._slipped_ns * 1e-9,
            "lateness": self._lateness.summary(),
            "sent": self._named(self._sent),
            "received": self._named(self._received),
            "own_frames_heard": self._echoed,
            "transport": dict(self._transport.counters),
            "faults": {} if self._wire is None else {str(kind): n for kind, n in self._wire.counters.items() if n},
        }

    def counters(self) -> dict[str, int]:
        """Return what a page shows of it; cheap."""
        return {
            "wakes": self._wakes,
            "overruns": self._overruns,
            "slips": self._slips,
            "sent": self._sent.total(),
            "received": self._received.total(),
        }

    def _named(self, counts: Counter[int]) -> dict[str, int]:
        return _by_name(counts) if self._own else {"packets": counts.total()}

    def _listen(self, now_ns: int, wake_ns: int) -> None:
        """Take what arrives until it is time to wake; the last stretch is spent polling."""
        until_ns = min(wake_ns - self._spin_ns, now_ns + _MAX_WAIT_NS)
        if self._wire is not None and (due_ns := self._wire.next_ns()) is not None:
            until_ns = min(until_ns, due_ns)
        frames = self._transport.receive(max(until_ns - now_ns, 0) * 1e-9)
        if frames or self._wire is not None:
            self._take(frames, min(self._clock() - self._start_ns, wake_ns))

    def _wake(self, now_ns: int, wake_ns: int) -> None:
        late_ns = now_ns - wake_ns
        self._lateness.add(late_ns)
        self._wakes += 1
        self._overruns += late_ns // self._period_ns
        if late_ns > self._max_catch_up_ns:
            self._slips += 1
            self._slipped_ns += late_ns
            self._start_ns += late_ns
            now_ns = wake_ns
        # What has arrived since was there before this late wake; only an ordinary wake can do without asking.
        if late_ns > self._spin_ns:
            self._take(self._transport.receive(0.0), wake_ns)
        self._node.wake(now_ns)
        self._send(now_ns)

    def _take(self, frames: list[Frame], at_ns: int) -> None:
        heard = []
        for frame in frames:
            function = _FOREIGN if frame[3] else frame[0] >> NODE_BITS
            if function in self._own:
                self._echoed += 1  # udp_multicast hears itself
            elif frame in self._may_echo:
                self._may_echo.remove(frame)
                self._echoed += 1
            else:
                self._received[function] += 1
                heard.append(frame)
        if self._wire is not None:
            heard = self._wire.carry(heard, Side.HOST, at_ns)
        for frame in heard:
            self._node.receive(frame, at_ns)
        self._send(at_ns)

    def _send(self, now_ns: int) -> None:
        frames = self._node.take_outbox()
        for frame in frames:
            self._sent[frame[0] >> NODE_BITS] += 1
        if self._wire is not None:
            frames = self._wire.carry(frames, Side.DRIVE, now_ns)
        if frames:
            self._may_echo += frames
            self._transport.send(frames)


def _by_name(counts: Counter[int]) -> dict[str, int]:
    names = {int(function): function.name for function in Function}
    names[_FOREIGN] = "extended id"
    return {names.get(function, f"0x{function:02x}"): counts[function] for function in sorted(counts)}
