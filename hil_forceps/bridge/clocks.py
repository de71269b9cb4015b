"""Host time: the machine's monotonic clock, or the virtual time of a bus that carries its own."""

import time
from typing import Protocol

import can

from firmware_protocol.frames import Frame


class MonotonicClock:
    """CLOCK_MONOTONIC; sleeps, then spins for the last bit, since a sleeping process wakes late by 50 µs and more.

    `spin_ns` is that last bit: more of it is punctual and burns a core, 0 never spins.
    """

    def __init__(self, spin_ns: int = 100_000) -> None:
        if spin_ns < 0:
            raise ValueError(f"a spin can't last {spin_ns} ns")
        self._spin_ns = spin_ns

    def now_ns(self) -> int:
        """Return the time now."""
        return time.monotonic_ns()

    def sleep_until_ns(self, time_ns: int) -> None:
        """Wait until `time_ns`, not at all when it has passed."""
        rest_ns = time_ns - time.monotonic_ns() - self._spin_ns
        if rest_ns > 0:
            time.sleep(rest_ns * 1e-9)
        while time.monotonic_ns() < time_ns:
            pass


class VirtualTimeBus(Protocol):
    """A python-can bus that is its own clock: the world goes on while the host waits."""

    @property
    def state(self) -> can.BusState:
        """State of the host's controller."""

    def now_ns(self) -> int:
        """Return the virtual time."""

    def advance_until_ns(self, time_ns: int) -> None:
        """Advance the simulation to this time."""

    def send_frame(self, frame: Frame) -> bool:
        """Queue a frame now; False when the transmit queue is full."""

    def receive_frames(self) -> list[tuple[int, Frame]]:
        """Return the frames that arrived since the last call, with their times of arrival."""

    def shutdown(self) -> None:
        """Close the bus."""


class VirtualClock:
    """The clock of a `VirtualTimeBus`."""

    def __init__(self, bus: VirtualTimeBus) -> None:
        self._bus = bus
        self.now_ns = bus.now_ns  # bound once: these run several times a tick

    def sleep_until_ns(self, time_ns: int) -> None:
        """Let the world go on until `time_ns`, not at all when it has passed."""
        if time_ns > self.now_ns():
            self._bus.advance_until_ns(time_ns)
