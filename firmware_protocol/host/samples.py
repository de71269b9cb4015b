"""The host's ordered view of what a drive measured: halves paired, stamps and angles unwrapped, nothing old twice."""

from typing import Final, NamedTuple, TypeVar

from firmware_protocol.frames import make
from firmware_protocol.messages import BenchSensor, DriveState, FdFeedback, Feedback, Timing
from firmware_protocol.scales import STAMP_LSB_NS
from firmware_protocol.states import MAX_SEQUENCE_ADVANCE

MAX_PENDING_HALVES: Final = 8  # halves of one kind that wait for their partners
MAX_STAMP_GAP_US: Final = 60_000_000  # further apart, and the stamps are not of one run of the drive
MAX_QUEUED_SAMPLES: Final = 4096  # and as many readings of the bench

SAMPLE_COUNTERS: Final = (
    "samples",
    "lost_feedback",
    "stale_feedback",
    "unpaired",
    "unknown_state",
    "drive_restarted",
    "samples_overflow",
    "bench_samples",
    "stale_bench",
    "bench_overflow",
)

_MASK32: Final = (1 << 32) - 1
_HALF32: Final = 1 << 31
_LAST_STATE: Final = int(max(DriveState))

_Half = TypeVar("_Half", Feedback, Timing)


class RawSample(NamedTuple):
    """One measurement: angle unwrapped in 2**-24 rev, stamp unwrapped in ns of the drive's clock."""

    sequence: int
    stamp_ns: int
    theta_m: int
    current: int
    state: int
    fault: int
    setpoint_sequence: int  # last setpoint the drive had accepted by then
    received_ns: int  # host time at which the sample was whole


class RawBench(NamedTuple):
    """One reading of the bench sensors, in the wire's units."""

    sequence: int
    theta_j: int
    tau_w: int
    received_ns: int


class SampleAssembler:
    """FEEDBACK and TIMING in, each sample out once and in order; what is old, alone or implausible is counted."""

    def __init__(self, counters: dict[str, int]) -> None:
        self._counters = counters
        counters.update(dict.fromkeys(SAMPLE_COUNTERS, 0))
        self._queue: list[RawSample] = []
        self._bench: list[RawBench] = []
        self.reset()

    def reset(self) -> None:
        """Forget the drive: what comes next starts anew. What was delivered stays to be taken."""
        self.newest: RawSample | None = None  # delivered
        self.taken: RawSample | None = None  # the newest that the caller has got
        self.restarted = False  # the stamps jumped: this is not the run of the drive it was
        self._feedback: dict[int, Feedback] = {}
        self._timing: dict[int, Timing] = {}
        self._bench_sequence: int | None = None

    def take_samples(self) -> list[RawSample]:
        """Hand over the samples since the last call, oldest first."""
        queue, self._queue = self._queue, []
        if queue and self.newest is not None:
            self.taken = self.newest
        return queue

    def take_bench(self) -> list[RawBench]:
        """Hand over the bench readings since the last call, oldest first."""
        bench, self._bench = self._bench, []
        return bench

    def on_feedback(self, message: Feedback, now_ns: int) -> RawSample | None:
        """Take one half; return the sample when it is whole and new."""
        _, theta_m, current, sequence = message
        timing = self._timing.pop(sequence, None) if self._timing else None
        if timing is None:
            self._keep(self._feedback, sequence, message)
            return None
        return self._complete(theta_m, current, timing, now_ns)

    def on_timing(self, message: Timing, now_ns: int) -> RawSample | None:
        """Take the other half; return the sample when it is whole and new."""
        sequence = message[2]
        feedback = self._feedback.pop(sequence, None)
        if feedback is None:
            self._keep(self._timing, sequence, message)
            return None
        _, theta_m, current, _ = feedback
        return self._complete(theta_m, current, message, now_ns)

    def on_fd_feedback(self, message: FdFeedback, now_ns: int) -> RawSample | None:
        """Take a whole sample; return it when it is new."""
        node, theta_m, current, *timing = message
        if self._is_old(message.sequence):
            self._counters["stale_feedback"] += 1
            return None
        return self._complete(theta_m, current, make(Timing, (node, *timing)), now_ns)

    def on_bench(self, message: BenchSensor, now_ns: int) -> None:
        """Take one bench reading, unless it is old."""
        _, theta_j, tau_w, sequence = message
        last = self._bench_sequence
        if last is not None and not 1 <= (sequence - last) & 0xFF <= MAX_SEQUENCE_ADVANCE:
            self._counters["stale_bench"] += 1
            return
        self._bench_sequence = sequence
        self._counters["bench_samples"] += 1
        bench = self._bench
        bench.append(make(RawBench, (sequence, theta_j, tau_w, now_ns)))
        if len(bench) > MAX_QUEUED_SAMPLES:
            del bench[0]
            self._counters["bench_overflow"] += 1

    def _is_old(self, sequence: int) -> bool:
        newest = self.newest
        return newest is not None and not 1 <= (sequence - newest[0]) & 0xFF <= MAX_SEQUENCE_ADVANCE

    def _keep(self, pending: dict[int, _Half], sequence: int, half: _Half) -> None:
        """Let a half wait. An old one must not: 256 samples on, it would pair with a stranger."""
        newest = self.newest
        if newest is not None and not 1 <= (sequence - newest[0]) & 0xFF <= MAX_SEQUENCE_ADVANCE:  # as `_is_old`
            self._counters["stale_feedback"] += 1
            return
        pending[sequence] = half
        if len(pending) > MAX_PENDING_HALVES:
            del pending[next(iter(pending))]
            self._counters["unpaired"] += 1

    def _complete(self, theta_m: int, current: int, timing: Timing, now_ns: int) -> RawSample | None:
        """Deliver a whole sample that is not old (halves were judged when they came)."""
        _, stamp_us, sequence, setpoint_sequence, state, fault = timing
        if state > _LAST_STATE:
            self._counters["unknown_state"] += 1
            return None
        newest = self.newest
        if newest is None:
            stamp_ns = stamp_us * STAMP_LSB_NS
        else:
            before, before_ns, before_theta, *_ = newest
            gap_us = (stamp_us - before_ns // STAMP_LSB_NS) & _MASK32
            if not 0 < gap_us <= MAX_STAMP_GAP_US:
                self._counters["drive_restarted"] += 1
                self.restarted = True
                return None
            lost = (sequence - before - 1) & 0xFF
            if lost:
                self._counters["lost_feedback"] += lost
            stamp_ns = before_ns + gap_us * STAMP_LSB_NS
            theta_m = before_theta + ((theta_m - before_theta + _HALF32) & _MASK32) - _HALF32
        fields = (sequence, stamp_ns, theta_m, current, state, fault, setpoint_sequence, now_ns)
        self.newest = sample = make(RawSample, fields)
        self._counters["samples"] += 1
        queue = self._queue
        queue.append(sample)
        if len(queue) > MAX_QUEUED_SAMPLES:
            del queue[0]
            self._counters["samples_overflow"] += 1
        if self._feedback or self._timing:
            self._purge(self._feedback)
            self._purge(self._timing)
        return sample

    def _purge(self, pending: dict[int, _Half]) -> None:
        """Give up the halves that are older than the sample just delivered."""
        for sequence in [s for s in pending if self._is_old(s)]:
            del pending[sequence]
            self._counters["unpaired"] += 1
