"""The suite's loop: the service's tick, with references of its own through a gate of its own.

As in the service a tick takes in what came, sends at most one reference, from a sample that is new and fresh, and then
what the machine has to say. While the drive comes to torque the reference is the measured angle.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

from firmware_protocol.conformance.findings import Inconclusive, Violation
from firmware_protocol.conformance.port import Margins
from firmware_protocol.frames import Frame
from firmware_protocol.host.samples import RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A, angle_raw_from_rad
from firmware_protocol.states import HostPhase
from hil_forceps.bridge.drive_conformance.bounds import Bounds, narrowed
from hil_forceps.bridge.drive_conformance.line import Line
from hil_forceps.control.gate import Gate
from hil_forceps.drives.port import DriveMachine
from hil_forceps.rig import Rig
from hil_forceps.rig.sections import Limits

MAX_RECORDED: Final = 200_000  # samples or references of one check
MAX_DENIED_IN_A_ROW: Final = 5  # as in the service
MAX_REFUSED_FRAMES_IN_A_ROW: Final = 1000  # that the line has no room for
NO_TORQUE: Final = frozenset({DriveState.DISABLED, DriveState.FAULT})
UNDER_TORQUE: Final = frozenset({HostPhase.ENABLING, HostPhase.RUNNING})
_OPERATIONAL: Final = int(DriveState.OPERATIONAL)


class Stopped(Exception):  # noqa: N818 - a wish, not an error of the program
    """Somebody asked for a clean stop."""


class Certain(Violation):
    """A violation that no host could have made that stood still for a while."""


class Seen(NamedTuple):
    """One sample."""

    stamp_ns: int
    received_ns: int
    theta_rad: float
    current_A: float
    state: int


class Referred(NamedTuple):
    """One reference that was sent."""

    at_ns: int
    stamp_ns: int  # of the sample that it comes from
    reference_rad: float


class Extremes(NamedTuple):
    """What a whole run has reached, of references and of angles under torque."""

    reference_low_rad: float = math.inf
    reference_high_rad: float = -math.inf
    theta_low_rad: float = math.inf
    theta_high_rad: float = -math.inf


class Loop:
    """Line, machine and gate of one drive; `run` lets time pass."""

    def __init__(
        self,
        line: Line,
        rig: Rig,
        machine: DriveMachine,
        bounds: Bounds,
        margins: Margins,
        stop_requested: Callable[[], bool] = lambda: False,
    ) -> None:
        self.line, self.rig, self.machine, self.bounds, self.margins = line, rig, machine, bounds, margins
        self.limits: Limits = rig.limits
        self.period_ns = round(rig.bench.host_period_s * 1e9)
        self.stop_requested = stop_requested
        self.newest: Seen | None = None
        self.extremes = Extremes()
        self.home_rad = math.nan  # where torque was asked for
        self.left_rad = math.nan  # the last angle under torque
        self.target_rad: float | None = None  # None: stay
        self.feeds = False  # references are sent
        self.is_silent = False  # nothing is sent at all
        self.frames_received = 0
        self._phase_ns = round(rig.bench.host_phase_s * 1e9)
        self._max_age_ns = round(self.limits.max_sample_age_s * 1e9)
        self._due_ns: int | None = None
        self._used: Seen | None = None  # the sample of the last reference
        self._gate = Gate(self.limits)
        self._low_rad, self._high_rad = self.limits.position_min_rad, self.limits.position_max_rad
        self._denied = self._refused = 0
        self.begin()

    def begin(self) -> None:
        """Start the records anew."""
        self.is_dangerous = False  # it moves against or beyond its references
        self.samples: list[Seen] = []
        self.references: list[Referred] = []
        self.repeated = self.stale = 0  # stamps that did not increase; ticks whose newest sample was too old
        self.stalled_ns = 0

    @property
    def is_virtual(self) -> bool:
        """Whether nothing can be late here."""
        return self.line.virtual_time

    @property
    def phase(self) -> HostPhase:
        """Where the host stands."""
        return self.machine.phase

    @property
    def may_have_torque(self) -> bool:
        """Whether torque was asked for, or the drive doesn't say that it has none."""
        return self.phase in UNDER_TORQUE or self.machine.drive_state not in NO_TORQUE

    def now_ns(self) -> int:
        """Return the time now."""
        return self.line.now_ns()

    def run(self, duration_ns: int, until: Callable[[], bool] | None = None) -> bool:
        """Let time pass, tick by tick; True as soon as `until` holds behind what a tick took in."""
        line = self.line
        end_ns = line.now_ns() + duration_ns
        while True:
            if self.stop_requested():
                raise Stopped
            self._take_in()
            if until is not None and until():
                return True
            now_ns = line.now_ns()
            if now_ns >= end_ns:
                return False
            self._act(now_ns)
            self._wait()

    def aim(self, home_rad: float) -> None:
        """Put the suite's gate around the angle at which torque will be asked for, which is within the limits."""
        self.home_rad, self.target_rad = home_rad, None
        limits = narrowed(self.limits, home_rad)
        self._low_rad, self._high_rad = limits.position_min_rad, limits.position_max_rad
        self._gate = Gate(limits)
        self._used, self._denied = self.newest, 0

    def off_at_once(self) -> None:
        """Send the emergency stop, and ask for no torque from now on."""
        self.feeds = self.is_silent = False
        self.line.send(self.machine.estop_frame())
        self.machine.disable()

    def _wait(self) -> None:
        now_ns, period_ns = self.line.now_ns(), self.period_ns
        if self._due_ns is None or now_ns - self._due_ns >= period_ns:
            self._due_ns = (now_ns - self._phase_ns) // period_ns * period_ns + self._phase_ns
        self._due_ns += period_ns
        self.line.wait_until(self._due_ns)
        if not self.is_virtual:
            self.stalled_ns = max(self.stalled_ns, self.line.now_ns() - self._due_ns)

    def _take_in(self) -> None:
        for time_ns, frame in self.line.receive():
            self.frames_received += 1
            self.machine.receive(frame, time_ns)
        for raw in self.machine.take_samples():
            self._see(raw)
        self.machine.take_bench()

    def _see(self, raw: RawSample) -> None:
        seen = Seen(raw.stamp_ns, raw.received_ns, raw.theta_m * ANGLE_LSB_RAD, raw.current * CURRENT_LSB_A, raw.state)
        if len(self.samples) < MAX_RECORDED:
            self.samples.append(seen)
        if self.newest is not None and seen.stamp_ns <= self.newest.stamp_ns:
            self.repeated += 1
            return
        self.newest = seen
        if self.phase in UNDER_TORQUE:
            self.left_rad = seen.theta_rad
            self._guard(seen.theta_rad)

    def _guard(self, theta_rad: float) -> None:
        """Take torque off where the motor goes further than anything here asks for."""
        low, high = self.extremes.theta_low_rad, self.extremes.theta_high_rad
        self.extremes = self.extremes._replace(theta_low_rad=min(low, theta_rad), theta_high_rad=max(high, theta_rad))
        furthest_rad = self.bounds.step_rad if self.target_rad is None else self.bounds.guard_rad
        if abs(theta_rad - self.home_rad) > furthest_rad:
            self._stop_running_away(theta_rad)

    def _stop_running_away(self, theta_rad: float) -> None:
        self.is_dangerous = True
        self.off_at_once()
        asked = "no motion was requested yet" if self.target_rad is None else "no reference is further than 1 deg"
        raise Certain(
            f"the motor ran {math.degrees(theta_rad - self.home_rad):+.2f} deg, to {theta_rad:.4g} rad, from where "
            f"torque was requested, although {asked}; torque was taken off"
        )

    def _act(self, now_ns: int) -> None:
        if self.is_silent:
            return
        if self.feeds:
            self._send_reference(now_ns)
        for frame in self.machine.poll(now_ns):
            self._send(frame)

    def _send_reference(self, now_ns: int) -> None:
        newest = self.newest
        if newest is None or newest is self._used:
            return
        if now_ns - newest.stamp_ns > self._max_age_ns:
            self.stale += 1
            return
        self._used = newest
        self._gate.see(newest.stamp_ns, newest.received_ns, newest.theta_rad, newest.current_A)
        wanted_rad = newest.theta_rad if self.target_rad is None else self.target_rad
        if newest.state != _OPERATIONAL:
            wanted_rad = newest.theta_rad
            self._gate.open(now_ns)
        elif self.target_rad is None:
            wanted_rad = self.target_rad = self._gate.position_rad
        passed_rad, verdict = self._gate.step(wanted_rad, now_ns)
        self._denied = 0 if passed_rad is not None else self._denied + 1
        if self._denied >= MAX_DENIED_IN_A_ROW:
            if not self._low_rad <= newest.theta_rad <= self._high_rad:  # and it was within when torque was asked for
                self._stop_running_away(newest.theta_rad)
            raise Inconclusive(f"the gate passed no reference: {verdict.value}, at {newest.theta_rad:.4g} rad")
        if passed_rad is None:
            return
        frame = self.machine.setpoint(angle_raw_from_rad(passed_rad))
        if frame is not None and self._send(frame):
            low, high = self.extremes.reference_low_rad, self.extremes.reference_high_rad
            self.extremes = self.extremes._replace(
                reference_low_rad=min(low, passed_rad), reference_high_rad=max(high, passed_rad)
            )
            if len(self.references) < MAX_RECORDED:
                self.references.append(Referred(now_ns, newest.stamp_ns, passed_rad))

    def _send(self, frame: Frame) -> bool:
        is_sent = self.line.send(frame)
        self._refused = 0 if is_sent else self._refused + 1
        if self._refused >= MAX_REFUSED_FRAMES_IN_A_ROW:
            raise Inconclusive("the line accepts no more frames")
        return is_sent
