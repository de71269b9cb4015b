"""Faults of the host and of its clock: what stands between the service and the bus, the clock, the disk."""

import errno
import hashlib
from collections.abc import Callable
from io import BytesIO
from typing import Any, Final, NamedTuple

import can

from firmware_protocol.frames import Frame
from hil_forceps.bridge.clocks import VirtualTimeBus
from tests.fault_campaign.schedule import Fault, Kind, Schedule
from virtual_bus.interface import VirtualForcepsBus

NS: Final = 1e9
STARTED_NS: Final = 10_000_000_000  # before the world: no host's clock is set back beyond its zero


LONGEST_NS: Final = 4_000_000_000  # of a run: all its time-outs one after the other, and the longest faults


class EndlessError(Exception):
    """The service doesn't end."""


class KilledError(BaseException):
    """The process is gone; not an Exception, for nothing may swallow it."""


class Sent(NamedTuple):
    """A frame that the service handed over, by the time of the bus."""

    bus_ns: int
    host_ns: int
    frame: Frame
    is_reference: bool  # or a repetition of one
    is_fresh: bool  # made in this tick
    tick: int
    is_taken: bool  # by the transmit queue


class HostClock:
    """The bus's time with what a host's clock does to it."""

    def __init__(self, bus: VirtualTimeBus, schedule: Schedule) -> None:
        self.bus = bus
        self.offset_ns = STARTED_NS
        self.is_dead = False
        self._steps = _pending(schedule, Kind.CLOCK_STEP)
        self._late = _pending(schedule, Kind.LATE_TICK)
        self._stops = _pending(schedule, Kind.STOPPED, "sleep")
        self._stops_in_tick = _pending(schedule, Kind.STOPPED, "tick")
        self._kills = _pending(schedule, Kind.KILLED)
        self.stops: list[tuple[int, int]] = []  # of the process within a tick, bus time
        self.ticks = 0

    def now_ns(self) -> int:
        """Return the host's time; the process may be stopped right behind the reading."""
        bus_ns = self.bus.now_ns()
        while self._steps and self._steps[0].begin_ns <= bus_ns:
            self.offset_ns += round(self._steps.pop(0).size * NS)
        read_ns = bus_ns + self.offset_ns
        if self._stops_in_tick and self._stops_in_tick[0].begin_ns <= bus_ns:
            self.stops.append((bus_ns, self.spend(self._stops_in_tick.pop(0).size)))
        return read_ns

    def spend(self, size_s: float) -> int:
        """Let time pass in which the host does nothing; return until when."""
        until_ns = self.bus.now_ns() + round(size_s * NS)
        self.bus.advance_until_ns(until_ns)
        return until_ns

    def sleep_until_ns(self, time_ns: int) -> None:
        """Sleep until the host's clock says so, and longer where a fault has it so."""
        bus = self.bus
        self.ticks += 1
        if bus.now_ns() > LONGEST_NS:
            raise EndlessError(f"still running after {LONGEST_NS / 1e9:g} s")
        while True:
            target_ns = time_ns - self.offset_ns
            if not (self._steps and self._steps[0].begin_ns <= target_ns):
                break
            step = self._steps.pop(0)
            bus.advance_until_ns(max(step.begin_ns, bus.now_ns()))
            self.offset_ns += round(step.size * NS)
        if target_ns > bus.now_ns():
            bus.advance_until_ns(target_ns)
        if self._kills and self._kills[0].begin_ns <= bus.now_ns():
            self.is_dead = True
            raise KilledError
        for pending in (self._late, self._stops):
            if pending and pending[0].begin_ns <= bus.now_ns():
                self.spend(pending.pop(0).size)


def _pending(schedule: Schedule, kind: Kind, where: str = "") -> list[Fault]:
    return [fault for fault in schedule.of_kind(kind) if fault.where == where]


class WatchedBus:
    """The bus as the link has it: its transmit queue is full for a while; logs what leaves and what comes."""

    def __init__(self, bus: VirtualForcepsBus, clock: HostClock, schedule: Schedule, references: set[Frame]) -> None:
        """`references`: filled with the frames that the drive's machine makes as such."""
        self.sent: list[Sent] = []
        self.references = references
        self.made: Frame | None = None  # the last of them, until it is sent
        self.digest = hashlib.sha256()
        self.now_ns, self.advance_until_ns, self.shutdown = bus.now_ns, bus.advance_until_ns, bus.shutdown
        self._bus = bus
        self._clock = clock
        self._full = schedule.of_kind(Kind.FULL_QUEUE)

    @property
    def state(self) -> can.BusState:
        """See `VirtualTimeBus`."""
        return self._bus.state

    def send_frame(self, frame: Frame) -> bool:
        """See `VirtualTimeBus`."""
        clock, bus_ns = self._clock, self._bus.now_ns()
        if clock.is_dead:
            return False
        is_full = any(fault.begin_ns <= bus_ns < fault.end_ns for fault in self._full)
        is_taken = not is_full and self._bus.send_frame(frame)
        is_fresh, is_reference = frame is self.made, frame in self.references
        if is_fresh:
            self.made = None
        host_ns = bus_ns + clock.offset_ns
        self.sent.append(Sent(bus_ns, host_ns, frame, is_reference, is_fresh, clock.ticks, is_taken))
        self.digest.update(b"%d>%d%d%s" % (bus_ns, is_taken, frame[0], frame[1]))
        return is_taken

    def receive_frames(self) -> list[tuple[int, Frame]]:
        """See `VirtualTimeBus`; times of arrival are of the host's clock as it is now."""
        received, offset_ns = self._bus.receive_frames(), self._clock.offset_ns
        for bus_ns, frame in received:
            self.digest.update(b"%d<%d%s" % (bus_ns, frame[0], frame[1]))
        return [(bus_ns + offset_ns, frame) for bus_ns, frame in received] if offset_ns else received


def watch_references(machine: Any, bus: WatchedBus) -> None:
    """Have the bus know which frames are references."""
    make = machine.setpoint

    def setpoint(raw: int) -> Frame | None:
        frame: Frame | None = make(raw)
        if frame is not None:
            bus.references.add(frame)
            bus.made = frame
        return frame

    machine.setpoint = setpoint


def stall(step: Callable[..., Any], clock: HostClock, schedule: Schedule) -> Callable[..., Any]:
    """Return an estimator's step that takes time of the host within the faults' windows."""
    faults = schedule.of_kind(Kind.STALLED_ESTIMATOR)
    if not faults:
        return step

    def stalled(*arguments: Any) -> Any:
        bus_ns = clock.bus.now_ns()
        for fault in faults:
            if fault.begin_ns <= bus_ns < fault.end_ns:
                clock.spend(fault.size)
        return step(*arguments)

    return stalled


class Disk(BytesIO):
    """A file in memory that outlives its closing; full behind `room` bytes, once `room` is set."""

    def __init__(self) -> None:
        super().__init__()
        self.room: int | None = None
        self.content = b""

    def write(self, data: Any) -> int:
        """Write all, or what there is room for."""
        if self.room is None:
            return super().write(data)
        left = self.room - self.tell()
        if left <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(bytes(data)[:left])

    def close(self) -> None:
        """Keep what was written."""
        if not self.closed:
            self.content = self.getvalue()
        super().close()
