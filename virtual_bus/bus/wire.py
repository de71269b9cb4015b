"""What carries frames between nodes in virtual time: a CAN bus, or a serial line."""

from collections.abc import Callable
from typing import Final, NamedTuple, Protocol

from firmware_protocol.frames import Frame
from virtual_bus.bus.faults import Side
from virtual_bus.bus.port import DEFAULT_QUEUE_FRAMES, Port

NOBODY_NS: Final = -1


class Wire(Protocol):
    """A pure machine in virtual ns that somebody else steps (`simulation.Simulation`)."""

    ports: list[Port]
    gone: bool

    def frame_ns(self, frame: Frame) -> int:
        """Return the time that a frame takes; ValueError when it is none that this wire carries."""

    def attach(
        self,
        name: str,
        side: Side,
        deliver: Callable[[Frame, int], None],
        queue_frames: int = DEFAULT_QUEUE_FRAMES,
        answers: bool = True,
    ) -> Port:
        """Join a node."""

    def detach(self, port: Port) -> None:
        """Take a node off."""

    def submit(self, port: Port, frame: Frame, now_ns: int) -> bool:
        """Queue a frame; False, counted at the port, where that can't be."""

    def refuses(self, port: Port, on_the_way: int = 0) -> bool:
        """Tell whether this node could queue nothing now, and count the attempt if so."""

    def flush(self, port: Port) -> None:
        """Forget what this node has queued and not begun to send."""

    def next_event_ns(self, before_ns: int) -> int:
        """Begin what can begin before `before_ns`; return when `run` is due."""

    def carry(self, until_ns: int) -> int:
        """Pass on frames that end before `until_ns`, as long as nobody can do anything about it, for less time each.

        Return when a node that may answer has been told something, which ends it; NOBODY_NS when none has. FOREVER_NS:
        none has, and there is nothing left to do. A wire may always leave all to `next_event_ns` and `run`.
        """

    def run(self, now_ns: int) -> bool:
        """Do what is due by now; False when no node that may answer has been told anything."""


class PacketReader(Protocol):
    """Bytes to frames."""

    counters: dict[str, int]

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that these bytes complete."""


class LineCodec(NamedTuple):
    """How a protocol packs frames on a serial line."""

    encode: Callable[[Frame], bytes]
    reader: Callable[[], PacketReader]
