"""Faults of the drive, and the witness: what arrived at it, what it followed, and what current its motor had."""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from firmware_protocol.drive.machine import DriveMachine
from firmware_protocol.frames import Frame
from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A
from hil_forceps.drives.cia402.objects import HOST_NODE
from tests.fault_campaign.schedule import Fault, Kind, Schedule
from virtual_bus.drives.mit import SimulatedMit
from virtual_bus.plant.sensors import Reading

CIA402_HOST_HEARTBEAT: Final = 0x700 + HOST_NODE
BOOT_NS: Final = 10_000_000  # in which a controller that was reset hears and says nothing


class Moment(NamedTuple):
    """One period of the drive's loop."""

    at_ns: int
    reference_rad: float | None  # what it leads the motor to; None: nothing drives the motor
    sensed_rad: float  # what the drive takes for the motor's angle
    true_rad: float
    current_A: float  # held from now on


class WatchedForceps:
    """A simulated forceps with faults of its sensors, whose every period is kept."""

    def __init__(self, inner: Any, schedule: Schedule, drive: Any) -> None:
        self.inner = inner
        self.moments: list[Moment] = []
        self._drive = drive
        self._encoder = schedule.of_kind(Kind.ENCODER_JUMP, Kind.ENCODER_FREEZE)
        self._current = schedule.of_kind(Kind.CURRENT_STUCK)
        self._frozen: dict[Fault, int] = {}
        self._sensed_raw = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def sample(self, now_ns: int, until_ns: int, reference_raw: int | None) -> tuple[int, int, int, int]:
        """See `SimulatedForceps`."""
        true_rad = float(self.inner._state[0])
        if any(fault.begin_ns <= now_ns < fault.end_ns for fault in self._encoder):
            reading = self.inner.read(now_ns)
            theta, current, *others = reading
            theta = self._angle(theta, now_ns)
            self.inner.run(now_ns, until_ns, theta, reference_raw)
        else:
            theta, current, *others = self.inner.sample(now_ns, until_ns, reference_raw)
        reference_rad = None if reference_raw is None else reference_raw * ANGLE_LSB_RAD
        self.moments.append(
            Moment(now_ns, reference_rad, theta * ANGLE_LSB_RAD, true_rad, float(self.inner._current_A))
        )
        return theta, self._current_raw(current, now_ns), others[0], others[1]

    def read(self, now_ns: int) -> Reading:
        """See `SimulatedForceps`."""
        reading: Reading = self.inner.read(now_ns)
        self._sensed_raw = self._angle(reading.theta_m, now_ns)
        return reading._replace(theta_m=self._sensed_raw, current=self._current_raw(reading.current, now_ns))

    def hold(self, now_ns: int, until_ns: int, current_A: float) -> None:
        """See `SimulatedForceps`; a drive that closes its loop itself says where it leads the motor."""
        true_rad, reference_rad = float(self.inner._state[0]), self._drive.reference_rad()
        self.inner.hold(now_ns, until_ns, current_A)
        self.moments.append(Moment(now_ns, reference_rad, self._sensed_raw * ANGLE_LSB_RAD, true_rad, current_A))

    def _angle(self, theta_raw: int, now_ns: int) -> int:
        for fault in self._encoder:
            if not fault.begin_ns <= now_ns < fault.end_ns:
                continue
            if fault.kind is Kind.ENCODER_FREEZE:
                theta_raw = self._frozen.setdefault(fault, theta_raw)
            else:
                theta_raw += round(fault.size / ANGLE_LSB_RAD)
        return theta_raw

    def _current_raw(self, current_raw: int, now_ns: int) -> int:
        for fault in self._current:
            if fault.begin_ns <= now_ns < fault.end_ns:
                current_raw = round(fault.size / CURRENT_LSB_A)
        return current_raw


class Arrival(NamedTuple):
    """A reference that reached the drive."""

    at_ns: int
    frame: Frame


class FaultyDrive:
    """A simulated drive as a node that is reset, loses its power, or isn't plugged in yet."""

    def __init__(self, drive: Any, schedule: Schedule, references: set[Frame], from_ns: int = 0) -> None:
        """`references`: the frames that the service made as such. `from_ns`: the time before is without the drive."""
        self.drive = drive
        self.forceps = drive._forceps = WatchedForceps(drive._forceps, schedule, drive)
        self.arrivals: list[Arrival] = []
        self.fed: list[int] = []  # when its watchdog was
        self.silences = [(0, from_ns)] if from_ns else []
        for fault in schedule.of_kind(Kind.RESET, Kind.BROWN_OUT):
            begin_ns, end_ns = fault.begin_ns, fault.end_ns + BOOT_NS
            self.silences.append((begin_ns, end_ns))
        self._edges = sorted(edge for silence in self.silences for edge in silence if edge)
        self._references = references
        self._is_cia402 = schedule.profile == "cia402"
        self._reset = _RESETS[schedule.profile.partition("_")[0]]

    def trip(self) -> None:
        """See `SimulatedMotorDriver`."""
        self.drive.trip()

    def is_silent(self, now_ns: int) -> bool:
        """Tell whether it hears and says nothing."""
        return any(begin_ns <= now_ns < end_ns for begin_ns, end_ns in self.silences)

    def receive(self, frame: Frame, now_ns: int) -> None:
        """See `Node`."""
        if self.silences and self.is_silent(now_ns):
            return
        before = _accepted(self.drive)
        self.drive.receive(frame, now_ns)
        if frame in self._references:
            self.arrivals.append(Arrival(now_ns, frame))
            if before is None or _accepted(self.drive) != before:
                self.fed.append(now_ns)
        elif self._is_cia402 and frame.arbitration_id == CIA402_HOST_HEARTBEAT:  # goes out with references only
            self.fed.append(now_ns)

    def next_wake_ns(self) -> int:
        """See `Node`."""
        return int(self.drive.next_wake_ns())

    def wake(self, now_ns: int) -> None:
        """See `Node`."""
        while self._edges and self._edges[0] <= now_ns:
            self._reset(self.drive, self._edges.pop(0))
        self.drive.wake(now_ns)

    def take_outbox(self) -> list[Frame]:
        """See `Node`."""
        frames: list[Frame] = self.drive.take_outbox()
        newest_ns = self.forceps.moments[-1].at_ns if self.forceps.moments else 0
        return [] if self.silences and self.is_silent(newest_ns) else frames


def _accepted(drive: Any) -> int | None:
    """Return how many references a drive has taken that judges them; None where any is taken."""
    machine = getattr(drive, "machine", None)
    return machine.counters["setpoints_accepted"] if isinstance(machine, DriveMachine) else None


def _reset_native(drive: Any, now_ns: int) -> None:
    drive.machine = DriveMachine(drive.machine.config)
    drive._sequence = 0
    clock = type(drive)._drive_us
    drive._drive_us = lambda at_ns: clock(drive, at_ns - now_ns)


def _reset_odrive(drive: Any, now_ns: int) -> None:
    del now_ns
    drive.state, drive.error, drive.input_pos_rev, drive.modes = 1, 0, 0.0, (0, 0)
    drive._said_closed_loop = False


def _reset_mit(drive: SimulatedMit, now_ns: int) -> None:
    del now_ns
    drive.reset()


def _reset_dynamixel(drive: Any, now_ns: int) -> None:
    del now_ns
    drive.restart()


def _reboot(drive: Any, now_ns: int) -> None:
    drive.reboot(now_ns)


_RESETS: Final[dict[str, Callable[[Any, int], None]]] = {
    "native": _reset_native,
    "odrive": _reset_odrive,
    "cia402": _reboot,
    "moteus": _reboot,
    "mit": _reset_mit,
    "dynamixel": _reset_dynamixel,
    "vesc": _reboot,
}
