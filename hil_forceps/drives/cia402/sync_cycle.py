"""SYNC and the two frames that answer it: which SYNC a sample belongs to. Pure.

Nothing in an answer says which SYNC it answers. So no further SYNC is sent before both frames of the last have come: on
a path that takes longer than a period samples come at a lower rate, with stamps that are true. What doesn't come within
`ANSWER_NS` is given up; that is longer than the latency timers of serial adapters, 16 ms.
"""

from typing import Final, NamedTuple

ANSWER_NS: Final = 50_000_000


class Latched(NamedTuple):
    """What a drive latched at one SYNC."""

    counts: int
    stamp_ns: int  # when SYNC was sent


class SyncCycle:
    """At most one SYNC without its answer."""

    def __init__(self, counters: dict[str, int]) -> None:
        """`counters`: those of the profile, with the names of `COUNTERS` among them."""
        self._counters = counters
        self._sync_ns: int | None = None  # of the SYNC that waits for its answer
        self._counts: int | None = None

    def poll(self, now_ns: int) -> bool:
        """Tell whether SYNC is to be sent now; if so it counts as sent."""
        if self._sync_ns is not None and now_ns - self._sync_ns < ANSWER_NS:
            self._counters["syncs_withheld"] += 1
            return False
        if self._sync_ns is not None:
            self._counters["syncs_unanswered"] += 1
        self._sync_ns, self._counts = now_ns, None
        self._counters["syncs_sent"] += 1
        return True

    def see_position(self, counts: int) -> None:
        """Take the first frame of an answer."""
        if self._sync_ns is None or self._counts is not None:
            self._counters["unpaired"] += 1
        if self._sync_ns is not None:
            self._counts = counts

    def see_current(self) -> Latched | None:
        """Take the second frame, which ends the answer; None where the first didn't come."""
        sync_ns, counts = self._sync_ns, self._counts
        self._sync_ns = self._counts = None
        if sync_ns is None or counts is None:
            self._counters["unpaired"] += 1
            return None
        return Latched(counts, sync_ns)


COUNTERS: Final = ("syncs_sent", "syncs_withheld", "syncs_unanswered", "unpaired")
