"""What the service needs from outside, as protocols; adapters and tests supply them."""

from collections.abc import Mapping, Sequence
from enum import Enum
from typing import NamedTuple, Protocol

from firmware_protocol.frames import Frame
from firmware_protocol.host.samples import RawBench, RawSample
from hil_forceps.data.recording.writer import Reference
from hil_forceps.estimation.interface import Estimate, Sample


class SendResult(Enum):
    """What became of a frame handed to the link."""

    SENT = "sent"
    QUEUE_FULL = "queue_full"  # the bus is there but congested: this frame is dropped, never queued for later
    BUS_DOWN = "bus_down"  # bus-off, unplugged, gone


class Received(NamedTuple):
    """A frame and the host time at which it arrived (kernel stamp where there is one)."""

    time_ns: int
    frame: Frame


class Link(Protocol):
    """A raw-frame transport. Nothing here blocks, and nothing raises for what the outside did."""

    @property
    def counters(self) -> Mapping[str, int]:
        """What went wrong so far, by name."""

    def send(self, frame: Frame) -> SendResult:
        """Hand over one frame now or not at all."""

    def receive(self) -> Sequence[tuple[int, Frame]]:
        """Return what has arrived since the last call, each with its time (see `Received`), oldest first, bounded."""

    def is_up(self) -> bool:
        """Tell whether the bus is there."""

    def close(self) -> None:
        """Release it; safe to call twice."""


class Observer(Protocol):
    """Sees all that an axis takes and makes, as its recorder does. It neither waits nor raises."""

    def sample(self, raw: RawSample, sample: Sample, estimate: Estimate) -> None:
        """See a sample, with what the estimator made of it."""

    def reference(self, reference: Reference, sent_ns: int, outcome: int, setpoint_sequence: int) -> None:
        """See a tick's reference, whatever came of it."""

    def bench(self, raw: RawBench) -> None:
        """See a pair of bench values."""


class MotionWatch(Protocol):
    """Sees samples and references of a drive, and trips where its motion can't go on. Pure."""

    has_tripped: bool  # and stays so

    def see(self, theta_m_rad: float, current_A: float, reference_rad: float) -> bool:
        """Take a sample, with the reference that the drive has; NaN before the first."""

    def words(self) -> str:
        """Return what was seen, with the remedy."""


class OutsideReferences(Protocol):
    """References of the jaw angle from outside, for one axis. Pure."""

    @property
    def counters(self) -> Mapping[str, int]:
        """What became of those that came, by name."""

    def is_lost(self, now_ns: int) -> bool:
        """Tell whether none has come for too long."""

    def release(self, now_ns: int) -> None:
        """Wait for another sender where none has come for too long."""

    def words(self, now_ns: int) -> str:
        """Return how they were lost."""


class Clock(Protocol):
    """Monotonic host time."""

    def now_ns(self) -> int:
        """Return the time now."""

    def sleep_until_ns(self, time_ns: int) -> None:
        """Wait until `time_ns`, not at all when it has passed."""
