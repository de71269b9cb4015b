"""The angle of a motor over many turns, from one that a VESC tells within a turn.

Between two answers the motor is taken to turn no further than at `speed_rev_per_s` for the time between them and two
periods more, since arrivals jitter, and two counts of the encoder. A step beyond that is no angle of this motor. Where
the bound itself comes to half a turn, the turns can't be counted any more.
"""

import math
from typing import Final, NamedTuple

_HALF_TURN_REV: Final = 0.5
REACH_MARGIN_PERIODS: Final = 2
_REACH_MARGIN_COUNTS: Final = 2


class TurnsConfig(NamedTuple):
    """All in turns of the angle that the VESC tells."""

    low_rev: float  # the motor starts between these
    high_rev: float
    speed_rev_per_s: float
    period_ns: int  # between answers
    count_rev: float  # of the encoder


class Turns:
    """Counts the turns."""

    def __init__(self, config: TurnsConfig) -> None:
        self.config = config
        self.angle_rev: float | None = None  # the last one
        self._at_ns = 0

    def starts(self, within_rev: float) -> list[float]:
        """Return where the motor may be, seen for the first time; where it can't be between the limits, the nearest."""
        low, high = self.config.low_rev, self.config.high_rev
        first, last = math.ceil(low - within_rev), math.floor(high - within_rev)
        if first > last:
            first = last = round((low + high) / 2.0 - within_rev)
        return [within_rev + turn for turn in range(first, min(last, first + 1) + 1)]

    def start(self, angle_rev: float, at_ns: int) -> None:
        """Begin to count here."""
        self.angle_rev, self._at_ns = angle_rev, at_ns

    def reach_rev(self, at_ns: int) -> float:
        """Return how far the motor can have come since the last angle."""
        since_ns = max(at_ns - self._at_ns, 0) + REACH_MARGIN_PERIODS * self.config.period_ns
        return self.config.speed_rev_per_s * since_ns * 1e-9 + _REACH_MARGIN_COUNTS * self.config.count_rev

    def is_lost(self, at_ns: int) -> bool:
        """Tell whether the turns can't be counted any more."""
        return self.reach_rev(at_ns) >= _HALF_TURN_REV

    def follow(self, within_rev: float, at_ns: int) -> float | None:
        """Return the angle; None where it is further away than the motor can have come."""
        if self.angle_rev is None or self.is_lost(at_ns):
            return None
        step_rev = (within_rev - self.angle_rev + _HALF_TURN_REV) % 1.0 - _HALF_TURN_REV
        if abs(step_rev) > self.reach_rev(at_ns):
            return None
        self.start(self.angle_rev + step_rev, at_ns)
        return self.angle_rev
