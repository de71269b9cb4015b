"""Which references from outside count, and until when. Pure: datagrams and times in, a reference out.

WAITING    nobody sends; a sender that knows the session takes the axis
FOLLOWING  its newest reference is in force, and held until the next

A reference is as old as its stamp says. The two clocks are told apart by the datagram that was least under way
(`StampMap`), so what counts is how much longer than that one it took. One that is older than `timeout_ns` when it comes
is refused. When the newest accepted one has become older than that, the axis has lost its references: a run with torque
ends then, one without waits for a sender again.
"""

import math
from collections.abc import Hashable
from enum import IntEnum
from typing import Final

from hil_forceps.bridge.statistics import StampMap
from hil_forceps.bridge.teleoperation.datagrams import ReferenceDatagram, Verdict, is_usable

SEQUENCE_MODULUS: Final = 1 << 32
FIRST_OLD_ADVANCE: Final = 1 << 31  # a number so far ahead, or further, is taken for one from before


class InputState(IntEnum):
    """Whether references come; the numbers stand in the answers."""

    WAITING = 0
    FOLLOWING = 1


class ReferenceInput:
    """The references of one axis. `session` is the run's own number, which none before it had."""

    def __init__(self, session: int, timeout_ns: int) -> None:
        if not 0 < session < 1 << 64 or timeout_ns <= 0:
            raise ValueError(f"session {session}, timeout {timeout_ns} ns: both must be positive")
        self.session = session
        self.timeout_ns = timeout_ns
        self.state = InputState.WAITING
        self.theta_j_ref_rad = math.nan  # in force
        self.counters = {"accepted": 0, "missing": 0, **{each.name.lower(): 0 for each in Verdict if each}, "lost": 0}
        self._sender: Hashable = None
        self._sequence = 0
        self._sent_ns = 0  # of the newest accepted, by the host's clock
        self._clock = StampMap()

    def __call__(self, _t_s: float) -> float:
        """Return the reference in force [rad], as a trajectory does of its time; NaN while nobody sends."""
        return self.theta_j_ref_rad

    def take(self, reference: ReferenceDatagram, sender: Hashable, now_ns: int) -> Verdict:
        """Take a datagram that came at `now_ns` from `sender`; return what became of it."""
        verdict = self._judged(reference, sender, now_ns)
        self.counters[verdict.name.lower()] += 1
        return verdict

    def age_ns(self, now_ns: int) -> int:
        """Return how old the reference in force is."""
        return now_ns - self._sent_ns

    def is_lost(self, now_ns: int) -> bool:
        """Tell whether the references have stayed away for too long."""
        return self.state is InputState.WAITING or self.age_ns(now_ns) > self.timeout_ns

    def release(self, now_ns: int) -> None:
        """Wait for a sender again where the one before has fallen silent; for a run without torque."""
        if self.state is InputState.FOLLOWING and self.is_lost(now_ns):
            self.counters["lost"] += 1
            self.state, self.theta_j_ref_rad, self._sender = InputState.WAITING, math.nan, None

    def words(self, now_ns: int) -> str:
        """Return how the references were lost."""
        return (
            f"no external reference: the newest is {self.age_ns(now_ns) / 1e6:.0f} ms old, "
            f"the limit is {self.timeout_ns / 1e6:.0f} ms"
        )

    def _judged(self, reference: ReferenceDatagram, sender: Hashable, now_ns: int) -> Verdict:
        is_first = self.state is InputState.WAITING
        ahead = 1 if is_first else (reference.sequence - self._sequence) % SEQUENCE_MODULUS
        refusals = (
            (reference.session != self.session, Verdict.WRONG_SESSION),
            (not is_first and sender != self._sender, Verdict.OTHER_SENDER),
            (not is_usable(reference), Verdict.NOT_FINITE),
            (ahead == 0, Verdict.DUPLICATE),
            (ahead >= FIRST_OLD_ADVANCE, Verdict.REORDERED),
        )
        for is_so, verdict in refusals:
            if is_so:
                return verdict
        if is_first and sender != self._sender:
            self._sender, self._clock = sender, StampMap()
        self._clock.see(reference.stamp_ns, now_ns)
        sent_ns = min(self._clock.host_time_ns(reference.stamp_ns), now_ns)
        if now_ns - sent_ns > self.timeout_ns:
            return Verdict.STALE
        self.counters["missing"] += ahead - 1
        self.state, self.theta_j_ref_rad = InputState.FOLLOWING, reference.theta_j_ref_rad
        self._sequence, self._sent_ns = reference.sequence, sent_ns
        return Verdict.ACCEPTED
