"""The host's view of the measurements: pairing, order, unwrapping, counting (HFP-044, HFP-045, HFP-075)."""

import pytest

from firmware_protocol.host.samples import MAX_PENDING_HALVES, MAX_QUEUED_SAMPLES, RawBench, RawSample, SampleAssembler
from firmware_protocol.messages import BenchSensor, FdFeedback, Feedback, Timing

TURN = 1 << 32


class Wire:
    """Measurements number n, at n ms and n * 1000 units, as halves in any order."""

    def __init__(self) -> None:
        self.counters: dict[str, int] = {}
        self.assembler = SampleAssembler(self.counters)

    def feedback(self, n: int, theta: int | None = None) -> RawSample | None:
        theta_m = n * 1_000 if theta is None else theta
        wire = (theta_m + TURN // 2) % TURN - TURN // 2
        return self.assembler.on_feedback(Feedback(1, wire, -n % 100, n & 0xFF), n)

    def timing(self, n: int, stamp: int | None = None, state: int = 2) -> RawSample | None:
        stamp_us = n * 1_000 if stamp is None else stamp
        return self.assembler.on_timing(Timing(1, stamp_us % TURN, n & 0xFF, 7, state, 0), n)

    def whole(self, n: int, theta: int | None = None, stamp: int | None = None) -> RawSample | None:
        self.feedback(n, theta)
        return self.timing(n, stamp)

    def numbers(self) -> list[int]:
        return [sample.stamp_ns // 1_000_000 for sample in self.assembler.take_samples()]

    def counted(self) -> dict[str, int]:
        return {name: count for name, count in self.counters.items() if count}


def test_halves_make_a_whole_in_either_order() -> None:
    wire = Wire()
    assert wire.feedback(5) is None
    assert wire.timing(5) == RawSample(5, 5_000_000, 5_000, 95, 2, 0, 7, 5)
    assert wire.timing(6) is None
    assert wire.feedback(6) == RawSample(6, 6_000_000, 6_000, 94, 2, 0, 7, 6)
    assert wire.numbers() == [5, 6]
    assert wire.numbers() == []
    assert wire.counted() == {"samples": 2}


def test_an_fd_frame_is_a_whole() -> None:
    wire = Wire()
    message = FdFeedback(1, 5, 6, 7, 8, 9, 2, 0)
    assert wire.assembler.on_fd_feedback(message, 3) == RawSample(8, 7_000, 5, 6, 2, 0, 9, 3)
    assert wire.assembler.on_fd_feedback(message, 4) is None
    assert wire.assembler.on_fd_feedback(message._replace(sequence=7, stamp_us=6), 4) is None
    assert wire.counted() == {"samples": 1, "stale_feedback": 2}


@pytest.mark.parametrize("base", [0, 100, 200, 255])
@pytest.mark.parametrize(
    ("advance", "new"), [(1, True), (2, True), (127, True), (128, False), (255, False), (256, False)]
)
def test_hfp_042_045_sequences(base: int, advance: int, new: bool) -> None:
    wire = Wire()
    wire.whole(base)
    assert (wire.whole(base + advance) is not None) == new
    if new:
        assert wire.counters["lost_feedback"] == advance - 1
    else:
        assert wire.counters["stale_feedback"] == 2
    assert wire.counters["lost_feedback"] + wire.counters["samples"] == (advance + 1 if new else 1)


def test_duplicates_are_delivered_once() -> None:
    wire = Wire()
    for n in range(1, 600):
        for _ in range(2):
            wire.feedback(n)
        for _ in range(2):
            wire.timing(n)
    assert wire.numbers() == list(range(1, 600))
    assert wire.counted() == {"samples": 599, "stale_feedback": 599}


def test_a_lone_half_never_meets_a_stranger() -> None:
    """256 samples later the same sequence comes again: its half must be long gone."""
    for lone in (Wire.feedback, Wire.timing):
        wire = Wire()
        wire.whole(1)
        lone(wire, 2, 666_000)
        for n in range(3, 258):
            wire.whole(n)
        lone(wire, 257, 5)  # a late copy of an old one
        sample = wire.whole(258)
        assert sample is not None
        assert (sample.theta_m, sample.stamp_ns) == (258_000, 258_000_000)
        assert wire.counters["unpaired"] == 1
        assert wire.counters["lost_feedback"] == 1
        assert wire.counters["stale_feedback"] == 1


def test_reordered_samples_are_not_delivered() -> None:
    wire = Wire()
    for n in (1, 3, 2, 4):
        wire.whole(n)
    assert wire.numbers() == [1, 3, 4]
    assert wire.counted() == {"samples": 3, "lost_feedback": 1, "stale_feedback": 2}


def test_halves_that_overtake_each_other_are_paired() -> None:
    wire = Wire()
    for n in (1, 2, 3):
        wire.feedback(n)
    for n in (1, 2, 3):
        wire.timing(n)
    assert wire.numbers() == [1, 2, 3]
    assert wire.counted() == {"samples": 3}


def test_pending_halves_are_bounded() -> None:
    wire = Wire()
    for n in range(1, 51):
        wire.feedback(n)
    assert wire.counted() == {"unpaired": 50 - MAX_PENDING_HALVES}
    assert wire.timing(50 - MAX_PENDING_HALVES) is None
    assert wire.timing(51 - MAX_PENDING_HALVES) is not None
    assert wire.timing(50) is not None
    assert wire.counters["unpaired"] == 50 - 2 + 1  # the halves without a partner, and the lone TIMING
    assert wire.numbers() == [51 - MAX_PENDING_HALVES, 50]


@pytest.mark.parametrize("direction", [1, -1])
def test_angles_unwrap_over_many_turns(direction: int) -> None:
    wire = Wire()
    step = TURN // 2 - 1
    for n in range(20):
        sample = wire.whole(n + 1, theta=direction * n * step)
        assert sample is not None
        assert sample.theta_m == direction * n * step


def test_stamps_unwrap() -> None:
    wire = Wire()
    start = TURN - 5_000
    for n in range(10):
        sample = wire.whole(n, stamp=start + n * 1_000)
        assert sample is not None
        assert sample.stamp_ns == (start + n * 1_000) * 1_000


@pytest.mark.parametrize(
    ("gap_us", "plausible"),
    [(1, True), (60_000_000, True), (60_000_001, False), (0, False), (-1, False), (-5_000_000, False)],
)
def test_hfp_075_stamps_that_jump(gap_us: int, plausible: bool) -> None:
    wire = Wire()
    wire.whole(1, stamp=TURN - 7)
    assert (wire.whole(2, stamp=TURN - 7 + gap_us) is not None) == plausible
    assert wire.assembler.restarted != plausible
    assert wire.counters["drive_restarted"] == (not plausible)
    wire.assembler.reset()
    assert not wire.assembler.restarted
    assert wire.whole(200, stamp=3) is not None
    assert len(wire.assembler.take_samples()) == 2 + plausible  # what was delivered before stays


@pytest.mark.parametrize(("state", "known"), [(0, True), (3, True), (4, False), (15, False)])
def test_unknown_states_are_no_samples(state: int, known: bool) -> None:
    wire = Wire()
    wire.feedback(1)
    assert (wire.timing(1, state=state) is not None) == known
    assert wire.counters["unknown_state"] == (not known)


def test_queues_are_bounded_and_keep_the_newest() -> None:
    wire = Wire()
    for n in range(1, MAX_QUEUED_SAMPLES + 4):
        wire.whole(n)
        wire.assembler.on_bench(BenchSensor(1, n, -n, n & 0xFF), n)
    assert wire.counters["samples_overflow"] == wire.counters["bench_overflow"] == 3
    assert wire.numbers() == list(range(4, MAX_QUEUED_SAMPLES + 4))
    bench = wire.assembler.take_bench()
    assert bench[0] == RawBench(4, 4, -4, 4)
    assert len(bench) == MAX_QUEUED_SAMPLES
    assert wire.assembler.take_bench() == []


@pytest.mark.parametrize(("advance", "new"), [(0, False), (1, True), (127, True), (128, False), (255, False)])
def test_bench_readings_in_order(advance: int, new: bool) -> None:
    wire = Wire()
    wire.assembler.on_bench(BenchSensor(1, 0, 0, 250), 1)
    wire.assembler.on_bench(BenchSensor(1, 5, 6, (250 + advance) & 0xFF), 2)
    assert len(wire.assembler.take_bench()) == wire.counters["bench_samples"] == 1 + new
    assert wire.counters["stale_bench"] == (not new)
