"""Times of events, in order."""

from bisect import bisect_right
from collections.abc import Sequence
from typing import Final

MS: Final = 1_000_000


def newest(times_ns: Sequence[int], now_ns: int) -> int:
    """Return the last of some times that isn't later than now; 0 before the first."""
    place = bisect_right(times_ns, now_ns)
    return times_ns[place - 1] if place else 0
