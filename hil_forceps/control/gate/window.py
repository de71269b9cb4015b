"""How far the reference has moved lately: its least and greatest angle within 250 ms of real time.

The time goes in sixteen parts, so memory is bounded; a part counts until all of it is past, so at worst the window is a
sixteenth longer than it says.
"""

from collections import deque
from typing import Final

from hil_forceps.control.gate.verdicts import Bounds

WINDOW_NS: Final = 250_000_000  # the real time over which other people's gates of actuators bound a command's travel
WINDOW_PARTS: Final = 16
_PART_NS: Final = WINDOW_NS // WINDOW_PARTS


class TravelWindow:
    """Between which angles the reference may be so that within the window it travels `travel_max_rad` at most."""

    __slots__ = ("_parts", "_travel_max_rad")

    def __init__(self, travel_max_rad: float) -> None:
        self._travel_max_rad = travel_max_rad
        self._parts: deque[tuple[int, float, float]] = deque(maxlen=WINDOW_PARTS + 1)  # number, least, greatest

    def restart(self) -> None:
        """Forget all."""
        self._parts.clear()

    def see(self, position_rad: float, now_ns: int) -> None:
        """Take the reference that leaves now."""
        number = now_ns // _PART_NS
        least = greatest = position_rad
        if self._parts and self._parts[-1][0] == number:
            _, least, greatest = self._parts.pop()
        self._parts.append((number, min(least, position_rad), max(greatest, position_rad)))

    def narrow(self, bounds: Bounds, now_ns: int) -> Bounds:
        """Return the bounds as far as the travel allows."""
        first = (now_ns - WINDOW_NS) // _PART_NS
        recent = [part for part in self._parts if part[0] >= first]
        if not recent:
            return bounds
        least, greatest = min(part[1] for part in recent), max(part[2] for part in recent)
        low, high = bounds
        return max(low, greatest - self._travel_max_rad), min(high, least + self._travel_max_rad)
