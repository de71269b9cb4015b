"""A node's CAN controller: its share of the transmit queue and its error counters (ISO 11898-1:2015, 12.1.4)."""

from collections.abc import Callable
from enum import IntEnum

from firmware_protocol.frames import Frame
from virtual_bus.faults import Side

DEFAULT_QUEUE_FRAMES = 16
NEVER_SEQUENCES = 1 << 40  # kept off the bus until somebody lets it recover

_PASSIVE_ABOVE = 127
_BUS_OFF_ABOVE = 255
_COUNTERS = (
    "sent",
    "received",
    "rejected_full",
    "rejected_down",
    "discarded",
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
    """One controller on the bus; `deliver(frame, now_ns)` takes what the others send."""

    __slots__ = (
        *_COUNTERS,
        "deliver",
        "left_sequences",
        "name",
        "off_since_ns",
        "queue_frames",
        "queued",
        "side",
        "state",
    )

    def __init__(self, name: str, side: Side, deliver: Callable[[Frame, int], None], queue_frames: int) -> None:
        self.name = name
        self.side = side
        self.deliver = deliver
        self.queue_frames = queue_frames
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
        """Count a success where there were errors before."""
        self.tec = max(self.tec - 1, 0)
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
