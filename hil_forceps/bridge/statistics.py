"""Where the time goes: bounded histograms of the loop, and the drive's stamps seen on the host's clock.

Three durations are kept, all in ns of the host's clock:

period    from the start of one tick to the start of the next.
lateness  from the instant a tick was due to the instant it started.
age       from the instant a sample was taken to the instant its reference was handed to the link:
          `t_sent - (stamp + offset)`, `offset` as `StampMap` sees it. Where the drive's stamps are known to come from
          the host's own clock (virtual time, or the simulated drive on the same machine) the offset is exact and so
          is the age. Elsewhere the offset is the least one-way delay seen lately, so the age leaves out just that:
          the time on the wire and in the adapter that no frame of the window beat. The way of the reference to the
          drive comes on top.
"""

import math
from array import array
from itertools import accumulate
from typing import Final, NamedTuple, TypedDict

from firmware_protocol.scales import STAMP_LSB_NS, STAMP_MODULUS

STAMP_PERIOD_NS: Final = STAMP_MODULUS * STAMP_LSB_NS


class HistogramSummary(TypedDict):
    """A histogram as JSON; times in µs, `bins` are `[lower edge, count]` of the bins that aren't empty."""

    count: int
    mean_us: float | None
    p50_us: float | None
    p99_us: float | None
    max_us: float | None
    above_range: int
    below_zero: int
    bin_us: float
    bins: list[tuple[float, int]]


class Histogram:
    """Counts of durations in bins of equal width, all memory taken at the start.

    What lies above the range is counted apart and still enters `max_ns`; a negative duration (two clocks that
    disagree) is counted apart and taken as zero. Percentiles are the upper edge of their bin, so at most one bin too
    long. In virtual time most durations are the one before again: these are only counted, and entered together.
    """

    def __init__(self, bin_ns: int = 1_000, bins: int = 20_000) -> None:
        if bin_ns <= 0 or bins <= 0:
            raise ValueError(f"a histogram needs bins: got {bins} of {bin_ns} ns")
        self.bin_ns = bin_ns
        self._total_ns = 0
        self._max_ns = 0
        self._below_zero = 0
        self._above_range = 0
        self._bins = array("Q", bytes(8 * bins))
        self._range_ns = bins * bin_ns
        self._last_ns = 0
        self._repeats = 0  # of the last duration, not yet entered

    @property
    def count(self) -> int:
        """How many durations there are."""
        self._enter()
        return sum(self._bins) + self._above_range

    @property
    def total_ns(self) -> int:
        """All durations together."""
        self._enter()
        return self._total_ns

    @property
    def max_ns(self) -> int:
        """The longest; 0 when there is none."""
        self._enter()
        return self._max_ns

    def add(self, duration_ns: int) -> None:
        """Count one duration."""
        if duration_ns == self._last_ns:
            self._repeats += 1
            return
        self._enter()
        self._last_ns, self._repeats = duration_ns, 1

    def _enter(self) -> None:
        duration_ns, times = self._last_ns, self._repeats
        self._repeats = 0
        if duration_ns < 0:
            self._below_zero += times
            duration_ns = 0
        if duration_ns > self._max_ns and times:
            self._max_ns = duration_ns
        self._total_ns += duration_ns * times
        if duration_ns < self._range_ns:
            self._bins[duration_ns // self.bin_ns] += times
        else:
            self._above_range += times

    def percentile_ns(self, share: float) -> int | None:
        """Return the duration that `share` (0 to 1) of all don't exceed; None when there is none."""
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"a share lies between 0 and 1, got {share}")
        if not self.count:
            return None
        needed = max(1, math.ceil(share * self.count))
        index = next((index for index, seen in enumerate(accumulate(self._bins)) if seen >= needed), None)
        return self.max_ns if index is None else min(self.max_ns, (index + 1) * self.bin_ns)

    def summary(self) -> HistogramSummary:
        """Return the figures and the histogram itself, ready for JSON."""
        count = self.count
        full = [(index * self.bin_ns / 1e3, count) for index, count in enumerate(self._bins) if count]
        return {
            "count": count,
            "mean_us": self.total_ns / count / 1e3 if count else None,
            "p50_us": _microseconds(self.percentile_ns(0.5)),
            "p99_us": _microseconds(self.percentile_ns(0.99)),
            "max_us": self.max_ns / 1e3 if count else None,
            "above_range": self._above_range,
            "below_zero": self._below_zero,
            "bin_us": self.bin_ns / 1e3,
            "bins": full,
        }


class LoopStatistics(NamedTuple):
    """The histograms of a loop; the age is an axis's own."""

    period: Histogram
    lateness: Histogram

    def summary(self) -> dict[str, HistogramSummary]:
        """Return them, ready for JSON."""
        return {name: histogram.summary() for name, histogram in zip(self._fields, self, strict=True)}


def make_loop_statistics() -> LoopStatistics:
    """Return empty histograms: 1 µs wide up to 20 ms."""
    return LoopStatistics(Histogram(), Histogram())


class StampMap:
    """Maps the drive's stamps to the host's clock.

    `offset` is the least `received - stamp` of the last one to two windows of samples: the two clocks may drift, and
    the path with the least delay tells them apart best. A drive clock slower by d ppm makes an age too long by at
    most d · 2 windows (50 ppm, 1 kHz: 6 µs), and one that steps back makes it too long for so many samples; a
    faster one is followed at once. With `same_clock` stamps are the host's own time modulo the stamp's range, and the
    offset is a whole number of ranges, found at the first sample.
    """

    def __init__(self, window: int = 64, same_clock: bool = False) -> None:
        if window <= 0:
            raise ValueError(f"a window holds at least one sample, got {window}")
        self._window = window
        self._same_clock = same_clock
        self._left = 0  # samples until the window is full
        self._least: int | None = None
        self._least_before = 0

    def see(self, stamp_ns: int, received_ns: int) -> None:
        """Take note of one sample."""
        delay = received_ns - stamp_ns
        least = self._least
        if least is None:
            if self._same_clock:
                delay = (delay + STAMP_PERIOD_NS // 2) // STAMP_PERIOD_NS * STAMP_PERIOD_NS
            self._least = self._least_before = delay
            self._left = self._window
        elif self._same_clock:
            return
        elif self._left == 0:
            self._least_before = least
            self._least = delay
            self._left = self._window
        elif delay < least:
            self._least = delay
        self._left -= 1

    def host_time_ns(self, stamp_ns: int) -> int:
        """Return when, on the host's clock, a stamp was taken; ValueError before the first sample."""
        least = self._least
        if least is None:
            raise ValueError("no sample has been seen yet")
        return stamp_ns + (least if least < self._least_before else self._least_before)


def _microseconds(duration_ns: int | None) -> float | None:
    return None if duration_ns is None else duration_ns / 1e3
