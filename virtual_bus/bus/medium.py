"""The bus itself, in virtual time: arbitration, bit times, error frames, error counters (ISO 11898-1:2015).

What is modelled: the lowest id among all that wait wins an idle bus, a base frame before an extended one whose id
begins with its own; a frame reaches everybody else at the end of its EOF; a frame that fails (CRC error by fault,
nobody there to acknowledge, two senders of one id that differ) costs its time and an error frame, moves the error
counters and is sent again; bus-off empties the node's queue and ends after 128 sequences of 11 recessive bits. What is
not: the 8 bits by which an error-passive sender suspends its next frame, and how the length of an error flag depends on
who is passive (the longest is always taken).
"""

from collections.abc import Callable
from heapq import heapify, heappop, heappush
from typing import Final

from firmware_protocol.frames import Frame
from virtual_bus.bus.bit_timing import (
    ACK_DELIMITER_BITS,
    EOF_BITS,
    ERROR_FRAME_BITS,
    INTERMISSION_BITS,
    RECOVERY_SEQUENCES,
    BitTiming,
    arbitration_key,
    clash,
    classic_times_ns,
    frame_time_ns,
)
from virtual_bus.bus.faults import FOREVER_NS, FaultInjector, FaultKind, Side, StateChange
from virtual_bus.bus.port import DEFAULT_QUEUE_FRAMES, NEVER_SEQUENCES, OffBus, Port, PortState
from virtual_bus.bus.stuffing import classic_stuff_bits
from virtual_bus.bus.wire import NOBODY_NS

# What waits: what arbitrates first (`arbitration_key`), then order of arrival; port, frame and its time on the wire. A
# heap of these is the arbitration.
_Entry = tuple[int, int, Port, Frame, int]

# Looked up once, for every frame.
_BUS_OFF: Final = PortState.BUS_OFF
_integer: Final = int.from_bytes


class Medium:
    """One bus with its ports; a pure machine in virtual ns that somebody else steps (`simulation.Simulation`).

    `next_event_ns` says when something happens and begins transmissions, `run` lets it happen.
    """

    def __init__(self, timing: BitTiming | None = None, faults: FaultInjector | None = None) -> None:
        self.timing = BitTiming() if timing is None else timing
        self.ports: list[Port] = []
        self.gone = False
        self._flight_end_ns = FOREVER_NS
        self._special_ns = FOREVER_NS  # next of what happens rarely: state changes, held frames, recovery
        self._bitrate, self._data_bitrate = self.timing
        self._classic_ns = classic_times_ns(self._bitrate)
        self._intermission_ns = self.timing.bits_ns(INTERMISSION_BITS)
        self._faults = faults
        self._changes: list[StateChange] = [] if faults is None else list(reversed(faults.state_changes))
        self._pending: list[_Entry] = []
        self._order = 0
        self._ready_ns = 0  # when the first of those that wait came
        self._idle_ns = 0  # when the bus is, or was, free again
        self._flight: _Entry | None = None
        self._twins: list[_Entry] = []  # the same bits sent by others at the same time
        self._failing: list[Port] | None = None  # an error frame ends this flight, to the charge of these
        self._held: list[tuple[int, int, Port, Frame]] = []  # delayed by a fault: due, order, sender, frame
        self._off = OffBus(self.timing)
        self._plan_special()

    def frame_ns(self, frame: Frame) -> int:
        """See `Wire`."""
        return frame_time_ns(frame, self._bitrate, self._data_bitrate)

    def attach(
        self,
        name: str,
        side: Side,
        deliver: Callable[[Frame, int], None],
        queue_frames: int = DEFAULT_QUEUE_FRAMES,
        answers: bool = True,
    ) -> Port:
        """Join a node (`answers`: see `Port`); ValueError when its transmit queue could hold nothing."""
        if queue_frames < 1:
            raise ValueError(f"a transmit queue holds at least one frame, not {queue_frames}")
        port = Port(name, side, deliver, queue_frames, answers)
        self.ports.append(port)
        self._introduce()
        return port

    def detach(self, port: Port) -> None:
        """Take a node off the bus with all that it still wanted to send; what is on the wire arrives."""
        self._discard(port)
        self.ports.remove(port)
        self._introduce()
        self._off.remove(port)
        self._plan_special()

    def submit(self, port: Port, frame: Frame, now_ns: int) -> bool:
        """Queue a frame; False, counted at the port, when the queue is full or the node has no bus.

        ValueError when there is no such CAN frame.
        """
        if self.gone or port.queued >= port.queue_frames or port.state is _BUS_OFF:
            self.refuses(port)
            return False
        identifier, data, is_fd, is_extended = frame
        bytes_sent = len(data)
        if is_fd or is_extended or identifier >> 11 or bytes_sent > 8:
            key = arbitration_key(identifier, is_extended)
            duration_ns = frame_time_ns(frame, self._bitrate, self._data_bitrate)
        else:  # the same without the detour, for most frames
            key = identifier << 19
            stuffed = classic_stuff_bits(identifier, bytes_sent, _integer(data, "big", signed=True))
            duration_ns = self._classic_ns[8 * bytes_sent + stuffed]
        pending, order = self._pending, self._order
        if not pending:
            self._ready_ns = now_ns
        heappush(pending, (key, order, port, frame, duration_ns))
        self._order = order + 1
        port.queued += 1
        return True

    def refuses(self, port: Port, on_the_way: int = 0) -> bool:
        """Tell whether this node could queue nothing now, beside `on_the_way` frames, and count the attempt if so."""
        if self.gone or port.state is _BUS_OFF:
            port.rejected_down += 1
            return True
        if port.queued + on_the_way >= port.queue_frames:
            port.rejected_full += 1
            return True
        return False

    def flush(self, port: Port) -> None:
        """Forget what this node has queued and not begun to send."""
        self._discard(port)

    def next_event_ns(self, before_ns: int) -> int:
        """Begin the next transmission if it can begin before `before_ns`; return when `run` is due."""
        if self._flight is None and self._pending:
            start_ns = self._idle_ns if self._idle_ns > self._ready_ns else self._ready_ns
            if start_ns < before_ns and start_ns < self._special_ns:
                self._start(start_ns)
        return self._flight_end_ns if self._flight_end_ns < self._special_ns else self._special_ns

    def run(self, now_ns: int) -> bool:
        """Do what is due by now; False when no node that may answer has been told anything."""
        is_told = now_ns >= self._flight_end_ns and self._finish(now_ns)
        if now_ns >= self._special_ns:
            self._special(now_ns)
            return True
        return is_told

    def carry(self, until_ns: int) -> int:
        """See `Wire`: what `next_event_ns` and `run` do frame by frame, for a bus that nothing disturbs."""
        if self._flight is not None or self._special_ns < FOREVER_NS or self._faults is not None or self._off.ports:
            return NOBODY_NS
        pending = self._pending
        free_ns = self._idle_ns if self._idle_ns > self._ready_ns else self._ready_ns
        while pending:
            entry = heappop(pending)
            key, _, sender, frame, duration_ns = entry
            end_ns, listeners = free_ns + duration_ns, sender.listeners
            # It is still on the wire when a node wakes; arbitration doesn't decide between two of one id; or nobody
            # acknowledges it.
            if end_ns >= until_ns or (pending and pending[0][0] == key) or not listeners:
                heappush(pending, entry)
                return NOBODY_NS
            self._idle_ns = free_ns = end_ns + self._intermission_ns
            sender.queued -= 1
            sender.sent += 1
            if sender.tec:
                sender.recovered()
            is_told = False
            for port in listeners:
                port.received += 1
                if port.rec:
                    port.heard()
                port.deliver(frame, end_ns)
                if port.answers:
                    is_told = True
            if is_told:
                return end_ns
        return FOREVER_NS

    def _introduce(self) -> None:
        """Tell every node who hears what it sends."""
        for port in self.ports:
            port.listeners = tuple(other for other in self.ports if other is not port)

    def _start(self, now_ns: int) -> None:
        """Arbitrate among all that wait and begin the winner's transmission."""
        if self._off.ports:
            self._off.count_rest(self._idle_ns, now_ns)
        entry = heappop(self._pending)
        if self._pending and self._pending[0][0] == entry[0]:
            entry = self._meet(entry, now_ns)
        self._flight = entry
        if self._failing is not None:
            return
        _, _, port, frame, duration_ns = entry
        end_ns = now_ns + duration_ns
        others = len(self.ports) - 1
        if self._off.ports or self._twins:
            others -= len(self._off.ports) + len(self._twins)
        if others < 1:
            # An error-passive sender that only misses its acknowledge doesn't count on: it would end bus-off alone.
            charged = [port] if port.state == PortState.ERROR_ACTIVE else []
            self._fail(charged, end_ns - self.timing.bits_ns(EOF_BITS + ACK_DELIMITER_BITS))
        elif self._faults is not None and self._faults.corrupts_wire(frame, port.side, now_ns):
            self._fail([port], end_ns - self.timing.bits_ns(EOF_BITS))
        else:
            self._flight_end_ns = end_ns

    def _finish(self, now_ns: int) -> bool:
        """End the transmission: everybody else has the frame, or it waits again. Return as `run`."""
        entry, twins, failing = self._flight, self._twins, self._failing
        assert entry is not None
        _, _, sender, frame, _ = entry
        self._flight = None
        self._flight_end_ns = FOREVER_NS
        self._idle_ns = now_ns + self._intermission_ns
        if failing is not None:
            self._failing, self._twins = None, []
            self._send_again([entry, *twins], failing, now_ns)
        else:
            sender.transmitted()
            if twins:
                self._twins = []
                for _, _, port, _, _ in twins:
                    port.transmitted()
            if self._faults is None and not self._off.ports:
                return self._deliver(sender, frame, now_ns)
            self._route(sender, frame, now_ns)
        if self._off.ports:
            self._off.count_frame()
            self._plan_special()
        return True

    def _special(self, now_ns: int) -> None:
        """Do what is due at `special_ns`: edges of fault windows, delayed frames, recoveries from bus-off."""
        while self._changes and self._changes[-1].time_ns <= now_ns:
            self._change(self._changes.pop(), now_ns)
        while self._held and self._held[0][0] <= now_ns:
            _, _, sender, frame = heappop(self._held)
            self._deliver(sender, frame, now_ns)
        if self._off.ports and self._flight is None:
            self._off.count_rest(self._idle_ns, now_ns)
        self._plan_special()

    def _deliver(self, sender: Port, frame: Frame, now_ns: int) -> bool:
        is_told = False
        for port in self.ports:
            if port is not sender and port.state is not _BUS_OFF:
                port.received += 1
                if port.rec:
                    port.heard()
                port.deliver(frame, now_ns)
                is_told = is_told or port.answers
        return is_told

    def _route(self, sender: Port, frame: Frame, now_ns: int) -> None:
        """Deliver as the faults have it."""
        if self._faults is None:
            self._deliver(sender, frame, now_ns)
            return
        for due_ns, each in self._faults.route(frame, sender.side, now_ns):
            if due_ns <= now_ns:
                self._deliver(sender, each, now_ns)
            else:
                self._order += 1
                heappush(self._held, (due_ns, self._order, sender, each))
                self._plan_special()

    def _meet(self, entry: _Entry, now_ns: int) -> _Entry:
        """Let senders of one id and format meet after arbitration; return who goes on, or make the flight fail.

        Same bits: one frame of several senders. Else whoever sends the first recessive bit sees an error: an error
        active one destroys the frame for all, an error passive one drops out and the other never notices.
        """
        rivals: dict[Port, _Entry] = {}
        for rival in sorted(other for other in self._pending if other[0] == entry[0]):
            if rival[2] is not entry[2]:
                rivals.setdefault(rival[2], rival)
        for rival in rivals.values():
            self._pending.remove(rival)
            met = clash(entry[3], rival[3], self.timing)
            if met is None:
                self._twins.append(rival)
                continue
            losers = [rival] if met.first_is_dominant else [entry, *self._twins]
            if any(port.state == PortState.ERROR_ACTIVE for _, _, port, _, _ in losers):
                self._twins.append(rival)
                self._fail([port for _, _, port, _, _ in (entry, *self._twins)], now_ns + met.after_ns)
                break
            if not met.first_is_dominant:
                entry, self._twins = rival, []
            self._pending.extend(losers)
            for _, _, port, _, _ in losers:
                if port.transmit_failed():
                    self._go_off(port, RECOVERY_SEQUENCES, now_ns)
        heapify(self._pending)
        return entry

    def _fail(self, charged: list[Port], at_ns: int) -> None:
        self._failing = charged
        self._flight_end_ns = at_ns + self.timing.bits_ns(ERROR_FRAME_BITS)

    def _send_again(self, entries: list[_Entry], charged: list[Port], now_ns: int) -> None:
        senders = [entry[2] for entry in entries]
        for entry in entries:
            if entry[2] in self.ports:
                heappush(self._pending, entry)
        for port in self.ports:
            if port in charged:
                if port.transmit_failed():
                    self._go_off(port, RECOVERY_SEQUENCES, now_ns)
            elif port not in senders and port.state is not _BUS_OFF:
                port.receive_failed()

    def _change(self, change: StateChange, now_ns: int) -> None:
        if change.kind is FaultKind.BUS_GONE:
            self.gone = change.begins
            if change.begins:
                for port in self.ports:
                    self._discard(port)
                self._held.clear()
                self._abort(now_ns)
            return
        for port in self.ports:
            if port.side is not change.node:
                continue
            if change.begins:
                if self._flight is not None and self._flight[2] is port:
                    self._abort(now_ns)
                self._go_off(port, NEVER_SEQUENCES, now_ns)
            elif port in self._off.ports:
                port.left_sequences, port.off_since_ns = RECOVERY_SEQUENCES, now_ns

    def _abort(self, now_ns: int) -> None:
        """Break off what is on the wire: nobody gets it, nobody repeats it."""
        for _, _, port, _, _ in (*([self._flight] if self._flight else ()), *self._twins):
            port.queued -= 1
            port.discarded += 1
        self._flight, self._failing, self._twins = None, None, []
        self._flight_end_ns = FOREVER_NS
        self._idle_ns = now_ns + self.timing.bits_ns(ERROR_FRAME_BITS) + self._intermission_ns

    def _go_off(self, port: Port, sequences: int, now_ns: int) -> None:
        self._discard(port)
        self._off.add(port, sequences, now_ns)
        self._plan_special()

    def _discard(self, port: Port) -> None:
        kept = [entry for entry in self._pending if entry[2] is not port]
        dropped = len(self._pending) - len(kept)
        port.queued -= dropped
        port.discarded += dropped
        self._pending = kept
        heapify(self._pending)

    def _plan_special(self) -> None:
        due = [self._off.next_return_ns(self._idle_ns)] if self._flight is None else []
        if self._changes:
            due.append(self._changes[-1].time_ns)
        if self._held:
            due.append(self._held[0][0])
        self._special_ns = min(due, default=FOREVER_NS)
