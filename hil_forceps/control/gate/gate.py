"""The gate: samples and requests in, the reference that may leave out. No clock, and nothing of estimators or service.

`see` takes every sample, `open` begins at the newest one's angle, `step` answers a request. The limits are those of
`limiter` (`jerk` where the rig limits it) and `window`, the checks of the feedback those of `feedback`; where the gate
stands is the table of `latch`.

A gate is closed until it is opened at a measured angle within the bounds, and its first output is that angle. It closes
when more than `max_gap_s` lies between two outputs. Each output needs a sample of its own that is no older than
`limits.max_sample_age_s`. A step makes use of `max_step_s` at most, however long the last output is ago: what a late
tick left out is not caught up at once. While the feedback is beyond a limit the reference is held: the request is then
the last reference, and the limits hold as ever. After `FeedbackBounds.hold_s` of that the gate latches.
"""

import math
from typing import Final

from hil_forceps.control.gate.bounds import FeedbackBounds
from hil_forceps.control.gate.feedback import FeedbackMonitor, Finding, trip_of
from hil_forceps.control.gate.jerk import JerkLimiter
from hil_forceps.control.gate.kernel import Vector
from hil_forceps.control.gate.latch import TRANSITIONS, GateEvent, GateState
from hil_forceps.control.gate.limiter import AccelerationLimiter
from hil_forceps.control.gate.trip import GAP, IMPLAUSIBLE, GateTrip
from hil_forceps.control.gate.verdicts import Bounds, GateVerdict, Motion
from hil_forceps.control.gate.window import TravelWindow
from hil_forceps.rig.sections import Limits

# The drive's own watchdog has ended the run by then; whoever comes back after it has to start anew.
DEFAULT_MAX_GAP_S: Final = 0.02
NEVER_NS: Final = -(1 << 63)

# Members of an Enum cost as much as a call when looked up by their class, and these are asked for at every tick.
_CLOSED: Final[GateState] = GateState.CLOSED
_OPEN: Final[GateState] = GateState.OPEN
_LATCHED: Final[GateState] = GateState.LATCHED
_POSITION: Final = GateVerdict.LIMITED_POSITION
_is_finite: Final = math.isfinite


class Gate:
    """The gate of one motor; `state` is where it stands, `trip` what froze, closed or latched it last."""

    __slots__ = (
        "_bounds", "_frozen_ns", "_has_output", "_hold_ns", "_hold_rad", "_is_fresh", "_limit", "_limiter",
        "_max_age_ns", "_max_gap_ns", "_max_step_ns", "_monitor", "_motion", "_received_ns", "_stamp_ns", "_theta_rad",
        "_time_ns", "_window", "state", "trip",
    )  # fmt: skip

    def __init__(
        self,
        limits: Limits,
        feedback: FeedbackBounds | None = None,
        max_gap_s: float = DEFAULT_MAX_GAP_S,
        max_step_s: float = DEFAULT_MAX_GAP_S,
    ) -> None:
        """Take the limits; without `feedback` its plausibility isn't checked. ValueError for what can't be limits."""
        self._bounds: Bounds = (limits.position_min_rad, limits.position_max_rad)
        _check(limits, max_gap_s, max_step_s)
        jerk, travel = limits.jerk_max_rad_per_s3, limits.window_travel_max_rad
        self._limiter: AccelerationLimiter | JerkLimiter
        self._limiter = AccelerationLimiter(limits) if jerk is None else JerkLimiter(limits, jerk)
        self._limit = self._limiter.step
        self._window = None if travel is None else TravelWindow(travel)
        self._monitor: FeedbackMonitor | None = None
        if feedback is not None:
            self._monitor, self._hold_ns = FeedbackMonitor(feedback), round(feedback.hold_s * 1e9)
        self._max_gap_ns, self._max_step_ns = round(max_gap_s * 1e9), round(max_step_s * 1e9)
        self._max_age_ns = round(limits.max_sample_age_s * 1e9)
        self.state = _CLOSED
        self.trip: GateTrip | None = None
        self._stamp_ns = self._received_ns = NEVER_NS
        self._theta_rad = math.nan
        self._motion: Motion = (math.nan, 0.0, 0.0)

    @property
    def range_rad(self) -> float:
        """How far the bounds lie apart."""
        low, high = self._bounds
        return high - low

    @property
    def max_gap_ns(self) -> int:
        """How long after an output the gate closes."""
        return self._max_gap_ns

    @property
    def position_rad(self) -> float:
        """The last output, or where the gate was opened; NaN before."""
        return self._motion[0]

    def see(self, stamp_ns: int, received_ns: int, theta_m_rad: float, current_A: float) -> None:
        """Take a sample; one whose stamp does not increase is none. `received_ns` is the host's time."""
        if stamp_ns <= self._stamp_ns:
            return
        self._stamp_ns, self._received_ns, self._theta_rad, self._is_fresh = stamp_ns, received_ns, theta_m_rad, True
        monitor = self._monitor
        if monitor is None or self.state is _CLOSED:
            return
        if monitor.see(stamp_ns, theta_m_rad, current_A, self._motion[0]):
            self._take_finding(monitor.finding, received_ns)

    def open(self, now_ns: int) -> None:
        """Open at the measured angle, also anew; a gate that is frozen or latched stays so."""
        low, high = self._bounds
        is_well = low <= self._theta_rad <= high and now_ns - self._received_ns <= self._max_age_ns
        self._turn(GateEvent.OPENED if is_well else GateEvent.REFUSED)
        if self.state is not _OPEN:
            return
        self._motion = (self._theta_rad, 0.0, 0.0)
        self._time_ns, self._has_output, self.trip = now_ns, False, None
        if self._window is not None:
            self._window.restart()
        if self._monitor is not None:
            self._monitor.restart(self._stamp_ns, self._theta_rad)

    def clear(self) -> None:
        """Take back a latch: the gate is closed then, and wants to be opened."""
        self._turn(GateEvent.CLEARED)

    def step(self, requested_rad: float, now_ns: int) -> tuple[float | None, GateVerdict]:
        """Return the reference that may leave (None: none may), and why."""
        is_open = self.state is _OPEN
        if not is_open:
            if not self._may_hold(now_ns):
                return None, GateVerdict.DENIED_CLOSED if self.state is _CLOSED else GateVerdict.DENIED_LATCHED
            requested_rad = self._hold_rad
        since_ns = now_ns - self._time_ns
        if not (
            self._has_output <= since_ns <= self._max_gap_ns  # the first output may come at the instant of opening
            and self._is_fresh
            and now_ns - self._received_ns <= self._max_age_ns
            and _is_finite(requested_rad)
        ):
            return None, self._deny(since_ns, now_ns)
        dt_s = min(since_ns, self._max_step_ns) * 1e-9
        if self._window is not None:
            verdict = self._move_within_window(self._window, requested_rad, dt_s, now_ns)
        elif self._has_output:
            self._motion, verdict = self._limit(self._motion, requested_rad, dt_s, self._bounds)
        else:
            verdict = GateVerdict.OPENED
        self._is_fresh, self._has_output, self._time_ns = False, True, now_ns
        return self._motion[0], verdict if is_open else GateVerdict.FROZEN

    def follow(self, period_ns: int, theta_m_rad: Vector, current_A: Vector, requested_rad: Vector) -> int:
        """Take samples and requests by turns, all `period_ns` apart, as long as the requests simply pass.

        Return how many did; 0 where none does. The gate is as if `see` and `step` had been called for each of them at
        the sample's own time. The caller goes on with `see` and `step`: a sample that was taken here is not new there.
        """
        limiter = self._limiter
        if self.state is not _OPEN or self._window is not None or not isinstance(limiter, AccelerationLimiter):
            return 0
        if not (self._has_output and self._time_ns == self._stamp_ns == self._received_ns):
            return 0
        if not 0 < period_ns <= self._max_gap_ns:
            return 0
        begin_ns, before, dt_s = self._time_ns, self._motion, min(period_ns, self._max_step_ns) * 1e-9
        passed, motion = limiter.passing(before, requested_rad, dt_s, self._bounds)
        taken, finding = passed, None
        if self._monitor is not None:
            may = self._monitor.samples_without_jump(period_ns, theta_m_rad[:passed])
            references = [before[0], *requested_rad[:may].tolist()]  # of each sample, the one before it
            taken = self._monitor.follow(period_ns, theta_m_rad[:may].tolist(), current_A[:may].tolist(), references)
            finding = self._monitor.finding
        if taken == 0:
            return 0
        answered = taken if finding is None else taken - 1
        if answered < passed:
            _, motion = limiter.passing(before, requested_rad[:answered], dt_s, self._bounds)
        self._motion, self._time_ns = motion, begin_ns + answered * period_ns
        self._stamp_ns = self._received_ns = begin_ns + taken * period_ns
        self._theta_rad, self._is_fresh = float(theta_m_rad[taken - 1]), answered < taken
        if finding is not None:
            self._take_finding(finding, self._received_ns)
        return answered

    def _may_hold(self, now_ns: int) -> bool:
        """Tell whether the reference is held; latch where that took too long."""
        if self.state is _CLOSED or self.state is _LATCHED:
            return False
        if now_ns - self._frozen_ns > self._hold_ns:
            self._turn(GateEvent.HELD_TOO_LONG)
        return self.state is not _LATCHED

    def _deny(self, since_ns: int, now_ns: int) -> GateVerdict:
        """Return why nothing leaves; too long a time without output closes the gate, or latches it."""
        if since_ns < self._has_output:
            return GateVerdict.DENIED_TIME
        if since_ns > self._max_gap_ns:
            if self.state is _OPEN:  # a gate that is frozen keeps what froze it
                self.trip = GateTrip(GAP, since_ns * 1e-9, self._max_gap_ns * 1e-9, "s", now_ns)
            self._turn(GateEvent.GAP)
            return GateVerdict.DENIED_GAP
        if not self._is_fresh or now_ns - self._received_ns > self._max_age_ns:
            return GateVerdict.DENIED_STALE
        return GateVerdict.DENIED_NOT_FINITE

    def _move_within_window(self, window: TravelWindow, requested_rad: float, dt_s: float, now_ns: int) -> GateVerdict:
        """Move the reference as its travel within 250 ms allows, too."""
        verdict = GateVerdict.OPENED
        if self._has_output:
            before = self._motion
            self._motion, verdict = self._limit(before, requested_rad, dt_s, window.narrow(self._bounds, now_ns))
            # It is the window's doing where the position alone would limit nothing.
            if verdict is _POSITION and self._limit(before, requested_rad, dt_s, self._bounds)[1] is not _POSITION:
                verdict = GateVerdict.LIMITED_WINDOW
        window.see(self._motion[0], now_ns)
        return verdict

    def _take_finding(self, finding: Finding | None, received_ns: int) -> None:
        was_open = self.state is _OPEN
        if finding is None:
            self._turn(GateEvent.RECOVERED)
            if self.state is _OPEN:
                self.trip = None
            return
        is_worse = finding[0] in IMPLAUSIBLE and self.state is GateState.FROZEN
        self._turn(GateEvent.IMPLAUSIBLE if finding[0] in IMPLAUSIBLE else GateEvent.EXCEEDED)
        if was_open:
            self._frozen_ns, self._hold_rad = received_ns, self._motion[0]
        if was_open or is_worse:
            self.trip = trip_of(finding, received_ns)

    def _turn(self, event: GateEvent) -> None:
        self.state = TRANSITIONS[self.state][event]


def _check(limits: Limits, max_gap_s: float, max_step_s: float) -> None:
    low, high, jerk, travel = (
        limits.position_min_rad,
        limits.position_max_rad,
        limits.jerk_max_rad_per_s3,
        limits.window_travel_max_rad,
    )
    positive = [limits.speed_max_rad_per_s, limits.acceleration_max_rad_per_s2, max_gap_s, max_step_s]
    positive += [each for each in (jerk, travel) if each is not None]
    if not (all(map(math.isfinite, (low, high, *positive))) and low < high and min(positive) > 0.0):
        raise ValueError(f"not limits of a gate: {limits!r}, max_gap_s={max_gap_s!r}, max_step_s={max_step_s!r}")
