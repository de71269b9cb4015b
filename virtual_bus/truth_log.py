"""What the world knows and no sensor says, kept for tests and for the figures of the bench."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from virtual_bus.plant.forceps import Truth


class TruthLog:
    """Truth at each feedback sample, for as many rows as it was made for; later rows are counted, not kept."""

    def __init__(self, capacity: int) -> None:
        if capacity < 0:
            raise ValueError(f"a truth log of {capacity} rows can't be")
        self._bus_time_ns = np.zeros(capacity, dtype=np.int64)
        self._stamp_ns = np.zeros(capacity, dtype=np.int64)
        self._truth = np.zeros((capacity, len(Truth._fields)))
        self.capacity = capacity
        self.observer: Callable[[int, Truth], None] | None = None  # sees every row, kept or not
        self.rows = 0
        self.dropped = 0

    def append(self, bus_time_ns: int, stamp_ns: int, truth: Truth) -> None:
        """Keep one row, or count it when the log is full."""
        if self.observer is not None:
            self.observer(bus_time_ns, truth)
        row = self.rows
        if row == self.capacity:
            self.dropped += 1
            return
        self._bus_time_ns[row] = bus_time_ns
        self._stamp_ns[row] = stamp_ns
        self._truth[row] = truth
        self.rows = row + 1

    def columns(self) -> dict[str, NDArray[np.int64] | NDArray[np.float64]]:
        """Return the rows so far as arrays: `bus_time_ns`, the drive's `stamp_ns` (unwrapped), and those of `Truth`."""
        times: dict[str, NDArray[np.int64] | NDArray[np.float64]] = {
            "bus_time_ns": self._bus_time_ns[: self.rows].copy(),
            "stamp_ns": self._stamp_ns[: self.rows].copy(),
        }
        return times | {name: self._truth[: self.rows, i].copy() for i, name in enumerate(Truth._fields)}
