"""A serial line on which all talk, in virtual time: eight data bits, no parity, one stop bit, one pair of wires.

Nobody arbitrates. Whoever has something sends it at once, his own packets one after the other; where two talk at the
same time, neither is understood. A packet has arrived with its last stop bit.
"""

from collections.abc import Callable
from heapq import heapify, heappop, heappush
from typing import Final

from firmware_protocol.frames import Frame
from virtual_bus.bus.faults import FOREVER_NS, FaultInjector, FaultKind, Side, StateChange
from virtual_bus.bus.port import DEFAULT_QUEUE_FRAMES, Port
from virtual_bus.bus.wire import NOBODY_NS, LineCodec

BITS_PER_BYTE: Final = 10
_NS_PER_S: Final = 1_000_000_000


class _Flight:
    """A packet on the line, or behind others of its sender."""

    __slots__ = ("begin_ns", "end_ns", "frame", "is_damaged", "order", "port")

    def __init__(self, order: int, port: Port, frame: Frame, begin_ns: int, end_ns: int) -> None:
        self.order = order
        self.port = port
        self.frame = frame
        self.begin_ns = begin_ns
        self.end_ns = end_ns
        self.is_damaged = False

    def __lt__(self, other: "_Flight") -> bool:
        return (self.end_ns, self.order) < (other.end_ns, other.order)


class HalfDuplexLine:
    """One line; a `Wire`. `collisions` counts packets that were lost because two talked."""

    def __init__(self, codec: LineCodec, baudrate_bit_per_s: int, faults: FaultInjector | None = None) -> None:
        self.ports: list[Port] = []
        self.gone = False
        self.collisions = 0
        self._encode = codec.encode
        self._baudrate_bit_per_s = baudrate_bit_per_s
        self._faults = faults
        self._changes: list[StateChange] = [] if faults is None else list(reversed(faults.state_changes))
        self._cut: set[Side | None] = set()  # whose plug is out
        self._flights: list[_Flight] = []
        self._held: list[tuple[int, int, Port, Frame]] = []  # delayed by a fault
        self._order = 0

    def frame_ns(self, frame: Frame) -> int:
        """See `Wire`."""
        return len(self._encode(frame)) * BITS_PER_BYTE * _NS_PER_S // self._baudrate_bit_per_s

    def attach(
        self,
        name: str,
        side: Side,
        deliver: Callable[[Frame, int], None],
        queue_frames: int = DEFAULT_QUEUE_FRAMES,
        answers: bool = True,
    ) -> Port:
        """See `Wire`."""
        port = Port(name, side, deliver, queue_frames, answers)
        self.ports.append(port)
        return port

    def detach(self, port: Port) -> None:
        """See `Wire`; what is on the line arrives."""
        self.flush(port)
        self.ports.remove(port)

    def submit(self, port: Port, frame: Frame, now_ns: int) -> bool:
        """See `Wire`."""
        if self.refuses(port):
            return False
        begin_ns = max([now_ns, *(flight.end_ns for flight in self._flights if flight.port is port)])
        flight = _Flight(self._order, port, frame, begin_ns, begin_ns + self.frame_ns(frame))
        self._order += 1
        for other in self._flights:
            if other.port is not port and flight.begin_ns < other.end_ns and other.begin_ns < flight.end_ns:
                self.collisions += (not flight.is_damaged) + (not other.is_damaged)
                flight.is_damaged = other.is_damaged = True
        port.queued += 1
        heappush(self._flights, flight)
        return True

    def refuses(self, port: Port, on_the_way: int = 0) -> bool:
        """See `Wire`."""
        if self.gone or port.side in self._cut:
            port.rejected_down += 1
            return True
        if port.queued + on_the_way >= port.queue_frames:
            port.rejected_full += 1
            return True
        return False

    def flush(self, port: Port) -> None:
        """See `Wire`: all but what this node is sending, its first."""
        own = sorted(flight for flight in self._flights if flight.port is port)[1:]
        port.queued -= len(own)
        port.discarded += len(own)
        self._flights = [flight for flight in self._flights if flight not in own]
        heapify(self._flights)

    def next_event_ns(self, before_ns: int) -> int:
        """See `Wire`."""
        del before_ns  # a packet begins when it is submitted
        due = [self._flights[0].end_ns] if self._flights else []
        if self._held:
            due.append(self._held[0][0])
        if self._changes:
            due.append(self._changes[-1].time_ns)
        return min(due, default=FOREVER_NS)

    def carry(self, until_ns: int) -> int:
        """See `Wire`."""
        del until_ns
        return NOBODY_NS

    def run(self, now_ns: int) -> bool:
        """See `Wire`."""
        while self._changes and self._changes[-1].time_ns <= now_ns:
            self._change(self._changes.pop())
        while self._flights and self._flights[0].end_ns <= now_ns:
            self._finish(heappop(self._flights), now_ns)
        while self._held and self._held[0][0] <= now_ns:
            _, _, sender, frame = heappop(self._held)
            self._deliver(sender, frame, now_ns)
        return True

    def _finish(self, flight: _Flight, now_ns: int) -> None:
        port, frame = flight.port, flight.frame
        port.queued -= 1
        port.sent += 1
        if flight.is_damaged:
            return
        if self._faults is None:
            self._deliver(port, frame, now_ns)
        elif not self._faults.corrupts_wire(frame, port.side, now_ns):
            for due_ns, each in self._faults.route(frame, port.side, now_ns):
                if due_ns <= now_ns:
                    self._deliver(port, each, now_ns)
                else:
                    self._order += 1
                    heappush(self._held, (due_ns, self._order, port, each))

    def _deliver(self, sender: Port, frame: Frame, now_ns: int) -> None:
        for port in self.ports:
            if port is not sender and port.side not in self._cut:
                port.received += 1
                port.deliver(frame, now_ns)

    def _change(self, change: StateChange) -> None:
        if change.kind is FaultKind.BUS_GONE:
            self.gone = change.begins
        elif change.begins:
            self._cut.add(change.node)
        else:
            self._cut.discard(change.node)
        if change.begins:
            lost = [flight for flight in self._flights if self.gone or flight.port.side in self._cut]
            for flight in lost:
                flight.port.queued -= 1
                flight.port.discarded += 1
            self._flights = [flight for flight in self._flights if flight not in lost]
            heapify(self._flights)
