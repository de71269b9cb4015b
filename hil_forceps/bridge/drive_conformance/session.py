"""A maker's drive in hand: bring it to a state, wait for its word, keep the evidence."""

import math
from collections.abc import Callable
from statistics import fmean, median, pstdev
from typing import Final

from firmware_protocol.conformance.findings import Disturbed, Inconclusive, Violation, require
from firmware_protocol.conformance.port import MS, Margins
from firmware_protocol.states import HostPhase
from hil_forceps.bridge.drive_conformance.bounds import bounds_of
from hil_forceps.bridge.drive_conformance.line import Line
from hil_forceps.bridge.drive_conformance.loop import NO_TORQUE, UNDER_TORQUE, Loop, Seen
from hil_forceps.bridge.drive_conformance.measures import Measure
from hil_forceps.bridge.results import ServiceConfig
from hil_forceps.drives.port import DriveMachine
from hil_forceps.drives.profile import Profile
from hil_forceps.drives.supervision.direction import MIN_WAY_NOISE_RATIO, MIN_WAY_SHARE
from hil_forceps.rig import Rig
from hil_forceps.rig.sections import MotorDriver

REST_WINDOW_NS: Final = 100 * MS  # over which the angle is looked at
MAX_REST_WINDOWS: Final = 30
MIN_SAMPLES: Final = 5
SETTLE_PERIODS: Final = 5  # before the drive's word counts, as in the service


class Session(Loop):
    """One drive; `Loop` with what a check asks of it."""

    def __init__(
        self,
        line: Line,
        rig: Rig,
        machine: DriveMachine,
        profile: Profile,
        settings: MotorDriver,
        margins: Margins,
        stop_requested: Callable[[], bool] = lambda: False,
    ) -> None:
        """UserError where the rig doesn't say enough."""
        super().__init__(line, rig, machine, bounds_of(rig, profile, settings), margins, stop_requested)
        self.promises = profile.promises(rig, settings)
        self.service = ServiceConfig(period_ns=self.period_ns)
        self.sample_period_s = profile.sample_period_s(rig, settings)
        self.node = settings.node_id
        self.watchdog_s = settings.watchdog_s
        self.refusal = ""  # why the drive is none that the rig describes
        self.identified_ns: int | None = None
        self.words_at_first = ""  # of a fault, before there was any
        self.noise_rad = 0.0  # range of the angle at rest
        self.noise_A = 0.0  # standard deviation of the current at rest
        self.measures: list[Measure] = []
        self.notes: list[str] = []

    # -- evidence -----------------------------------------------------------------------------------------------------

    def bound(
        self, name: str, value: float, unit: str, *, least: float | None = None, most: float | None = None
    ) -> None:
        """Record a value with what is allowed; Violation when it is outside."""
        measure = Measure(name, value, unit, least, most)
        self.measures.append(measure)
        if not measure.is_kept:
            raise Violation(measure.words())

    def tell(self, name: str, value: float, unit: str) -> None:
        """Record a value that nothing is asked of."""
        self.measures.append(Measure(name, value, unit))

    def note(self, words: str) -> None:
        """Record what is no number."""
        self.notes.append(words)

    def begin_evidence(self) -> None:
        """Start evidence and records anew."""
        self.measures, self.notes = [], []
        self.begin()

    def evidence(self) -> str:
        """Return all that was found to be as it has to be, in words."""
        return "; ".join([*(measure.words() for measure in self.measures if measure.is_kept), *self.notes])

    def since(self, stamp_ns: int) -> list[Seen]:
        """Return the samples of this check that were taken from then on."""
        return [seen for seen in self.samples if seen.stamp_ns >= stamp_ns]

    def last(self, count: int) -> list[Seen]:
        """Return the newest samples; Inconclusive where there are too few to say anything."""
        require(len(self.samples) >= MIN_SAMPLES, f"only {len(self.samples)} samples arrived")
        return self.samples[-count:]

    def angle(self, count: int = 20) -> float:
        """Return the median of the newest angles."""
        return median(seen.theta_rad for seen in self.last(count))

    # -- times --------------------------------------------------------------------------------------------------------

    @property
    def slack_ns(self) -> int:
        """Return what line and tick add to every time that is measured here."""
        return self.margins.line_ns + 2 * self.period_ns

    @property
    def report_ns(self) -> int:
        """Return how long after a change of state the machine has to show it."""
        return round(self.promises.state_report_s * 1e9) + self.slack_ns

    @property
    def watchdog_ns(self) -> int:
        """Return how long after the last reference the end of torque has to show."""
        own_ns = round(self.watchdog_s * 1e9 * (1.0 + self.margins.clock_ppm * 1e-6))
        return own_ns + self.margins.granularity_ns + self.report_ns

    # -- states -------------------------------------------------------------------------------------------------------

    def is_free(self) -> bool:
        """Tell whether torque is off, by the drive's own word."""
        return self.phase not in UNDER_TORQUE and self.machine.drive_state in NO_TORQUE

    def state_words(self) -> str:
        """Return phase and state; behind them the fault or the refusal."""
        said = self.machine.drive_state
        words = f"{self.phase.name}, drive {'silent' if said is None else said.name}"
        if self.phase is HostPhase.FAULT:
            return f"{words}: {self.machine.fault_words()}"
        return f"{words}: {self.machine.refusal}" if self.phase is HostPhase.REFUSED else words

    def connect(self) -> None:
        """Look for the drive, for twice the time that the service gives it; Inconclusive where nobody fits."""
        self.words_at_first = self.machine.fault_words()
        began_ns, within_ns = self.now_ns(), 2 * self.service.connect_timeout_ns
        self.machine.connect(began_ns)
        ends = {HostPhase.READY, HostPhase.REFUSED, HostPhase.FAULT}
        self.run(within_ns, lambda: self.phase in ends)
        self.identified_ns = self.now_ns() - began_ns
        if self.phase is HostPhase.REFUSED:
            self.refusal = self.machine.refusal
        elif self.phase is HostPhase.FAULT:
            raise Inconclusive(
                f"the drive has a latched fault: {self.machine.fault_words()}; reset it (`hil-forceps run "
                "--reset-fault`"
                " or its maker's program)"
            )
        elif self.phase is not HostPhase.READY:
            heard = (
                f"{self.frames_received} frames were received, none of this drive"
                if self.frames_received
                else "no frame was received"
            )
            raise Inconclusive(
                f"no drive answered: {heard}; check node id, bit rate and wiring; `hil-forceps scan` lists the drives"
            )

    def require_judgeable(self, moves: bool) -> None:
        """Inconclusive where the drive is in no position to be judged, with what to do about it.

        What the drive does wrong by itself is for the checks to say: no samples at all, or a current that moves it.
        """
        if not self.off():
            raise Inconclusive(
                f"the drive has torque that was not requested here ({self.state_words()}); stop the other program"
            )
        self.begin()
        self.run(REST_WINDOW_NS)
        if not self.samples:
            return
        try:
            self.rest()
        except Inconclusive as reason:
            if abs(fmean(seen.current_A for seen in self.samples)) > self.bounds.no_current_A:
                return
            raise Inconclusive(f"{reason}; take the load off the jaw, or hold it") from None
        self._require_within_limits()
        if moves:
            self.step_sign()
        visible = (
            max(MIN_WAY_SHARE * self.bounds.step_rad, MIN_WAY_NOISE_RATIO * self.noise_rad)
            <= self.bounds.step_rad / 2.0
        )
        require(not moves or visible, f"the angle's noise of {self.noise_rad:.2g} rad is too large for a step of 1 deg")

    def _require_within_limits(self) -> None:
        low, high, theta = self.limits.position_min_rad, self.limits.position_max_rad, self.angle()
        require(
            low <= theta <= high,
            f"the motor is at {theta:.4g} rad, `limits:` are {low:.4g} to {high:.4g}; move it within, set "
            "motor_driver.encoder_zero_rev, or change them",
        )

    def step_sign(self) -> int:
        """Return the side on which there is room for a step, 1 or −1; Inconclusive where there is none."""
        theta, reach = self.angle(), self.bounds.step_rad + self.bounds.still_rad
        low, high = self.limits.position_min_rad, self.limits.position_max_rad
        if theta + reach <= high:
            return 1
        require(
            theta - reach >= low,
            f"the motor is at {theta:.4g} rad, `limits:` are {low:.4g} to {high:.4g}: no room for a step of 1 deg; "
            "move it, or change them",
        )
        return -1

    def rest(self) -> None:
        """Wait until the motor stands still, and note its noise; Inconclusive when it does not."""
        for _ in range(MAX_REST_WINDOWS):
            begin = len(self.samples)
            self.run(max(REST_WINDOW_NS, round(20e9 * self.sample_period_s)))
            seen = self.samples[begin:]
            angles = [each.theta_rad for each in seen]
            if len(angles) >= MIN_SAMPLES and max(angles) - min(angles) <= self.bounds.rest_rad:
                self.noise_rad = max(max(angles) - min(angles), self.bounds.quantum_rad)
                self.noise_A = pstdev(each.current_A for each in seen)
                return
        raise Inconclusive("the motor does not come to rest without torque")

    def require_undisturbed(self) -> None:
        """Disturbed where something moves the motor while the drive gives it no torque."""
        if not self.is_free() or not self.samples:
            return
        begin = len(self.samples)
        self.run(REST_WINDOW_NS)
        seen = self.samples[begin:]
        if len(seen) < MIN_SAMPLES or abs(fmean(each.current_A for each in seen)) > self.bounds.no_current_A:
            return
        angles = [each.theta_rad for each in seen]
        low, high, theta = self.limits.position_min_rad, self.limits.position_max_rad, median(angles)
        was_left = abs(theta - self.left_rad) <= self.bounds.step_rad  # there by the drive itself
        if max(angles) - min(angles) > self.bounds.rest_rad or not (low <= theta <= high or was_left):
            raise Disturbed(
                f"an external torque moved the motor to {theta:.4g} rad (`limits:` are {low:.4g} to {high:.4g}) "
                "while the "
                "drive gave no torque; take the load off the jaw, or hold it"
            )

    def enable(self) -> None:
        """Ask for torque where the motor rests; Violation where it does not come, all along sending references."""
        require(self.phase is HostPhase.READY, f"the drive is not ready: {self.state_words()}")
        require(self.newest is not None, "the drive sends no samples")
        self.rest()
        self._require_within_limits()
        self.aim(self.angle())
        self.machine.enable()
        self.feeds = True
        self.run(self.service.enable_timeout_ns, lambda: self.phase is not HostPhase.ENABLING)
        if self.phase is not HostPhase.RUNNING:
            raise Violation(f"it did not reach torque: {self.state_words()}")

    def hold(self, duration_ns: int) -> None:
        """Go on; Violation where the drive leaves operation."""
        if self.run(duration_ns, lambda: self.phase is not HostPhase.RUNNING):
            raise Violation(f"it left operation while references arrived: {self.state_words()}")

    def move(self, offset_rad: float, duration_ns: int) -> None:
        """Lead the reference to `home + offset` through the gate."""
        self.target_rad = self.home_rad + offset_rad
        self.hold(duration_ns)

    def off(self) -> bool:
        """Ask for no torque, as the service does at its end; False where the drive's word doesn't come."""
        self.feeds = self.is_silent = False
        self.machine.disable()
        self.run(SETTLE_PERIODS * self.period_ns)
        return self.run(self.service.disable_timeout_ns, lambda: self.machine.drive_state in NO_TORQUE)

    def recover(self) -> None:
        """Bring the drive to READY, without torque and fault; Inconclusive when it can't be.

        Where it doesn't confirm that it has no torque, it gets the emergency stop.
        """
        for _ in range(3):
            if not self.off():
                self.off_at_once()
                continue
            if self.phase is HostPhase.FAULT:
                self.machine.reset_fault()
            elif self.phase in {HostPhase.DISCONNECTED, HostPhase.REFUSED}:
                self.machine.connect(self.now_ns())
            if self.run(self.service.connect_timeout_ns, lambda: self.phase is HostPhase.READY) and self.off():
                return
        raise Inconclusive(f"the drive could not be restored: {self.state_words()}")

    def close(self) -> None:
        """Leave the drive without torque; Inconclusive where it does not confirm that."""
        self.stop_requested = lambda: False
        if math.isnan(self.home_rad):  # no torque was asked for
            return
        if not self.off():
            raise Inconclusive(f"the drive does not confirm that it has no torque: {self.state_words()}")

    def degrees(self, angle_rad: float) -> float:
        """Return an angle as evidence tells it."""
        return math.degrees(angle_rad)
