"""SYNC and the two frames that answer it: which SYNC a sample belongs to, of one drive or of all on a bus. Pure.

Nothing in an answer says which SYNC it answers. So no further SYNC is sent before every drive has answered the last
with both frames: on a path that takes longer than a period samples come at a lower rate, with stamps that are true.
What doesn't come within `ANSWER_NS` is given up, and where other drives wait for the next SYNC within
`SHARED_ANSWER_NS`: both are longer than the latency timers of serial adapters, 16 ms.

A drive that misses `MAX_MISSES` in a row does not hold up the others any longer: SYNCs go on without it, and what it
still says is dropped, for it can't be told which of them it answers.
"""

from typing import Final, NamedTuple

from hil_forceps.drives.supervision.answer_count import AnswerCount

ANSWER_NS: Final = 50_000_000
SHARED_ANSWER_NS: Final = 20_000_000  # missed `MAX_MISSES` times it takes less than half of a watchdog of 100 ms
MAX_MISSES: Final = 2  # one lost frame makes one


class Latched(NamedTuple):
    """What a drive latched at one SYNC."""

    counts: int
    stamp_ns: int  # when SYNC was sent


class SharedSync:
    """The SYNCs of one bus, which serve all of its drives: at most one goes out in a tick."""

    def __init__(self) -> None:
        self.cycles: list[SyncCycle] = []
        self._sent_ns: int | None = None

    def poll(self, now_ns: int) -> bool:
        """Tell whether SYNC is to be sent now; if so it counts as sent, to every drive that takes part."""
        taking_part = [cycle for cycle in self.cycles if cycle.takes_part]
        in_step = [cycle for cycle in taking_part if cycle.misses < MAX_MISSES] or taking_part
        longest_ns = ANSWER_NS if len(taking_part) == 1 else SHARED_ANSWER_NS
        if any(cycle.waits(now_ns, longest_ns) for cycle in in_step):
            return False
        self._sent_ns = now_ns
        for cycle in taking_part:
            cycle.begin(now_ns, is_in_step=cycle in in_step)
        return True

    def is_out(self, now_ns: int) -> bool:
        """Tell whether this tick's SYNC has been sent already, by another drive's machine."""
        return self._sent_ns == now_ns


class SyncCycle:
    """One drive's answers; of every SYNC that goes out on its bus while it takes part, at most one is waited for."""

    def __init__(self, counters: dict[str, int], shared: SharedSync) -> None:
        """`counters`: those of the profile, with the names of `COUNTERS` among them."""
        self.takes_part = False
        self.misses = 0  # SYNCs in a row that it didn't answer
        self._counters = counters
        self._shared = shared
        self._sync_ns: int | None = None  # of the SYNC that waits for its answer
        self._counts: int | None = None
        self._may_answer_early = False
        self.answers = AnswerCount()
        shared.cycles.append(self)

    def poll(self, now_ns: int) -> bool:
        """Tell whether SYNC is to be sent now; if so it counts as sent. The drive takes part from now on."""
        is_out = self._shared.is_out(now_ns)
        if not self.takes_part:
            self._may_answer_early = is_out  # the drive has just been started, and may have heard this one or not
        self.takes_part = True
        if is_out:
            return False
        is_sent = self._shared.poll(now_ns)
        self._counters["syncs_withheld"] += not is_sent
        return is_sent

    def rest(self) -> None:
        """Take no part: the drive isn't set up, or not any more."""
        self.takes_part, self.misses, self._sync_ns, self._counts = False, 0, None, None

    def waits(self, now_ns: int, longest_ns: int) -> bool:
        """Tell whether the last SYNC may still be answered."""
        return self._sync_ns is not None and now_ns - self._sync_ns < longest_ns

    def begin(self, now_ns: int, *, is_in_step: bool) -> None:
        """Take note of a SYNC; where the drive isn't in step, of one whose answer can't be told from others'."""
        if self._sync_ns is not None:
            self._counters["syncs_unanswered"] += 1
            self.misses += 1
        self._sync_ns, self._counts = now_ns if is_in_step else None, None
        self._may_answer_early = False
        self._counters["syncs_sent"] += 1
        self.answers.ask()

    def see_position(self, counts: int) -> None:
        """Take the first frame of an answer."""
        self.answers.answer()
        if self._sync_ns is None or self._counts is not None:
            self._counters["unpaired"] += not self._may_answer_early
        if self._sync_ns is not None:
            self._counts = counts

    def see_current(self) -> Latched | None:
        """Take the second frame, which ends the answer; None where the first didn't come."""
        sync_ns, counts = self._sync_ns, self._counts
        self._sync_ns = self._counts = None
        if sync_ns is None or counts is None:
            self._counters["unpaired"] += not self._may_answer_early
            return None
        self.misses = 0
        return Latched(counts, sync_ns)


COUNTERS: Final = ("syncs_sent", "syncs_withheld", "syncs_unanswered", "unpaired")
