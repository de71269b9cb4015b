"""A node's CAN controller: its share of the transmit queue and its error counters (ISO 11898-1:2015, 12.1.4)."""

from collections.abc import Callable
from enum import IntEnum
from typing import Final

from firmware_protocol.frames import Frame
from virtual_bus.bus.bit_timing import RECOVERY_SEQUENCE_BITS, BitTiming
from virtual_bus.bus.faults import FOREVER_NS, Side

DEFAULT_QUEUE_FRAMES: Final = 16
NEVER_SEQUENCES: Final = 1 << 40  # kept off the bus until somebody lets it recover

_PASSIVE_ABOVE: Final = 127
_BUS_OFF_ABOVE: Final = 255
_COUNTERS: Final = (
    "sent",
    "received",
    "rejected_full",  # the transmit queue was
    "rejected_down",  # bus-off, or no bus
    "discarded",  # queued, never sent: the bus went away
    "error_frames",
    "bus_offs",
    "tec",
    "rec",
)


class PortState(IntEnum):
    """Fault confinement state."""

    ERROR_ACTIVE = 0
    ERROR_PASSIVE = 1
    BUS_OFF = 2


class Port:
    """One controller on the bus; `deliver(frame, now_ns)` takes what the others send.

    `answers`: whether its node may have something to send, or another time to wake, because of what it has been told.
    `on_bus_off()` tells its node, where it wants to know, that it has been thrown off the bus.
    """

    __slots__ = (
        *_COUNTERS,
        "answers",
        "deliver",
        "left_sequences",
        "listeners",
        "name",
        "off_since_ns",
        "on_bus_off",
        "queue_frames",
        "queued",
        "side",
        "state",
    )

    def __init__(
        self, name: str, side: Side, deliver: Callable[[Frame, int], None], queue_frames: int, answers: bool
    ) -> None:
        self.name = name
        self.side = side
        self.deliver = deliver
        self.queue_frames = queue_frames
        self.answers = answers
        self.listeners: tuple[Port, ...] = ()  # who hears what it sends
        self.on_bus_off: Callable[[], None] | None = None
        self.queued = 0
        self.state = PortState.ERROR_ACTIVE
        self.tec = self.rec = 0  # transmit and receive error counter
        self.left_sequences = 0  # of 11 recessive bits, still to be seen before it leaves bus-off
        self.off_since_ns = 0
        self.sent = self.received = self.error_frames = self.bus_offs = 0
        self.rejected_full = self.rejected_down = self.discarded = 0

    def counters(self) -> dict[str, int]:
        """Return everything counted so far, by name."""
        return {name: getattr(self, name) for name in _COUNTERS}

    def transmit_failed(self) -> bool:
        """Count a failed transmission; True when that is one too many and the node must leave the bus."""
        self.error_frames += 1
        self.tec += 8
        self._set_state()
        return self.tec > _BUS_OFF_ABOVE

    def receive_failed(self) -> None:
        """Count an error frame that ended somebody else's transmission."""
        self.error_frames += 1
        self.rec = min(self.rec + 1, _BUS_OFF_ABOVE)
        self._set_state()

    def transmitted(self) -> None:
        """Count a frame that went out."""
        self.queued -= 1
        self.sent += 1
        if self.tec:
            self.recovered()

    def recovered(self) -> None:
        """Count a frame that went out where there were errors before."""
        self.tec -= 1
        self._set_state()

    def heard(self) -> None:
        """Count a good frame of somebody else where there were errors before."""
        self.rec = min(self.rec - 1, _PASSIVE_ABOVE)
        self._set_state()

    def leave_bus(self, sequences: int, now_ns: int) -> None:
        """Go bus-off until `sequences` of 11 recessive bits have been seen."""
        self.state = PortState.BUS_OFF
        self.bus_offs += 1
        self.left_sequences = sequences
        self.off_since_ns = now_ns
        if self.on_bus_off is not None:
            self.on_bus_off()

    def rejoin_bus(self) -> None:
        """Come back from bus-off, error active."""
        self.tec = self.rec = self.left_sequences = 0
        self.state = PortState.ERROR_ACTIVE

    def _set_state(self) -> None:
        passive = self.tec > _PASSIVE_ABOVE or self.rec > _PASSIVE_ABOVE
        self.state = PortState.ERROR_PASSIVE if passive else PortState.ERROR_ACTIVE


class OffBus:
    """Those that are bus-off, each until it has seen its sequences of 11 recessive bits.

    A bus at rest is one after the other; every frame ends with one: ACK delimiter, EOF and intermission. `ports` is
    for reading.
    """

    def __init__(self, timing: BitTiming) -> None:
        self.ports: list[Port] = []
        self._sequence_ns = timing.bits_ns(RECOVERY_SEQUENCE_BITS)

    def add(self, port: Port, sequences: int, now_ns: int) -> None:
        """Take a node off the bus."""
        if port not in self.ports:
            self.ports.append(port)
        port.leave_bus(sequences, now_ns)

    def remove(self, port: Port) -> None:
        """Forget a node that is no longer there."""
        if port in self.ports:
            self.ports.remove(port)

    def count_rest(self, idle_ns: int, now_ns: int) -> None:
        """Count the sequences of a bus at rest since `idle_ns`."""
        for port in list(self.ports):
            since_ns = max(idle_ns, port.off_since_ns)
            sequences = max(now_ns - since_ns, 0) // self._sequence_ns
            port.off_since_ns = since_ns + sequences * self._sequence_ns  # these don't count again
            self._count(port, sequences)

    def count_frame(self) -> None:
        """Count the one sequence at the end of a frame."""
        for port in list(self.ports):
            self._count(port, 1)

    def next_return_ns(self, idle_ns: int) -> int:
        """Return when the first of them is back, if the bus rests from `idle_ns` on."""
        returns = [
            max(idle_ns, port.off_since_ns) + port.left_sequences * self._sequence_ns
            for port in self.ports
            if port.left_sequences < NEVER_SEQUENCES // 2
        ]
        return min(returns, default=FOREVER_NS)

    def _count(self, port: Port, sequences: int) -> None:
        port.left_sequences -= sequences
        if port.left_sequences <= 0:
            self.ports.remove(port)
            port.rejoin_bus()
