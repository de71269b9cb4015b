"""The limit gate: the last stage before a reference leaves. Nothing passes unless the gate is open and all is well.

What passes, passes unchanged, or moved as little as the limits ask. With Δt the time between two outputs and
v = Δθ/Δt the speed of the later, for any requests and any times:

- position_min ≤ θ ≤ position_max,
- |v| ≤ speed_max,
- |v − v_before| ≤ acceleration_max·Δt,
- there is always room to brake: v² / (2 acceleration_max) ≤ distance to the bound ahead.

The last makes the others possible for ever: braking by acceleration_max·Δt at each step covers a lower Riemann sum of
the continuous braking, so never more than v²/(2a), whatever the steps. The bounds hold exactly, all else up to the
rounding of floats.

A gate is closed until `open` is given a measured angle within the bounds, and its first output is that angle. It
closes when more than `max_gap_s` lies between two outputs, and stays closed until it is opened again.
"""

import math
from enum import Enum
from typing import NamedTuple

from hil_forceps.rig.sections import Limits

# The drive's own watchdog has ended the run by then; whoever comes back after it has to start anew.
DEFAULT_MAX_GAP_S = 0.02


class GateVerdict(Enum):
    """What the gate did; the values name its counters."""

    OPENED = "opened"  # first output: the measured angle
    PASSED = "passed"  # exactly what was requested
    LIMITED_POSITION = "limited_position"  # a bound, or the room to brake before it
    LIMITED_SPEED = "limited_speed"
    LIMITED_ACCELERATION = "limited_acceleration"
    DENIED_CLOSED = "denied_closed"  # not open; or opened with an angle that isn't within the bounds
    DENIED_NOT_FINITE = "denied_not_finite"
    DENIED_TIME = "denied_time"  # time did not increase
    DENIED_GAP = "denied_gap"  # too long since the last output: the gate has closed


class GateState(NamedTuple):
    """What the gate remembers: its last output."""

    is_open: bool
    has_output: bool  # False from opening to the first output
    position_rad: float
    speed_rad_per_s: float
    time_ns: int


_Step = tuple[GateState, float | None, GateVerdict]

CLOSED = GateState(is_open=False, has_output=False, position_rad=0.0, speed_rad_per_s=0.0, time_ns=0)


class Gate:
    """The limits; `open` and `step` are pure."""

    __slots__ = ("_acceleration", "_low", "_high", "_max_gap_ns", "_speed")  # noqa: RUF023 - low before high

    def __init__(self, limits: Limits, max_gap_s: float = DEFAULT_MAX_GAP_S) -> None:
        """Take the limits; ValueError unless speed, acceleration and gap are positive and the bounds in order."""
        self._low, self._high = limits.position_min_rad, limits.position_max_rad
        self._speed, self._acceleration = limits.speed_max_rad_per_s, limits.acceleration_max_rad_per_s2
        numbers = (self._low, self._high, self._speed, self._acceleration, max_gap_s)
        if not (all(map(math.isfinite, numbers)) and self._low < self._high and min(numbers[2:]) > 0.0):
            raise ValueError(f"not limits of a gate: {limits!r}, max_gap_s={max_gap_s!r}")
        self._max_gap_ns = round(max_gap_s * 1e9)

    @property
    def range_rad(self) -> float:
        """How far the bounds lie apart."""
        return self._high - self._low

    def open(self, theta_m_rad: float, now_ns: int) -> GateState:
        """Return the state of a gate opened at the measured angle; closed when that isn't within the bounds."""
        if not self._low <= theta_m_rad <= self._high:
            return CLOSED
        return GateState(True, False, theta_m_rad, 0.0, now_ns)

    def step(self, state: GateState, requested_rad: float, now_ns: int) -> _Step:
        """Return the next state, the reference that may leave (None: none may), and why."""
        is_open, has_output, position, speed, time_ns = state
        if not is_open:
            return state, None, GateVerdict.DENIED_CLOSED
        since_ns = now_ns - time_ns
        if since_ns < has_output:  # the first output may come at the instant of opening
            return state, None, GateVerdict.DENIED_TIME
        if since_ns > self._max_gap_ns:
            return CLOSED, None, GateVerdict.DENIED_GAP
        if not math.isfinite(requested_rad):
            return state, None, GateVerdict.DENIED_NOT_FINITE
        if not has_output:
            return GateState(True, True, position, 0.0, now_ns), position, GateVerdict.OPENED
        return self._limit(position, speed, requested_rad, since_ns * 1e-9, now_ns)

    def _limit(self, position: float, speed: float, requested: float, dt_s: float, now_ns: int) -> _Step:
        change = self._acceleration * dt_s
        wanted = (requested - position) / dt_s
        ahead = self._high - position if wanted > 0.0 else position - self._low
        stoppable = self._stoppable_speed(ahead, dt_s)
        magnitude = abs(wanted)
        # Beside a bound of 1e-252 a distance rounds to nothing; the bounds hold exactly.
        if magnitude > stoppable or not self._low <= requested <= self._high:
            verdict = GateVerdict.LIMITED_POSITION
        elif magnitude > self._speed:
            verdict = GateVerdict.LIMITED_SPEED
        elif abs(wanted - speed) > change:
            verdict = GateVerdict.LIMITED_ACCELERATION
        else:
            return GateState(True, True, requested, wanted, now_ns), requested, GateVerdict.PASSED
        # A request out of reach is approached so that it could be stopped at, or the output would swing about it.
        towards = min(magnitude, stoppable, self._speed, self._stoppable_speed(abs(requested - position), dt_s))
        # What the speed is now comes last: no other limit can ask for more braking than the acceleration allows.
        allowed = max(speed - change, min(speed + change, math.copysign(towards, wanted)))
        limited = max(self._low, min(self._high, position + allowed * dt_s))
        return GateState(True, True, limited, allowed, now_ns), limited, verdict

    def _stoppable_speed(self, room_rad: float, dt_s: float) -> float:
        """Return the greatest v that after a step v·dt still can brake within the room: v dt + v²/(2a) = room."""
        # The textbook root −a dt + √(a² dt² + 2 a room) cancels when a is great; this is the same number.
        return 2.0 * room_rad / (dt_s + math.sqrt(dt_s * dt_s + 2.0 * room_rad / self._acceleration))
